"""Frames rendered beforehand are those that the scan would have taken."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from wafer_viewer.acquire.pulse_reconciliation import reference_axes
from wafer_viewer.model.acquisition.plan import Field, FocusSweep, Leg, PulseTrain, ScanPlan, Shot
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.prerendering import PrerenderJob, prerender
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

LIMITS = virtual_limits(48, 64)
N = 5
LEG = Leg(
    train=PulseTrain(axis="z", first_count=100, counts_per_frame=100, n_frames=N, direction=1),
    shots=tuple(Shot(1, k) for k in range(N)),
    x_um=30.0,
    y_um=-10.0,
    z_um=1.0,
    speed_um_s=50.0,
)
PLAN = ScanPlan(
    fields=(Field(number=1, row=0, col=0, x_um=30.0, y_um=-10.0, z_start_um=1.0),),
    sweep=FocusSweep(z_step_um=1.0, n_frames=N),
    exposures_us=(100.0,),
    strategy="z_up",
    legs=(LEG,),
    predicted_s=0.1,
    prices=(),
    rows=48,
    cols=64,
    pixel_um=LIMITS.pixel_um,
)
ORDER = PrerenderJob(scene="plane", seed=3, limits=LIMITS, plan=PLAN, here_um=(0.0, 0.0, 0.0))


class NoLive:
    """There is nothing left to render live."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        raise AssertionError(f"rendered live at {x_um, y_um, z_um}")


def take(rig):
    """The frames of the only leg."""
    rig.stage.move_to(x_um=LEG.x_um, y_um=LEG.y_um, z_um=LEG.z_um - 0.5)
    rig.camera.start(100.0)
    reference_axes(rig)
    rig.box.arm(LEG.train)
    rig.stage.start("z", LEG.z_um + N, LEG.speed_um_s)
    images = [rig.camera.next_image(1.0).image for _ in range(N)]
    rig.stage.wait()
    rig.box.disarm()
    return np.array(images)


@pytest.mark.slow
def test_a_scan_in_real_time_replays_what_was_rendered_beforehand(monkeypatch):
    rig = VirtualRig("plane", limits=LIMITS, seed=3, real_time=True)
    rig.prepare(PLAN, lambda: False)
    monkeypatch.setattr(rig.camera.renderer, "live", NoLive())
    replayed = take(rig)
    rig.close()
    fast = VirtualRig("plane", limits=LIMITS, seed=3)
    expected = take(fast)
    fast.close()
    assert np.abs(replayed.astype(float) - expected).mean() < 5.0  # two draws of the same noise
    assert replayed.std() > 5.0


@pytest.mark.slow
def test_elsewhere_it_renders_live():
    replay = prerender(ORDER, NoLive(), lambda: False)
    with pytest.raises(AssertionError, match="rendered live"):
        replay.frame(500.0, 0.0, 0.0, 100.0, 1)
    with pytest.raises(AssertionError, match="rendered live"):
        replay.frame(*ORDER.views()[2, :3], 200.0, 1)


def test_it_can_be_stopped():
    assert prerender(ORDER, NoLive(), lambda: True) is None


@pytest.mark.slow
def test_a_process_that_fails_is_said_in_a_sentence():
    broken = PrerenderJob(scene="moon", seed=3, limits=LIMITS, plan=PLAN, here_um=(0.0, 0.0, 0.0))
    with pytest.raises(RigError, match=r"beforehand failed .*moon"):
        prerender(broken, NoLive(), lambda: False)


def test_a_disk_that_is_too_small_is_said_in_a_sentence(monkeypatch):
    def full(folder):
        return shutil._ntuple_diskusage(10**9, 10**9, 0)

    monkeypatch.setattr(shutil, "disk_usage", full)
    with pytest.raises(RigError, match=r"need 0.0 GB beforehand.*fewer fields"):
        prerender(ORDER, NoLive(), lambda: False)
