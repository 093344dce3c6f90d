"""Small plans, frames and surfaces that the tests of the store share."""

from __future__ import annotations

import numpy as np

from tests.support.plans import plan_without_motion
from tests.support.surfaces import height_map
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Leg, PulseTrain, ScanPlan, Shot
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap, Origin

ROWS, COLS = 6, 8
CALIBRATION = Calibration(
    pixel_um=0.5, u_pixel_um=0.001, z_scale=1.01, u_z_scale=5e-4, made="2026-01-01", due="2027-01-01", against="grid 7"
)


def make_job(rows=1, cols=2, n_frames=4, exposures=1) -> Job:
    return Job(
        grid=FieldGrid(rows=rows, cols=cols, field_width_um=4.0, field_height_um=3.0),
        z_start_um=-10.0,
        sweep=FocusSweep(z_step_um=2.0, n_frames=n_frames),
        exposures_us=(100.0, 200.0)[:exposures],
    )


def make_plan(job: Job, rows=ROWS, cols=COLS) -> ScanPlan:
    plan = plan_without_motion(job, (rows, cols), 0.5)
    return replace(plan, legs=tuple(make_leg(job, field) for field in plan.fields))


def make_leg(job, field) -> Leg:
    shots = tuple(Shot(field.number, k) for k in range(job.sweep.n_frames))
    train = PulseTrain(axis="z", first_count=0, counts_per_frame=20, n_frames=len(shots), direction=1)
    return Leg(train=train, shots=shots, x_um=field.x_um, y_um=field.y_um, z_um=field.z_start_um, speed_um_s=50.0)


def make_image(shot: Shot, rows=ROWS, cols=COLS, dtype=np.uint8) -> np.ndarray:
    rng = np.random.default_rng([shot.field, shot.k, shot.exposure])
    return rng.integers(0, np.iinfo(dtype).max, (rows, cols), dtype=dtype)


def make_frame(shot: Shot, plan: ScanPlan, image=None, status=FrameStatus.OK) -> Frame:
    field = plan.field(shot.field)
    return Frame(
        shot=shot,
        pulse_count=shot.k,
        x_um=field.x_um,
        y_um=field.y_um,
        z_um=plan.sweep.z_um(field, shot.k) + 0.05,
        exposure_us=100.0,
        device_time_us=1000 * shot.k,
        status=status,
        image=make_image(shot) if image is None and status is FrameStatus.OK else image,
    )


def all_shots(plan: ScanPlan) -> list[Shot]:
    n_exposures = len(plan.exposures_us)
    return [Shot(f.number, k, e) for f in plan.fields for k in range(plan.sweep.n_frames) for e in range(n_exposures)]


SUMMARY = PulseSummary(emitted=4, suppressed=0, quadrature_errors=0, exposures=4)


def make_surface(
    rows=30, cols=40, pixel_um=0.5, x0_um=100.0, y0_um=50.0, seed=1, grey=np.uint8, **provenance
) -> HeightMap:
    """A noisy slope with a measured, a filled and an unmeasured part."""
    rng = np.random.default_rng(seed)
    z = (0.1 * np.arange(cols) + rng.normal(size=(rows, cols))).astype(np.float32)
    origin = np.zeros((rows, cols), np.uint8)
    origin[3:6, 4:9] = Origin.FILLED
    origin[10:16, 20:31] = Origin.NO_TEXTURE
    return height_map(
        np.where(origin >= 10, np.nan, z), pixel_um, x0_um, y0_um, origin=origin,
        z_raw_um=np.where(origin > 0, np.nan, z + 0.1), confidence=rng.random((rows, cols), np.float32),
        grey=rng.integers(0, np.iinfo(grey).max, (rows, cols), grey), **provenance,
    )  # fmt: skip


def assert_same_surface(a: HeightMap, b: HeightMap) -> None:
    for name in ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        assert getattr(a, name).dtype == getattr(b, name).dtype
    assert (a.pixel_um, a.x0_um, a.y0_um) == (b.pixel_um, b.x0_um, b.y0_um)
    assert a.provenance == b.provenance


class Source:
    """A mosaic that notes the largest window it is asked for."""

    def __init__(self, surface: HeightMap):
        self.surface, self.largest = surface, 0

    def __getattr__(self, name):
        return getattr(self.surface, name)

    def window(self, region=None, level=0):
        part = self.surface.window(region, level)
        self.largest = max(self.largest, part.z_um.size)
        return part
