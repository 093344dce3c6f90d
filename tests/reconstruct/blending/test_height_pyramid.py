"""Half the resolution, nothing invented, no defect lost."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from tests.support.direct_pyramid import assert_level, with_gaps
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.grids.pyramid_level import halve
from wafer_viewer.reconstruct.blending.mosaic_layout import layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import (
    LAYERS,
    StitchedMosaic,
    coarser_levels,
    layers_of,
    mosaic_provenance,
)
from wafer_viewer.reconstruct.comparison.compare import as_pyramid

MakeMap = Callable[..., HeightMap]


def halved(height: HeightMap) -> HeightMap:
    return next(coarser_levels(height))


@settings(max_examples=examples(30))
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
    half = next(islice(coarser_levels(base), 1, None))
    np.testing.assert_allclose(half.z_um, half.y_um[:, None] + half.x_um[None, :], atol=1e-5)


def test_the_best_origin_of_the_four_counts(make_map: MakeMap) -> None:
    origin = np.array([[0, 12, 13, 13], [1, 11, 13, 1], [12, 12, 10, 10], [12, 13, 10, 10]], np.uint8)
    half = halved(make_map(np.zeros((4, 4)), origin=origin))
    assert half.origin.tolist() == [[Origin.MEASURED, Origin.FILLED], [Origin.NO_TEXTURE, Origin.NOT_COVERED]]


def test_uncovered_grey_does_not_darken_the_border(make_map: MakeMap) -> None:
    grey = np.array([[200, 0], [200, 0]], np.uint8)
    origin = np.array([[0, 10], [0, 10]], np.uint8)
    assert halved(make_map(np.zeros((2, 2)), all_in_focus=grey, origin=origin)).all_in_focus.tolist() == [[200]]


@pytest.mark.parametrize("seed", range(3))
def test_a_pixel_of_every_level_is_the_mean_of_the_measured_pixels_of_the_map(make_map: MakeMap, seed: int) -> None:
    base = with_gaps(make_map(np.zeros((90, 133))), seed)
    for level, coarse in enumerate(islice(coarser_levels(base), 7), 1):
        assert_level(layers_of(coarse), base, level)
    layers = layers_of(base)
    for level in range(1, 8):
        layers = halve(layers)
        assert_level(layers, base, level)


@pytest.mark.slow
def test_levels_that_are_computed_when_they_are_read_are_such_means_too(make_map: MakeMap) -> None:
    base = with_gaps(make_map(np.zeros((1100, 700))))
    mosaic = StitchedMosaic([base], layout([base]), mosaic_provenance([base.provenance], Recipe()))
    for level in (2, mosaic.levels - 1):
        expected = {name: layer for name, layer in layers_of(base).items() if name != "overlap_um"}
        read = layers_of(mosaic.window(level=level))
        assert_level({name: read[name] for name in expected}, base, level)
        assert_level(layers_of(as_pyramid(base).window(level=level)), base, level)


def test_grey_does_not_rise_from_level_to_level(make_map: MakeMap) -> None:
    grey = np.random.default_rng(4).integers(0, 255, (1024, 1024)).astype(np.uint8)
    top = next(islice(coarser_levels(make_map(np.zeros(grey.shape), all_in_focus=grey)), 6, None))
    assert top.all_in_focus.mean() == pytest.approx(grey.mean(), abs=0.2)
