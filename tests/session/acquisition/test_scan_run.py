"""A scan with a rig of one's own: what ends it early becomes a sentence, the rig is at rest, and it can go on."""

from __future__ import annotations

import errno

import numpy as np
import pytest

from wafer_viewer.model.acquisition.plan import FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import VirtualRig
from wafer_viewer.session.acquisition.headless import scan_to
from wafer_viewer.session.acquisition.rig_messages import FieldComplete, FrameTaken, Paused, Scan, ScanEnded, ScanFault
from wafer_viewer.session.acquisition.scan_run import (
    Steering,
    clipped_fraction,
    order_of_fields,
    run_scan_job,
    writer_of,
)
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.session.planning.revision_trial import job_of_wafer
from wafer_viewer.store.dataset.dataset import Dataset


class Grey:
    """Renders the same grey picture everywhere."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        return np.full((540, 720), 99, np.uint8)


@pytest.fixture
def rig():
    made = VirtualRig(renderer=Grey())
    yield made
    made.close()


@pytest.fixture
def scan(rig, job, tmp_path):
    made = job(cols=3, n_frames=10)
    return Scan(tmp_path / "scan.wafer", plan_of(made, rig.limits), made)


def go_on(scan):
    return Scan(scan.path, scan.plan, scan.job, goes_on=True)


def test_it_tells_of_every_field_once_and_of_its_end(rig, scan):
    reported = []
    with writer_of(scan, rig) as writer:
        ended = run_scan_job(scan, rig, writer, reported.append, Steering())
    assert ended == ScanEnded(scan.path, stopped=False, n_missing=0, error=None)
    assert sorted(e.number for e in reported if isinstance(e, FieldComplete)) == [1, 2, 3]
    last = [e for e in reported if isinstance(e, FrameTaken)][-1]
    assert last.progress.finished
    assert (last.progress.frames_done, last.progress.frames_total, last.progress.seconds_left) == (30, 30, 0.0)
    assert (last.latest.brightest, last.latest.clipped_fraction) == (99, 0.0)
    assert Dataset.open(scan.path).finished


def test_a_full_disk_ends_it_with_a_sentence_and_what_is_kept_is_good(rig, scan, monkeypatch):
    with writer_of(scan, rig) as writer:
        keep = writer.frame

        def frame(taken):
            if writer.n_arrived == 17:
                raise OSError(errno.ENOSPC, "No space left on device")
            keep(taken)

        monkeypatch.setattr(writer, "frame", frame)
        ended = run_scan_job(scan, rig, writer, lambda _: None, Steering())
    assert ended.stopped
    assert "the disk is full" in ended.error
    rig.stage.wait()
    assert rig.stage.position().z_um > scan.plan.sweep.z_um(scan.plan.fields[1], 0)
    stored = Dataset.open(scan.path)
    assert len(stored.kept()) == 10, "the frames of the pass that was broken off do not count"
    assert not stored.finished
    assert stored.check().damaged == ()
    with writer_of(go_on(scan), rig) as writer:
        assert run_scan_job(go_on(scan), rig, writer, lambda _: None, Steering()).error is None
    assert Dataset.open(scan.path).check().ok


@pytest.mark.slow
def test_the_same_command_scans_after_it_was_killed_while_it_made_the_folder(rig, scan):
    writer_of(scan, rig).close()
    record = scan.path / "scan.json"
    record.rename(scan.path / ".scan.json.999999-0a1b2c.part")
    (scan.path / "manifest.json").unlink()
    plan = scan.path.with_name("plan.toml")
    plan.write_text(encode(scan.job))
    job = job_of_wafer(plan, scan.path, {}, ())
    ended = scan_to(scan.path, job, rig, lambda _: None, lambda _: None, lambda _: None)
    assert (ended.error, ended.words) == (None, "30 of 30 frames kept")
    assert Dataset.open(scan.path).check().ok


def test_a_stop_out_of_a_pause_is_reported_and_ends_it(rig, scan):
    reported, steering = [], Steering()
    steering.pause()

    def tell(event):
        reported.append(event)
        if event == Paused(True):
            steering.stop()

    with writer_of(scan, rig) as writer:
        ended = run_scan_job(scan, rig, writer, tell, steering)
    assert ended.stopped
    assert ended.error is None
    assert reported[:2] == [Paused(True), Paused(False)]
    assert Dataset.open(scan.path).kept() == set()


def test_once_nobody_is_there_no_scan_begins(rig, scan):
    steering = Steering()
    steering.end()
    steering.reset()
    with writer_of(scan, rig) as writer:
        assert run_scan_job(scan, rig, writer, lambda _: None, steering).stopped
        assert not writer.kept


def test_the_order_is_that_of_the_stage_and_clipping_is_counted_at_the_top_of_the_range(scan):
    assert order_of_fields(scan.plan) == [1, 2, 3]
    assert clipped_fraction(np.array([[255, 254], [0, 255]], np.uint8)) == 0.5
    assert clipped_fraction(np.array([[255, 65535]], np.uint16)) == 0.5


def test_an_error_of_a_device_is_not_told_as_a_full_disk(rig, scan, monkeypatch):
    def unplugged(timeout_s):
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(rig.camera, "next_image", unplugged)
    with writer_of(scan, rig) as writer:
        ended = run_scan_job(scan, rig, writer, lambda _: None, Steering())
    assert ended.error == "The camera failed (No such device): check its cable and its power, and continue."
    assert Dataset.open(scan.path).faults == (ended.error,)


def test_exception_of_a_camera_library_ends_the_scan_with_the_mend(rig, scan, monkeypatch):
    def failed(*_):
        raise RuntimeError("Camera is not available.")

    for call in ("next_image", "stop"):
        monkeypatch.setattr(rig.camera, call, failed)
    with writer_of(scan, rig) as writer:
        ended = run_scan_job(scan, rig, writer, lambda _: None, Steering())
    assert ended.error == "The camera failed (Camera is not available): check its cable and its power, and continue."


def continued(scan, job, rig):
    """Begin a scan without a frame, and continue it by a job; what the person is told."""
    writer_of(scan, rig).close()
    warned = []
    ended = scan_to(scan.path, job, rig, lambda _: None, pytest.fail, warned.append)
    assert ended.words == "30 of 30 frames kept"
    return warned


def test_scan_is_continued_by_a_plan_with_another_recipe(rig, scan):
    changed = replace(scan.job, recipe=Recipe(window=11), defect_sensitivity=6.0, compression="zstd")
    assert continued(scan, changed, rig) == [
        "scan.wafer keeps the values of recipe, defect_sensitivity that it was started with; the plan has others."
    ]
    assert Dataset.open(scan.path).scan.job == scan.job
    assert Dataset.open(scan.path).check().ok


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"exposures_us": (50.0,)}, "exposures_us"),
        ({"sweep": FocusSweep(z_step_um=1.0, n_frames=10), "z_start_um": 1.0}, "z_start_um, sweep"),
        ({"sample": Sample(lot="L2")}, "sample"),
        ({"light_fraction": 0.5}, "light_fraction"),
        ({"product": "other"}, "product"),
    ],
    ids=str,
)
def test_scan_is_not_continued_by_a_plan_with_other_frames(rig, scan, changes, named):
    with pytest.raises(PlanError, match=f"another plan, which has other values of {named}: choose another name, or"):
        continued(scan, replace(scan.job, **changes), rig)


def test_a_pass_that_slipped_is_reported_and_none_of_its_frames_is_counted_as_done(job, tmp_path):
    rig = VirtualRig(renderer=Grey(), faults=Faults(slips=(15,), slip_counts=250))
    made = job(cols=3, n_frames=10)
    scan, reported = Scan(tmp_path / "scan.wafer", plan_of(made, rig.limits), made), []
    with writer_of(scan, rig) as writer:
        ended = run_scan_job(scan, rig, writer, reported.append, Steering())
    rig.close()
    assert (ended.error, ended.n_missing) == (None, 0)
    (fault,) = [event.what for event in reported if isinstance(event, ScanFault)]
    assert "125 quadrature errors" in fault
    assert sorted(e.number for e in reported if isinstance(e, FieldComplete)) == [1, 2, 3]
    last = [e for e in reported if isinstance(e, FrameTaken)][-1].progress
    assert (last.frames_done, last.frames_missing) == (30, 0)
    data = Dataset.open(scan.path)
    assert data.check().ok
    assert data.faults == (fault,)
    assert {shot.field for shot in data.ever_missed()} == {2}
