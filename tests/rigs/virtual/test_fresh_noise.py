"""Camera noise of the virtual rig: fresh in every scan, the same again with a seed."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.acquire.pulse_reconciliation import reference_axes
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, PulseTrain
from wafer_viewer.rigs.rig_config import RigConfig, open_rig
from wafer_viewer.rigs.virtual import prerendering
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

LIMITS = virtual_limits(48, 64)
TRAIN = PulseTrain(axis="z", first_count=0, counts_per_frame=100, n_frames=3, direction=1)


def frames(**settings):
    """Three frames of a rig that was switched on for them."""
    rig = VirtualRig("stair", limits=LIMITS, **settings)
    rig.camera.start(100.0)
    reference_axes(rig)
    rig.box.arm(TRAIN, on_command=True)
    taken = []
    for z_um in (0.0, 1.0, 2.0):
        rig.stage.move_to(z_um=z_um)
        rig.box.fire()
        taken.append(rig.camera.next_image(1.0).image)
    rig.close()
    return np.array(taken, np.float64)


def test_two_scans_have_the_same_scene_and_different_noise():
    one, other = frames(), frames()
    assert np.mean(one != other) > 0.5
    assert np.abs(one.mean(0) - other.mean(0)).mean() < 2.0
    noise = np.sqrt((one - other).var(axis=0).mean() / 2)
    assert 0.5 < noise < 4.0


def test_the_scale_errors_belong_to_the_instrument_and_stay():
    places = [VirtualRig("stair", limits=LIMITS) for _ in range(2)]
    for rig in places:
        rig.stage.move_to(x_um=5_000.0)
    assert places[0].stage.truth_at(1e3) == places[1].stage.truth_at(1e3)
    for rig in places:
        rig.close()


def test_a_seed_gives_the_same_frames_again():
    np.testing.assert_array_equal(frames(seed=0), frames(seed=0))
    assert np.any(frames(seed=0) != frames(seed=1))


@pytest.mark.parametrize("seed", [None, 7])
def test_frames_rendered_beforehand_have_the_noise_of_this_scan(seed, monkeypatch):
    jobs = []
    monkeypatch.setattr(prerendering, "prerender", lambda job, *_: jobs.append(job))
    fields = FieldGrid(rows=1, cols=1, field_width_um=30.0, field_height_um=22.0).fields(0.0)
    plan = plan_scan(fields, FocusSweep(z_step_um=1.0, n_frames=3), (100.0,), LIMITS)
    for _ in range(2):
        rig = open_rig(RigConfig(scene="stair", real_time=True, seed=seed))
        for _ in range(2):
            rig.prepare(plan, lambda: False)
            rig.camera.start(100.0)
            rig.camera.trigger(rig.clock.now_s())
        rig.close()
    first, second, third, fourth = (job.frame_seed for job in jobs)
    assert (second - first, fourth - third) == (1, 1)
    assert (first == third) == (seed is not None)
