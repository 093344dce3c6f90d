"""Outliers go, the edges of steps stay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Outliers, Recipe
from wafer_viewer.model.spec import replace
from wafer_viewer.reconstruct.outliers import find_outliers


def _recipe(mode: str = "lattice", floor_um: float = 6.0) -> Recipe:
    return Recipe(window=9, outliers=Outliers(mode=mode, floor_um=floor_um))


def _found(z: NDArray, recipe: Recipe) -> NDArray[np.bool_]:
    z = z.astype(np.float32)
    return find_outliers(z, z, 0.5, recipe)


def _die(noise_um: float = 0.1) -> NDArray:
    """A die with right-angled corners, 400 um over a floor."""
    z = np.random.default_rng(2).normal(0, noise_um, (120, 160))
    z[30:90, 40:120] += 400
    return z


@pytest.mark.parametrize("mode", ["lattice", "cloud"])
def test_spikes_are_found(mode: str) -> None:
    z = _die()
    spikes = tuple(np.random.default_rng(4).integers(5, 115, (2, 40)))
    z[spikes] += np.where(np.arange(40) % 2, 45, -45)
    found = _found(z, _recipe(mode))
    assert found[spikes].mean() > 0.95


def test_clean_steps_keep_their_edges_and_corners() -> None:
    assert not _found(_die(), _recipe()).any()
    assert not _found(_die(noise_um=0.0), _recipe()).any()


def test_a_step_keeps_its_edges_beside_unmeasured_pixels() -> None:
    z = _die()
    z[:, 38:42] = np.nan
    z[10:20, 10:90] = np.nan
    assert not _found(z, _recipe()).any()


def test_an_island_smaller_than_the_window_is_an_outlier_and_a_larger_one_is_not() -> None:
    z = np.zeros((80, 80))
    z[10:18, 10:20], z[40:50, 40:50] = 50, 50
    found = _found(z, _recipe())
    assert found[10:18, 10:20].all()
    assert not found[40:50, 40:50].any()


def test_a_strip_narrower_than_the_window_is_an_outlier_and_a_wider_one_is_not() -> None:
    z = np.zeros((80, 80))
    z[10:14, :], z[40:50, :] = 50, 50
    found = _found(z, _recipe())
    assert found[10:14].all()
    assert not found[:9].any()
    assert not found[16:].any()


def test_what_smoothing_moved_too_far_was_not_measured() -> None:
    raw = np.zeros((40, 40), np.float32)
    raw[20, 20] = 9
    found = find_outliers(raw, np.zeros_like(raw), 0.5, _recipe())
    assert found.sum() == 1
    assert found[20, 20]


def test_nothing_is_dropped_when_it_is_not_wanted() -> None:
    z = _die()
    z[50, 50] = 900
    assert not _found(z, _recipe("none")).any()


@pytest.mark.parametrize("mode", ["lattice", "cloud"])
def test_an_empty_map_has_no_outliers(mode: str) -> None:
    assert not _found(np.full((30, 30), np.nan), _recipe(mode)).any()


def test_lattice_and_cloud_agree_on_gross_errors() -> None:
    z = _die()
    z[60, 60] = z[100, 20] = 200
    recipe = _recipe()
    cloud = replace(recipe, outliers=replace(recipe.outliers, mode="cloud"))
    np.testing.assert_array_equal(_found(z, recipe)[[60, 100], [60, 20]], _found(z, cloud)[[60, 100], [60, 20]])
