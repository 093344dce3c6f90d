"""A whole scan with the frames of a GigE camera: virtual stage and pulse box, whose pulses are software triggers."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

ROWS, COLS = 48, 64
RATE_HZ = 1.0  # slow: software triggers come tens of ms late on a busy machine; a twentieth of the period is allowed


class PolledCamera:
    """A camera that lets the time of the virtual rig pass while it waits."""

    def __init__(self, camera, clock):
        self._camera, self._clock = camera, clock
        self.start, self.stop = camera.start, camera.stop

    def next_image(self, timeout_s):
        fetched = []

        def poll():
            image = self._camera.next_image(0.0)
            fetched.extend([] if image is None else [image])
            return bool(fetched)

        self._clock.wait_for(poll, timeout_s)
        return fetched[0] if fetched else None


class GigERig(VirtualRig):
    def __init__(self, camera):
        limits = virtual_limits(ROWS, COLS)
        slow = replace(limits.camera, frame_rate_hz=RATE_HZ)
        super().__init__(limits=replace(limits, camera=slow), real_time=True)
        self._gige = camera
        self.polled = PolledCamera(camera, self.clock)

    @property
    def camera(self):
        return self.polled

    def prepare(self, plan, should_stop):
        pass

    def _triggered(self, time_s):
        self._gige.fire()
        return True


class Sink:
    def __init__(self):
        self.runs, self.reasons = [], []

    def pass_begun(self, number, leg):
        self.runs.append((leg, {}))

    def frame(self, frame):
        self.runs[-1][1][frame.shot] = frame

    def missed(self, shot, pulse_count, why):
        self.reasons.append(why)
        self.runs[-1][1].pop(shot, None)

    def ignore(self, *_):
        pass

    fault = pass_ended = repaired = ignore


class Control:
    def should_stop(self):
        return False

    should_pause = should_stop

    def progress(self, plan, frame):
        pass


def slots_off(leg, frames, limits):
    """How many slots each frame of a pass is off the one that its time tells."""
    period_us = limits.z.position_um(leg.train.counts_per_frame) / leg.speed_um_s * 1e6
    places = np.array([leg.shots.index(frame.shot) for frame in frames])
    off = np.array([frame.device_time_us for frame in frames]) / period_us - places
    return off - np.median(off)


@pytest.mark.campaign
def test_frames_with_lost_packets_are_taken_again_and_none_slips(aravis):
    fake, connect = aravis
    fake(lost=0.08)
    rig = GigERig(connect(trigger="Software", rows=ROWS, cols=COLS))
    fields = tuple(Field(number=i, row=0, col=i, x_um=50.0 * i, y_um=0.0, z_start_um=0.0) for i in (1, 2))
    plan = plan_scan(fields, FocusSweep(z_step_um=1.0, n_frames=6), (1000.0,), rig.limits, "z_snake")
    sink = Sink()
    outcome = run_scan(plan, rig, sink, Control())
    rig.close()
    kept = [(leg, list(frames.values())) for leg, frames in sink.runs if frames]
    assert sum(len(frames) for _, frames in kept) == outcome.kept == plan.n_frames - len(outcome.missing)
    assert len(outcome.missing) <= 2
    for leg, frames in kept:
        assert all(frame.status is FrameStatus.OK and frame.image.shape == (ROWS, COLS) for frame in frames)
        assert np.abs(slots_off(leg, frames, rig.limits)).max() < 0.5
