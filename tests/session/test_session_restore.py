"""What was open is open again, whatever became of it; and nothing moves before a person has looked."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import msgspec
import pytest

from tests.session.conftest import small_job
from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.model.errors import DatasetError, PlanError, RigError
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.session.acquisition.rig_messages import Move
from wafer_viewer.session.coordinator import SessionCoordinator
from wafer_viewer.session.session import Session
from wafer_viewer.session.session_restore import KEPT_IN, NAME
from wafer_viewer.session.state.snapshot import Typed
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

HALF = Typed('{"exposures_us": "quick"}', "The exposures read 'quick'.")


class Program:
    """The session without its rig: started, used and ended as often as a test wants."""

    def __init__(self, folder):
        self.folder = folder
        self.coordinator = None

    def start(self):
        self.coordinator = SessionCoordinator(self.folder, RigConfig(), None)
        self.coordinator.rig.start = lambda: None
        self.do(self.coordinator.start)
        return self.now

    def do(self, command, *args):
        return self.coordinator.command_queue.do(command, *args).result(10)

    @property
    def now(self):
        return self.coordinator.command_queue.snapshot

    def end(self):
        if self.coordinator is not None:
            self.coordinator.close()
            self.coordinator = None


@pytest.fixture
def program(tmp_path):
    made = Program(tmp_path)
    yield made
    made.end()


@pytest.fixture
def dataset(tmp_path):
    """An unfinished dataset: planned, and nothing taken yet."""
    job = small_job()
    plan = plan_scan(job.all_fields(), job.sweep, job.exposures_us, virtual_limits(540, 720), job.strategy)
    path = tmp_path / "begun.wafer"
    path.mkdir()
    (path / JOURNAL).touch()
    write_record(path, ScanRecord(software_version="test", taken="2026-01-01T00:00:00", job=job, plan=plan))
    return path


def kept_file(program):
    return program.folder / KEPT_IN / NAME


def test_a_first_start_opens_nothing_and_asks_nothing(program):
    now = program.start()
    assert (now.dataset, now.draft.job, now.reopening) == (None, None, False)
    assert now.draft.confirmed
    assert now.faults == ()


def test_plan_dataset_and_what_was_half_typed_are_there_after_a_restart(program, dataset):
    program.start()
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.do(program.coordinator.open, dataset)
    program.do(program.coordinator.plan_editor.keep_typed, HALF)
    program.end()
    now = program.start()
    assert now.draft.job == small_job()
    assert now.draft.typed == HALF
    assert now.dataset.path == dataset
    assert not now.draft.confirmed
    assert not now.draft.can_undo


def test_nothing_moves_before_the_sample_is_confirmed(program, dataset):
    program.start()
    program.do(program.coordinator.open, dataset)
    program.end()
    program.start()
    coordinator = program.coordinator
    for command, *args in ((coordinator.move_to, Move(x_um=0.0)), (coordinator.continue_scan,)):
        with pytest.raises(PlanError, match="confirm the sample before anything moves"):
            program.do(command, *args)
    program.do(coordinator.plan_editor.confirm)
    assert program.now.draft.confirmed
    coordinator.rig.start = lambda: pytest.fail("the rig was asked")
    coordinator.rig.require_idle = refuse
    with pytest.raises(RigError, match="asked"):
        program.do(coordinator.move_to, Move(x_um=0.0))


def refuse(what):
    raise RigError(f"The rig is asked to {what}.")


def test_what_is_half_typed_is_no_plan_until_it_is_mended(program):
    program.start()
    plan_editor = program.coordinator.plan_editor
    program.do(plan_editor.edit, small_job())
    program.do(plan_editor.keep_typed, HALF)
    with pytest.raises(PlanError, match="read 'quick'"):
        program.do(plan_editor.ready)
    program.do(plan_editor.edit, small_job(cols=3))
    assert program.now.draft.typed is None
    program.do(plan_editor.keep_typed, HALF)
    program.do(plan_editor.undo)
    assert program.now.draft.typed is None


def test_a_dataset_that_has_gone_is_reported_and_the_plan_is_there_all_the_same(program, dataset):
    program.start()
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.do(program.coordinator.open, dataset)
    program.end()
    shutil.move(dataset, dataset.with_name("elsewhere.wafer"))
    now = program.start()
    assert now.dataset is None
    assert now.draft.job == small_job()
    assert "begun.wafer was open and is not there any more" in now.faults[0].text


def test_a_dataset_that_another_program_holds_is_open_for_reading_and_that_is_reported(program, dataset, monkeypatch):
    program.start()
    program.do(program.coordinator.open, dataset)
    program.end()
    monkeypatch.setattr(Lock, "take", held_elsewhere)
    now = program.start()
    assert now.dataset.path == dataset
    assert [(f.title, f.needs_person) for f in now.faults] == [("begun can only be read", False)]


def held_elsewhere(path):
    raise DatasetError(f"{path.name} is held by process 1: close it there.")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"", "truncated"),
        (b'{"version": 1, "dataset"', "truncated"),
        (b"[1, 2]", "Expected `object`"),
        (b'{"version": 99}', "version 99"),
        (b'{"version": 1, "job": {"product": 3}}', "The plan"),
        (b'{"version": 1, "dataset": "\xff"}', "utf-8"),
    ],
)
def test_a_file_that_cannot_be_read_costs_the_memory_and_not_the_start(program, text, why):
    kept_file(program).parent.mkdir()
    kept_file(program).write_bytes(text)
    now = program.start()
    assert (now.dataset, now.draft.job, now.reopening) == (None, None, False)
    (fault,) = now.faults
    assert why.lower() in fault.text.lower()
    assert fault.text.endswith("Nothing to do.")
    assert not fault.needs_person
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.end()
    assert program.start().draft.job == small_job()


def test_a_closed_dataset_stays_closed(program, dataset):
    program.start()
    program.do(program.coordinator.open, dataset)
    program.do(program.coordinator.close_dataset)
    program.end()
    assert program.start().dataset is None


def test_the_file_is_small_and_plain(program):
    program.start()
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.end()
    stored = msgspec.json.decode(kept_file(program).read_bytes())
    assert set(stored) == {"version", "job"}
    assert {path.name for path in kept_file(program).parent.iterdir()} == {NAME, "lock"}


@pytest.fixture
def second(program):
    """Another program on the same data folder."""
    made = Program(program.folder)
    yield made
    made.end()


def test_the_second_program_on_a_folder_says_that_it_remembers_nothing_and_leaves_the_first_alone(program, second):
    program.start()
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.do(program.coordinator.plan_editor.keep_typed, HALF)
    now = second.start()
    assert now.draft.job is None
    (fault,) = now.faults
    assert (fault.title, fault.needs_person) == ("What is open here is not remembered", False)
    assert f"process {os.getpid()}" in fault.text
    second.do(second.coordinator.plan_editor.edit, small_job(cols=3))
    second.end()
    program.end()
    now = program.start()
    assert (now.draft.job, now.draft.typed, now.faults) == (small_job(), HALF, ())


def test_the_next_session_restores_the_plan(program, second):
    program.start()
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.end()
    assert second.start().draft.job == small_job()
    assert second.now.faults == ()


def test_a_killed_process_holds_no_lock(program):
    held = program.folder / KEPT_IN
    held.mkdir()
    take = "import sys, pathlib; from wafer_viewer.store.dataset.lock import Lock; Lock.take(pathlib.Path(sys.argv[1]))"
    wait = "; print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", take + wait, held], stdin=-1, stdout=-1) as other:
        assert other.stdout.readline() == b"held\n"
        other.kill()
    assert json.loads((held / "lock").read_text())["pid"] == other.pid
    assert program.start().faults == ()


def test_a_lock_of_another_machine_is_believed_and_the_way_out_is_reported(program):
    held = program.folder / KEPT_IN
    held.mkdir()
    (held / "lock").write_text('{"pid": 7, "host": "elsewhere", "since": "2026-01-01T00:00:00+00:00"}')
    (fault,) = program.start().faults
    assert f"process 7 on elsewhere, since 2026-01-01T00:00:00+00:00) works in {program.folder}" in fault.text
    assert f"delete {held / 'lock'}" in fault.text


def test_a_folder_that_nobody_may_write_to_costs_the_memory_and_not_the_start(program, monkeypatch):
    monkeypatch.setattr(Lock, "take", held_elsewhere)
    assert program.start().faults == ()
    program.do(program.coordinator.plan_editor.edit, small_job())
    program.end()
    assert not kept_file(program).exists()


@pytest.mark.campaign
def test_a_scan_of_a_plan_that_was_opened_again_waits_for_a_look_at_the_sample(tmp_path, patience_s):
    first = Session(tmp_path)
    first.edit_job(small_job()).result()
    first.close()
    again = Session(tmp_path)
    try:
        again.wait_until(lambda now: now.rig.state == "ready", patience_s)
        with pytest.raises(PlanError, match="not confirmed"):
            again.start_scan("once").result(patience_s)
        with pytest.raises(PlanError, match="confirm the sample"):
            again.move_to(x_um=10.0).result(patience_s)
        assert (again.snapshot.rig.x_um, again.snapshot.datasets) == (pytest.approx(0.0, abs=0.5), ())
        again.jobs.confirm().result()
        again.start_scan("once").result(patience_s)
        again.stop_scan().result(patience_s)
    finally:
        again.close()
