"""A scan that follows the focus: fields whose window was too short are taken again, also after a stop."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from tests.support.focused_plane import COLS, ROWS, Quiet, focused_rig
from wafer_viewer.model.acquisition.plan import FOLLOW_FOCUS, FieldGrid, FocusSweep, FollowFocus
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.session.acquisition.headless import scan_to
from wafer_viewer.session.acquisition.rig_messages import FieldComplete, FrameTaken, Scan, ScanFault
from wafer_viewer.session.acquisition.scan_run import Steering, run_scan_job, writer_of
from wafer_viewer.session.planning.plan_editor import look_before, plan_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter

BUMP_UM = 35.0
JOB = Job(
    grid=FieldGrid(rows=4, cols=6, field_width_um=67.0, field_height_um=45.0),
    z_start_um=-150.0,
    sweep=FocusSweep(z_step_um=3.0, n_frames=100),
    follow_focus=FollowFocus(below_um=0.0, above_um=0.0),
)


@pytest.fixture
def bumped():
    """A rig and a scan planned by its look; then one field that was not looked at rises, by more than its window."""
    rig = focused_rig(lambda x, y: 0.1 * x)
    plan = plan_of(JOB, rig.limits)
    look = look_before(JOB, plan).run(rig, Quiet())
    plan = plan_of(JOB, rig.limits, look)
    unseen = next(f for f in plan.fields if f.number not in {place.field for place in look.places})
    near = (unseen.x_um - 1, unseen.x_um + 1), (unseen.y_um - 1, unseen.y_um + 1)
    renderer = rig._camera.renderer
    plain = renderer._form_um
    renderer._form_um = lambda x, y: (
        plain(x, y) + BUMP_UM * (near[0][0] < x < near[0][1] and near[1][0] < y < near[1][1])
    )
    yield rig, plan, unseen
    rig.close()


def run(scan, rig, told=None, steering=None):
    with writer_of(scan, rig) as writer:
        return run_scan_job(scan, rig, writer, (told if told is not None else []).append, steering or Steering())


@pytest.mark.slow
def test_a_field_whose_focus_touches_an_end_is_taken_again_wider(bumped, tmp_path):
    rig, plan, unseen = bumped
    told, scan = [], Scan(tmp_path / "scan.wafer", plan, JOB)
    assert plan.strategy == FOLLOW_FOCUS
    assert run(scan, rig, told).error is None
    (fault,) = [event.what for event in told if isinstance(event, ScanFault)]
    assert fault.startswith(f"Field {unseen.number} is in focus at an end of the z window")
    done = [event.number for event in told if isinstance(event, FieldComplete)]
    assert done.count(unseen.number) == 2
    assert len(done) == len(plan.fields) + 1
    last = [event for event in told if isinstance(event, FrameTaken)][-1].progress
    assert last.frames_done == last.frames_total
    data = Dataset.open(scan.path)
    wide = data.field(unseen.number)
    assert wide.n_frames > unseen.n_frames
    assert data.scan.plan.sweep.top_um(wide) > 0.1 * unseen.x_um + BUMP_UM
    assert data.finished
    assert not data.missing()
    assert data.check().ok
    assert not data.focus_at_end()
    stack = data.stack(unseen.number)
    assert len(stack.z_um) == stack.present.sum() == wide.n_frames
    assert len(data.stack(plan.fields[0].number).z_um) == plan.fields[0].n_frames


@pytest.mark.slow
def test_a_scan_that_is_stopped_while_fields_are_taken_again_goes_on(bumped, tmp_path):
    rig, plan, unseen = bumped
    scan, steering, told = Scan(tmp_path / "scan.wafer", plan, JOB), Steering(), []

    class Stopping(list):
        def append(self, event):
            told.append(event)
            if isinstance(event, ScanFault):
                steering.stop()

    assert run(scan, rig, Stopping(), steering).stopped
    begun = Dataset.open(scan.path)
    assert {shot.field for shot in begun.missing()} == {unseen.number}
    again = Scan(scan.path, begun.scan.plan, JOB, goes_on=True)
    assert run(again, rig).error is None
    assert Dataset.open(scan.path).check().ok


@pytest.mark.campaign
def test_a_crash_between_the_journal_and_the_new_file_is_mended(bumped, tmp_path):
    rig, plan, unseen = bumped
    scan = Scan(tmp_path / "scan.wafer", plan, JOB)
    assert run(scan, rig).error is None
    data = Dataset.open(scan.path)
    file = scan.path / "frames" / f"{unseen.name}.tif"
    wide = data.field(unseen.number)
    with DatasetWriter.resume(scan.path) as writer:
        writer.change_window(wide)
    file.rename(file.with_name(f".{file.name}.window"))
    file.write_bytes(b"what was there before")
    report = Dataset.open(scan.path).compress()
    assert [left for left in report.left if file.name in left]
    assert run(Scan(scan.path, data.scan.plan, JOB, goes_on=True), rig).error is None
    assert Dataset.open(scan.path).check().ok


@pytest.mark.campaign
def test_files_of_fields_with_their_own_windows_are_compressed_and_open_elsewhere(bumped, tmp_path):
    rig, plan, unseen = bumped
    scan = Scan(tmp_path / "scan.wafer", plan, JOB)
    assert run(scan, rig).error is None
    data = Dataset.open(scan.path)
    numbers = plan.fields[0].number, unseen.number
    stacks = [data.stack(number).images.copy() for number in numbers]
    report = data.compress()
    assert (report.left, report.n_changed) == ((), len(plan.fields))
    assert data.check().ok
    for number, stack in zip(numbers, stacks, strict=True):
        np.testing.assert_array_equal(Dataset.open(scan.path).stack(number).images, stack)
        with tifffile.TiffFile(scan.path / "frames" / f"{data.field(number).name}.tif") as file:
            assert (file.series[0].kind, file.series[0].shape) == ("ome", stack.shape)


@pytest.mark.campaign
def test_focus_beyond_the_whole_sweep_is_reported(tmp_path):
    rig = focused_rig(lambda x, y: 0.1 * x)
    told = []
    job = Job(grid=JOB.grid.centred_on(-60.0, 0.0), z_start_um=0.0, sweep=JOB.sweep, follow_focus=JOB.follow_focus)
    ended = scan_to(tmp_path / "scan.wafer", job, rig, lambda _: None, lambda _: None, told.append)
    rig.close()
    assert ended.error is None
    assert any("at an end of the whole sweep" in what for what in told)


@pytest.mark.slow
def test_a_plan_file_asks_for_it_and_the_scan_looks_first(tmp_path):
    job = decode(encode(JOB), Job, "plan.toml")
    assert job == JOB
    rig = focused_rig(lambda x, y: 0.1 * x - 0.2 * y)
    ended = scan_to(tmp_path / "scan.wafer", job, rig, lambda _: None, lambda _: None, lambda _: None)
    rig.close()
    assert ended.error is None
    plan = Dataset.open(tmp_path / "scan.wafer").scan.plan
    assert plan.strategy == FOLLOW_FOCUS
    assert len(plan.coarse_look.found) >= 3
    assert plan.n_frames < 0.4 * 24 * 100
    assert (plan.rows, plan.cols) == (ROWS, COLS)
