"""Order of what a writer waits for, and what readers make of the lines that a power cut leaves of a pass."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.support.datasets.samples import SUMMARY, all_shots, make_frame, make_job, make_plan
from tests.support.power_cut import CUTS, Disk, recorded, write_out
from wafer_viewer.model.acquisition.plan import Field, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import replace
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.integrity import UNKNOWN
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.scan_record import JOURNAL
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.atomic_files import DEAD_AFTER_S, atomic_write, write_text
from wafer_viewer.store.records.manifest import MANIFEST


def write_passes(writer, plan, *, ended=True):
    for number, leg in enumerate(plan.legs):
        writer.pass_begun(number, leg)
        for shot in leg.shots:
            writer.frame(make_frame(shot, plan))
        if ended or number + 1 < len(plan.legs):
            writer.pass_ended(number, SUMMARY)


@pytest.fixture
def broken_off(tmp_path):
    """A scan of two passes of four frames, the second of which never ended."""
    job = make_job()
    plan = make_plan(job)
    manifest = tmp_path / "a.wafer" / MANIFEST
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job) as writer:
        before = manifest.read_bytes()
        write_passes(writer, plan, ended=False)
    manifest.write_bytes(before)  # the program did not live to sign what it had written
    return tmp_path / "a.wafer"


def zero_a_line(path, number):
    lines = (path / JOURNAL).read_bytes().split(b"\n")
    lines[number - 1] = bytes(len(lines[number - 1]))
    (path / JOURNAL).write_bytes(b"\n".join(lines))


@pytest.mark.parametrize("number", [8, 9, 10, 11])
def test_a_pass_that_never_ended_counts_to_its_first_damaged_line_and_the_scan_continues(broken_off, number):
    zero_a_line(broken_off, number)
    data = Dataset.open(broken_off)
    (fault,) = [fault for kind in data.check().files for fault in kind.damaged]
    assert fault.endswith("of a pass that never ended, which are ignored: continue the scan.") or number == 11
    assert len(data.kept()) == 4
    assert len(data.arrived()) == 4 + number - 8
    with DatasetWriter.resume(broken_off) as writer:
        assert len(writer.kept) == 4
        write_passes(writer, writer.record.plan)
    data = Dataset.open(broken_off)
    assert data.kept() == set(all_shots(data.scan.plan))
    assert data.check().ok


@pytest.mark.parametrize("number", [1, 2, 5, 6, 7])
def test_a_damaged_line_of_a_pass_that_ended_is_damage(broken_off, number):
    zero_a_line(broken_off, number)
    with pytest.raises(DatasetError, match=f"is damaged in line {number}:"):
        Dataset.open(broken_off)


@pytest.mark.slow
def test_a_changed_window_survives_a_power_cut(tmp_path):
    job = make_job(cols=1)
    plan = make_plan(job)
    root = tmp_path / "rec"
    root.mkdir()
    with recorded(root) as recording, DatasetWriter.create(root / "a.wafer", plan, job) as writer:
        write_passes(writer, plan)
        before = len(recording.operations)
        changed: Field = replace(plan.fields[0], z_start_um=-20.0, n_frames=7)
        writer.change_window(changed)
        after = len(recording.operations)
        for k in range(7):
            writer.frame(make_frame(Shot(changed.number, k), plan))
        writer.pass_ended(1, SUMMARY)
    disk, rng, n_changed = Disk(), random.Random(3), 0
    for n, operation in enumerate(recording.operations[: after + 1], 1):
        disk.apply(operation)
        for cut in CUTS if n >= before else ():
            path = tmp_path / f"{n}-{rng.random()}"
            path.mkdir()
            write_out(disk.left_after_cut(cut, rng), path)
            with DatasetWriter.resume(path / "a.wafer") as writer:
                (field,) = writer.record.plan.fields
                n_changed += field.n_frames == 7
                assert len(writer.kept) == (0 if field.n_frames == 7 else 4)
                assert n < after or field.n_frames == 7
            report = Dataset.open(path / "a.wafer").check()
            assert not report.faults, (n, operation, cut)
            assert not report.damaged
    assert n_changed > 5


def test_a_file_is_on_the_disk_before_its_name_and_that_before_the_writer_returns(tmp_path):
    with recorded(tmp_path) as recording:
        write_text(tmp_path / "a.txt", "all of it")
        with atomic_write(tmp_path / "many") as temporary:
            temporary.mkdir()
            write_text(temporary / "b.txt", "some")
    kinds = [operation.kind for operation in recording.operations]
    assert kinds == [
        *("make", "write", "wait", "rename", "wait for names"),
        *("make folder", "make", "write", "rename"),  # within a part nothing is waited for
        *("wait", "wait for names", "rename", "wait for names"),
    ]


def test_what_was_replaced_by_a_killed_process_is_removed_as_well(tmp_path):
    job = make_job()
    DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job).close()
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    aside = tmp_path / "a.wafer" / "results" / f".mosaic.zarr.{gone.pid}-0a1b2c.part.old"
    aside.mkdir()
    (aside / "zarr.json").write_text("{}")
    assert UNKNOWN not in {kind.title for kind in Dataset.open(tmp_path / "a.wafer").check().files}
    for path in (aside / "zarr.json", aside):
        os.utime(path, (time.time() - DEAD_AFTER_S - 60,) * 2)
    Lock.take(tmp_path / "a.wafer").release()
    assert not aside.exists()


def test_pages_are_not_written_again_by_a_resumed_scan(broken_off):
    before = np.array(Dataset.open(broken_off).stack(1).images)
    with DatasetWriter.resume(broken_off) as writer:
        write_passes(writer, writer.record.plan)
    np.testing.assert_array_equal(Dataset.open(broken_off).stack(1).images, before)
