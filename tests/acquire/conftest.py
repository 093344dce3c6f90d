"""A rig whose pictures say where they were taken, and a sink that remembers."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

ROWS, COLS = 16, 24


class PlaceRenderer:
    """Pictures whose bytes are the true place and the exposure."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        image = np.zeros((ROWS, COLS), np.uint8)
        image[0] = np.frombuffer(np.array([x_um, y_um, z_um]).tobytes(), np.uint8)
        image[1, :8] = np.frombuffer(np.array([exposure_us]).tobytes(), np.uint8)
        return image


def place_of(image):
    """(x, y, z) and the exposure that a PlaceRenderer was asked for."""
    x, y, z = np.frombuffer(image[0].tobytes(), np.float64)
    return (x, y, z), np.frombuffer(image[1, :8].tobytes(), np.float64)[0]


class Recorder:
    """Fulfils ScanSink in memory, and keeps what it was told in its order."""

    def __init__(self):
        self.frames = []
        self.events = []

    def pass_begun(self, number, leg):
        self.events.append(("begun", number))

    def frame(self, frame):
        self.frames.append(frame)
        self.events.append(("frame", frame.shot))

    def missed(self, shot, pulse_count, why):
        self.events.append(("missed", shot, pulse_count, why))

    def repaired(self, shot):
        self.events.append(("repaired", shot))

    def pass_ended(self, number, summary):
        self.events.append(("ended", number))

    def fault(self, what):
        self.events.append(("fault", what))

    def of_kind(self, kind):
        return [event for event in self.events if event[0] == kind]


class Control:
    """Fulfils ScanControl: stops or pauses after so many frames."""

    def __init__(self, stop_after=None, pause_after=None):
        self.taken = 0
        self.pauses = 0
        self.stop_after, self.pause_after = stop_after, pause_after

    def should_stop(self):
        return self.stop_after is not None and self.taken >= self.stop_after

    def should_pause(self):
        return self.pause_after is not None and self.taken >= self.pause_after

    def wait_while_paused(self):
        self.pauses += 1
        self.pause_after = None

    def progress(self, plan, frame):
        self.taken += 1


@pytest.fixture
def limits():
    return virtual_limits(1080, 1440)


@pytest.fixture
def place():
    return place_of


@pytest.fixture
def control():
    return Control


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def virtual_rig():
    """A function that switches a rig on, its pictures saying where they were taken."""
    rigs = []

    def switch_on(**settings):
        settings = {"renderer": PlaceRenderer(), "limits": virtual_limits(ROWS, COLS), **settings}
        rigs.append(VirtualRig(**settings))
        return rigs[-1]

    yield switch_on
    for rig in rigs:
        rig.close()


@pytest.fixture
def small_plan():
    """A function that lays 2 x 2 fields and 20 frames on a rig."""

    def lay(rig, strategy="auto", rows=2, cols=2, n_frames=20, exposures_us=(100.0,)):
        grid = FieldGrid(rows=rows, cols=cols, field_width_um=336.0, field_height_um=252.0)
        sweep = FocusSweep(z_step_um=1.0, n_frames=n_frames)
        return plan_scan(grid.fields(5.0), sweep, exposures_us, rig.limits, strategy)

    return lay
