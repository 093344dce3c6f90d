"""Holds of the open dataset: with name and reason in its journal, in the list of datasets and in the audit log."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.store.dataset.test_damaged_frames import take
from tests.support.datasets.samples import make_job, make_plan
from wafer_viewer.gui.shell.left_panel import frames_card
from wafer_viewer.model.errors import DatasetError, RoleError
from wafer_viewer.session.coordinator import SessionCoordinator
from wafer_viewer.session.core.audit_trail import AuditTrail
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.state.snapshot import Browser, ControlState, Snapshot
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.retention import remove_frames
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.records.manifest import deviations
from wafer_viewer.store.records.signed_log import recorded_actions

ANN, OLGA = Browser("a", "Ann", role="engineer"), Browser("o", "Olga", role="operator")


class Bench(SimpleNamespace):
    """What the commands of a session need, without a rig and without workers."""

    hold_frames, end_hold = SessionCoordinator.hold_frames, SessionCoordinator.end_hold
    _author = SessionCoordinator._author

    def __init__(self, folder):
        self.command_queue = self._command_queue = CommandQueue(Snapshot(data_folder=folder))
        AuditTrail(self.command_queue, Notifications(self.command_queue), folder)
        self.library = Library(self.command_queue, folder)

    def held_by(self, key, engineers=()):
        control = ControlState(browsers=(ANN, OLGA), holder=key, engineers=engineers)
        self.command_queue.do(lambda: self.command_queue.change(control=control)).result()

    @property
    def now(self):
        for _ in range(2):
            self.command_queue.do(lambda: None).result()
        return self.command_queue.snapshot


@pytest.fixture
def path(tmp_path):
    job = make_job(n_frames=6)
    with DatasetWriter.create(tmp_path / "w1.wafer", make_plan(job), job) as writer:
        take(writer)
    return tmp_path / "w1.wafer"


@pytest.fixture
def bench(path):
    made = Bench(path.parent)
    made.command_queue.do(made.library.open, path).result()
    made.command_queue.do(made.library.refresh.run).result()
    yield made
    made.command_queue.do(made.library.close).result()
    made.command_queue.close()


def test_the_open_dataset_is_held_and_freed_with_name_and_reason(bench, path):
    assert "frames kept permanently" in frames_card(bench.now)
    bench.held_by("a")
    with pytest.raises(DatasetError, match="needs a reason"):
        bench.hold_frames(" ").result()
    bench.hold_frames("complaint 7").result()
    assert bench.now.dataset.held == "Ann: complaint 7"
    assert [entry.frames for entry in bench.now.datasets] == ["held"]
    assert "held by Ann: complaint 7" in frames_card(bench.now)
    assert Dataset.open(path).held.by == "Ann"
    bench.end_hold("settled").result()
    assert bench.now.dataset.held == ""
    assert [(e.action, e.by, e.subject, e.detail) for e in recorded_actions(path.parent)] == [
        ("Frames held", "Ann", "w1.wafer", "why: complaint 7"),
        ("Hold ended", "Ann", "w1.wafer", "why: settled"),
    ]
    assert [fault for _, faults in deviations(path) for fault in faults] == []


def test_an_operator_holds_and_does_not_end_it(bench):
    bench.held_by("o", engineers=("Ann",))
    bench.hold_frames("looks odd").result()
    with pytest.raises(RoleError, match="Only an engineer ends a hold: Ann"):
        bench.end_hold("mine").result()
    assert bench.now.dataset.held == "Olga: looks odd"


def test_removed_frames_are_told_and_cannot_be_held(bench, path):
    bench.command_queue.do(bench.library.close).result()
    remove_frames(Dataset.open(path), "Ann", 90)
    bench.command_queue.do(bench.library.open, path).result()
    bench.command_queue.do(bench.library.refresh.run).result()
    card = frames_card(bench.now)
    assert "frames removed" in card
    assert "data-pick" not in card
    with pytest.raises(DatasetError, match="were removed by Ann"):
        bench.hold_frames("too late").result()


def test_a_script_in_a_reason_is_text(bench):
    bench.hold_frames("<script>alert(1)</script>").result()
    assert "<script>" not in frames_card(bench.now)


def test_nothing_is_written_beside_the_rig_or_a_worker(bench, path):
    before = (path / "journal.jsonl").read_bytes()
    bench.command_queue.do(bench.library.release_lock).result()  # as for a scan that takes damaged frames again
    with pytest.raises(DatasetError, match=r"w1\.wafer is being written"):
        bench.hold_frames("now").result()
    assert (path / "journal.jsonl").read_bytes() == before
