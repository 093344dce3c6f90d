"""By which plane the heights of two fields differ where both saw the surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.overlapping_tiles import PIXEL_UM, Sample, a_field, a_sample, with_heights
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.height_seams import compare, compare_pair

SHAPE = (160, 200)
BESIDE, BELOW = (0, 150), (120, 0)


@pytest.fixture(scope="module")
def sample() -> Sample:
    return a_sample((400, 420))


def centre(height: HeightMap, off_px: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """Where the centre truly is, in um."""
    rows, cols = height.shape
    return (
        height.x0_um + ((cols - 1) / 2 + off_px[1]) * PIXEL_UM,
        height.y0_um - ((rows - 1) / 2 + off_px[0]) * PIXEL_UM,
    )


def leant(height: HeightMap, z_um: float, tilt_x: float, tilt_y: float, at_um: tuple[float, float]) -> HeightMap:
    """Heights too high by z_um + tilt_x (x - centre x) + tilt_y (y - centre y)."""
    rows, cols = np.indices(height.shape)
    x = (cols - (height.shape[1] - 1) / 2) * PIXEL_UM
    y = -(rows - (height.shape[0] - 1) / 2) * PIXEL_UM
    return with_heights(height, height.z_raw_um + z_um + tilt_x * x + tilt_y * y)


@pytest.mark.parametrize("neighbour", [BESIDE, BELOW], ids=["beside", "below"])
@pytest.mark.parametrize("off_px", [(0.0, 0.0), (-6.4, 3.7)])
def test_offset_and_tilts_are_found(sample, neighbour, off_px):
    first = a_field(sample, 50, 50, SHAPE, seed=1)
    second = a_field(sample, 50 + neighbour[0], 50 + neighbour[1], SHAPE, off_px=off_px, seed=2)
    at, other_at = centre(first), centre(second, off_px)
    lean = 1.3, 2e-3, -1e-3
    seam = compare_pair(first, leant(second, *lean, other_at), at, other_at)
    u = np.sqrt(np.diag(np.linalg.inv(seam.information)))
    expected_um = lean[0] + lean[1] * (seam.mid_x_um - other_at[0]) + lean[2] * (seam.mid_y_um - other_at[1])
    assert seam.z_um == pytest.approx(expected_um, abs=4 * u[0])
    assert seam.slope_x == pytest.approx(lean[1], abs=4 * u[1])
    assert seam.slope_y == pytest.approx(lean[2], abs=4 * u[2])
    assert u[0] < 0.01
    thin, long = (u[1], u[2]) if neighbour == BESIDE else (u[2], u[1])
    assert thin > 2 * long
    smoothed = 1.0 if off_px == (0, 0) else 0.52 * 0.58
    assert seam.rms_um == pytest.approx(0.05 * (1 + smoothed) ** 0.5, rel=0.1)
    mid_x_um = (at[0] + other_at[0]) / 2
    assert seam.mid_x_um == pytest.approx(mid_x_um, abs=1.0)


def test_walls_that_do_not_quite_lie_on_each_other_do_not_matter(sample):
    rows, cols = np.indices(sample.z_um.shape)
    walls = Sample(sample.grey, 0.1 * sample.z_um + 30 * np.clip((cols % 37 - 18) / 5, -1, 1) * (rows > 0))
    first = a_field(walls, 50, 50, SHAPE, seed=1)
    second = a_field(walls, 50, 200, SHAPE, seed=2)
    at, (x_um, y_um) = centre(first), centre(second)
    seam = compare_pair(first, second, at, (x_um + 0.3 * PIXEL_UM, y_um))
    assert abs(seam.z_um) < 0.05
    assert abs(seam.slope_x) < 5e-3


def test_false_heights_do_not_matter(sample):
    rng = np.random.default_rng(0)
    first, second = (a_field(sample, 50, col, SHAPE, seed=col) for col in (50, 200))
    spoilt = second.z_raw_um.copy()
    spoilt[rng.random(SHAPE) < 0.2] += rng.uniform(5, 80)
    seam = compare_pair(first, with_heights(second, spoilt), centre(first), centre(second))
    assert abs(seam.z_um) < 0.01


def test_without_heights_or_overlap_nothing_is_known(sample):
    first, second, far = (a_field(sample, 50, col, SHAPE) for col in (20, 170, 200))
    far = dataclasses.replace(far, x0_um=first.x0_um + 500)
    empty = with_heights(second, np.full(SHAPE, np.nan))
    heights = [first, second, empty, far]
    x, y = np.array([centre(h) for h in heights]).T
    seams = compare(heights, np.array([[0, 1], [0, 2], [0, 3]], np.int32), x, y, threads=2)
    assert seams.n_pixels.tolist()[1:] == [0, 0]
    assert seams.weight.tolist() == [1, 0, 0]
    assert not seams.information[1:].any()
    assert np.isnan(seams.step_um[1:]).all()
    assert np.isnan(seams.rms_um[1:]).all()
    assert seams.step_um[0] == seams.z_um[0]
    assert compare(heights, np.zeros((0, 2), np.int32), x, y).information.shape == (0, 3, 3)


def test_order_of_the_two_turns_the_sign(sample):
    first = a_field(sample, 50, 50, SHAPE, seed=1)
    second = leant(a_field(sample, 50, 200, SHAPE, seed=2), 0.7, 1e-3, 0, (0, 0))
    present, back = compare(
        [first, second], np.array([[0, 1], [1, 0]], np.int32), *np.array([centre(first), centre(second)]).T
    ).z_um
    assert present == pytest.approx(-back, abs=2e-3)
