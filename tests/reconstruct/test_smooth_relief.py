"""Smooth steep relief without walls is kept, and cleaning does not flatten it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.campaigns import drawn_after
from tests.truth.relief import drawn_relief
from tests.truth.scenes import plane
from tests.truth.views import Camera, Optics, stack_of
from wafer_viewer.measure.truth_comparison import rmse
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.reconstruct.field_pipeline import reconstruct


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", drawn_after(1, [6, 9, 15])
)  # waves, rough ground with coarse texture, a plane along a diagonal
def test_smooth_relief_is_no_wall_and_no_step(seed: int) -> None:
    relief = drawn_relief(seed, 128)
    height = reconstruct(relief.stack, threads=1)
    kept = np.isfinite(height.z_raw_um)
    assert kept.mean() > 0.95
    assert np.isin(height.origin, (Origin.BLEEDING_EDGE, Origin.STEP_EDGE)).mean() < 0.01
    raw, cleaned = (rmse((z_um - relief.truth_um)[kept]) for z_um in (height.z_raw_um, height.z_um))
    assert cleaned <= 1.02 * raw
    assert raw < 0.15 * relief.step_um


@pytest.mark.slow
def test_a_clear_plane_is_whole_where_two_focus_widths_are_no_whole_number_of_frames() -> None:
    scene = plane(22, (96, 96), tilt=0.1)
    z_um = float(np.median(scene.truth_um)) + np.arange(-62.0, 62.0, 4.0)
    height = reconstruct(stack_of(scene, Optics(0.28), z_um, Camera(full_well_e=None)), threads=1)
    assert 2.2 < 2 * float(height.provenance.recipe.focus_width_um) / 4.0 < 2.5  # rivals are looked for 2 frames away
    assert height.measured.mean() > 0.99  # .89 when the fall over two frames had to be that over two widths
