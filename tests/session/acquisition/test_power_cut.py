"""A scan whose power is cut at any moment: no frame that counts is lost or altered, and the scan continues."""

from __future__ import annotations

import os
import random
import shutil
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from tests.support.campaigns import drawn_cases
from tests.support.power_cut import CUTS, Disk, recorded, write_out
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import Job
from wafer_viewer.rigs.virtual.rig import PIXEL_UM, VirtualRig, virtual_limits
from wafer_viewer.session.acquisition.rig_messages import Scan
from wafer_viewer.session.acquisition.scan_run import Steering, run_scan_job, writer_of
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter

ROWS, COLS = 24, 32
NAME = "cut.wafer"
CONTINUED_EVERY = 23
"""Every n-th state is continued on the rig; all are opened, checked, locked and read."""


class Different:
    """Renders a picture that no other place and height has."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        rng = np.random.default_rng([round(1e3 * abs(v)) for v in (x_um, y_um, z_um)])
        return rng.integers(1, 255, (ROWS, COLS), np.uint8)


def small_rig():
    return VirtualRig(limits=virtual_limits(ROWS, COLS), renderer=Different(), seed=3)


def small_job():
    grid = FieldGrid(rows=1, cols=3, field_width_um=COLS * PIXEL_UM, field_height_um=ROWS * PIXEL_UM)
    return Job(grid=grid.centred_on(50.0, 50.0), z_start_um=-6.0, sweep=FocusSweep(z_step_um=2.4, n_frames=6))


@pytest.fixture(scope="module")
def rig():
    made = small_rig()
    yield made
    made.close()


@pytest.fixture(scope="module")
def recording(rig, tmp_path_factory):
    """All operations of a scan that was stopped once and continued; its marks are the frames that count since then."""
    root = tmp_path_factory.mktemp("scanned")
    job = small_job()
    scan = Scan(root / NAME, plan_of(job, rig.limits), job)
    with recorded(root) as recording, pytest.MonkeyPatch.context() as patch:
        ended = DatasetWriter.pass_ended

        def noted(writer, number, summary):
            ended(writer, number, summary)
            recording.mark(writer.kept)
            if len(recording.marks) == 2:
                steering.stop()

        patch.setattr(DatasetWriter, "pass_ended", noted)
        for goes_on in (False, True):
            steering = Steering()
            with writer_of(Scan(scan.path, scan.plan, job, goes_on=goes_on), rig) as writer:
                recording.mark(frozenset(writer.kept))
                run_scan_job(scan, rig, writer, lambda _: None, steering)
    return recording


def states(recording):
    """Each prefix of the operations, and what each cut may leave of it: the frames that have to be there, and files."""
    rng, disk, marks = random.Random(1), Disk(), list(recording.marks)
    safe = None
    for n, operation in enumerate(recording.operations, 1):
        disk.apply(operation)
        while marks and marks[0][0] <= n:
            safe = marks.pop(0)[1]
        for cut in CUTS:
            yield n, cut, safe, disk.left_after_cut(cut, rng)


def test_the_recording_is_complete(recording):
    disk = Disk()
    for operation in recording.operations:
        disk.apply(operation)
    left = disk.left_after_cut("all", random.Random(1))
    there = {p.relative_to(recording.root).as_posix(): p for p in recording.root.rglob("*")}
    assert left.keys() == there.keys()
    assert all(content is None or content == there[name].read_bytes() for name, content in left.items())
    assert Dataset.open(recording.root / NAME).check().ok


def test_when_a_pass_has_ended_its_frames_are_on_the_disk(recording):
    assert [len(kept) for _, kept in recording.marks] == [0, 6, 6, 12, 18]


@pytest.mark.slow
@pytest.mark.campaign(within=True)
def test_whenever_the_power_is_cut_no_frame_that_counts_is_lost_or_altered_and_nothing_is_blocked(
    recording, rig, tmp_path
):
    data = Dataset.open(recording.root / NAME)
    good = {line.shot: line for field in data.fields for line in data.journal_lines(field)}
    every = list(states(recording))
    assert len(every) > 20 * CONTINUED_EVERY
    continued = drawn_cases(range(0, len(every), CONTINUED_EVERY))
    for number in sorted({*drawn_cases(range(len(every))), *continued}):
        n, cut, safe, left = every[number]
        path = tmp_path / str(number)
        path.mkdir()
        write_out(left, path)
        where = f"operation {n}, {recording.operations[n - 1]!r:.80}, {cut}"
        kept = look_at(path / NAME, safe, good, where)
        if number in continued:
            continue_to_the_end(path / NAME, rig, kept, where)
        shutil.rmtree(path)


def look_at(path, safe, good, where):
    """Open, check and lock what is left, and return the frames that count."""
    try:
        data = Dataset.open(path)
    except DatasetError:
        assert safe is None, f"a dataset was lost: {where}"
        return frozenset()
    kept = data.kept()
    assert kept >= (safe or set()), f"frames were lost: {where}"
    report = data.check()
    assert not report.damaged, where
    assert all("the checksum of its tags differs" in fault for fault in report.faults), (where, report.faults)
    for field in data.fields:
        for line in data.journal_lines(field):
            if line.shot in kept:
                assert (line.crc32, line.z_um) == (good[line.shot].crc32, good[line.shot].z_um), where
    with DatasetWriter.resume(path) as writer:
        assert writer.kept == kept, where
    if report.faults:
        data.compress("none")
    report = Dataset.open(path).check()
    assert (report.damaged, report.faults) == ((), ()), (where, report)
    assert not [fault for kind in report.files for fault in kind.damaged], (where, report)
    return kept


def continue_to_the_end(path: Path, rig, kept, where):
    """Scan what is missing, in a new dataset if there was none, and require that all is right."""
    job = small_job()
    scan = Scan(path, plan_of(job, rig.limits), job, goes_on=(path / "scan.json").exists())
    if path.exists() and not scan.goes_on:
        then = time.time() - 60
        os.utime(path, (then, then))
    if len(kept) == scan.plan.n_frames:
        with pytest.raises(DatasetError, match="has all its frames, and none is damaged"):
            writer_of(scan, rig)
        return
    with writer_of(scan, rig) as writer:
        assert writer.kept == kept
        ended = run_scan_job(scan, rig, writer, lambda _: None, Steering())
    assert ended.error is None, (where, ended)
    data = Dataset.open(path)
    assert data.check().ok, where
    assert all(zlib.crc32(image) for field in data.fields for image in data.stack(field.number).images)
