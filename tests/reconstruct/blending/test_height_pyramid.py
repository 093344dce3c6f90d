"""Half the resolution, nothing invented, no defect lost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.numerics.grids.pyramid_level import halve
from wafer_viewer.reconstruct.blending.stitched_mosaic import LAYERS, halved

MakeMap = Callable[..., HeightMap]


@settings(max_examples=30)
@given(rows=st.integers(1, 20), cols=st.integers(1, 20), seed=st.integers(0, 99))
def test_a_pixel_is_the_mean_of_what_was_measured_below_it(make_map: MakeMap, rows: int, cols: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 1, (rows, cols))
    z[rng.random(z.shape) < 0.4] = np.nan
    half = halved(make_map(z))
    assert half.shape == (-(-rows // 2), -(-cols // 2))
    for r in range(half.shape[0]):
        for c in range(half.shape[1]):
            below = z[2 * r : 2 * r + 2, 2 * c : 2 * c + 2]
            valid = below[np.isfinite(below)]
            if valid.size:
                assert half.z_um[r, c] == pytest.approx(valid.mean(), abs=1e-6)
            else:
                assert np.isnan(half.z_um[r, c])


def test_a_three_pixel_defect_is_still_there_at_the_top(make_map: MakeMap) -> None:
    z = np.zeros((256, 256))
    z[100:103, 77:80] = 12
    z[10, 10] = np.nan
    base = make_map(z)
    level = {name: getattr(base, name) for name in LAYERS}
    while max(level["z_um"].shape) > 1:
        level = halve(level)
    assert level["z_max_um"].item() == 12
    assert level["z_min_um"].item() == 0
    assert level["z_um"].item() < 0.1


def test_the_lattice_stays_where_it_is(make_map: MakeMap) -> None:
    base = make_map(np.add.outer(-np.arange(64) * 0.5, np.arange(32) * 0.5))
    half = halved(halved(base))
    np.testing.assert_allclose(half.z_um, half.y_um[:, None] + half.x_um[None, :], atol=1e-5)


def test_the_best_origin_of_the_four_counts(make_map: MakeMap) -> None:
    origin = np.array([[0, 12, 13, 13], [1, 11, 13, 1], [12, 12, 10, 10], [12, 13, 10, 10]], np.uint8)
    half = halved(make_map(np.zeros((4, 4)), origin=origin))
    assert half.origin.tolist() == [[Origin.MEASURED, Origin.FILLED], [Origin.NO_TEXTURE, Origin.NOT_COVERED]]


def test_uncovered_grey_does_not_darken_the_border(make_map: MakeMap) -> None:
    grey = np.array([[200, 0], [200, 0]], np.uint8)
    origin = np.array([[0, 10], [0, 10]], np.uint8)
    assert halved(make_map(np.zeros((2, 2)), all_in_focus=grey, origin=origin)).all_in_focus.tolist() == [[200]]
