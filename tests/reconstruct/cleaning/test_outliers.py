"""Outliers go, the edges of steps stay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.model.surface.recipe import Outliers, Recipe
from wafer_viewer.numerics.open3d_library import load_open3d
from wafer_viewer.reconstruct.cleaning.clean import clean, far_in_cloud, far_on_lattice, find_outliers, settle_cleaning


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


def test_a_step_keeps_its_edges_next_to_unmeasured_pixels() -> None:
    z = _die()
    z[:, 38:42] = np.nan
    z[10:20, 10:90] = np.nan
    assert not _found(z, _recipe()).any()


def test_what_smoothing_moved_too_far_was_not_measured() -> None:
    raw = np.zeros((40, 40), np.float32)
    raw[20, 20] = 9
    found = find_outliers(raw, np.zeros_like(raw), 0.5, _recipe())
    assert found.sum() == 1
    assert found[20, 20]


def test_smoothing_that_moves_every_pixel_far_drops_none_for_that() -> None:
    raw = _die().astype(np.float32)
    everywhere = np.random.default_rng(1).normal(0, 5, raw.shape).astype(np.float32)
    assert find_outliers(raw + everywhere, raw, 0.5, _recipe()).mean() < 0.001


STEPS = [(2.0, 0), (5.0, 0), (8.0, 0), (20.0, 0), (60.0, 0), (399.88, 0), (2.0, 3), (8.0, 3), (20.0, 8), (60.0, 20)]


@pytest.mark.parametrize(("rise_um", "wide_px"), STEPS)
@pytest.mark.parametrize("aslant", [False, True])
def test_the_edge_of_a_step_stays_whatever_its_height_and_slope(rise_um: float, wide_px: int, aslant: bool) -> None:
    """Through the whole of the cleaning, with noise; no slope so steep that a pixel rises by more than the floor."""
    rows, cols = np.indices((100, 120)).astype(float)
    across = (2 * cols - rows - 70.5) / 5**0.5 if aslant else cols - 60.5
    z = np.clip(across / max(wide_px, 1e-3) + 0.5, 0, 1) * rise_um
    z = (z + np.random.default_rng(3).normal(0, 0.1, z.shape)).astype(np.float32)
    assert not clean(z, 0.5, settle_cleaning([z], Recipe(window=9), 4.0), 4.0).outlier.any()


def test_spikes_do_not_take_what_is_around_them() -> None:
    rng = np.random.default_rng(5)
    z = _die()
    spikes = rng.random(z.shape) < 0.05
    z[spikes] += rng.uniform(20, 90, np.count_nonzero(spikes)) * rng.choice([-1, 1], np.count_nonzero(spikes))
    z[rng.random(z.shape) < 0.02] = np.nan
    recipe = settle_cleaning([z.astype(np.float32)], Recipe(window=9), 4.0)
    dropped = clean(z.astype(np.float32), 0.5, recipe, 4.0).outlier
    valid = np.isfinite(z)
    assert dropped[spikes & valid].mean() > 0.97
    assert dropped[~spikes & valid].mean() < 0.01


def test_nothing_is_dropped_when_it_is_not_wanted() -> None:
    z = _die()
    z[50, 50] = 900
    assert not _found(z, _recipe("none")).any()


@pytest.mark.parametrize("mode", ["lattice", "cloud"])
def test_an_empty_map_has_no_outliers(mode: str) -> None:
    assert not _found(np.full((30, 30), np.nan), _recipe(mode)).any()


def test_the_paper_s_form_drops_what_is_far_from_its_neighbours_and_nothing_else() -> None:
    z = np.zeros((80, 80))
    z[10:14, :] = 50
    assert not _found(z, _recipe("cloud")).any()


def test_the_paper_s_form_is_open3d_s_statistical_outlier_removal() -> None:
    """Open3D counts a point among its own neighbours, at no distance."""
    z = _die(noise_um=0.5)
    rng = np.random.default_rng(5)
    false = rng.random(z.shape) < 0.05
    z[false] += rng.uniform(-60, 60, np.count_nonzero(false))
    z[rng.random(z.shape) < 0.03] = np.nan
    rows, cols = np.nonzero(np.isfinite(z))
    open3d = load_open3d()
    points = open3d.utility.Vector3dVector(np.stack([0.5 * cols, 0.5 * rows, z[rows, cols].astype(np.float32)], axis=1))
    _, kept = open3d.geometry.PointCloud(points).remove_statistical_outlier(16, 1.0)
    removed = np.isfinite(z)
    removed[rows[kept], cols[kept]] = False
    found = far_in_cloud(z.astype(np.float32), 0.5, Outliers(mode="cloud", n_sigma=1.0, floor_um=0.001))
    assert 100 < np.count_nonzero(found) < 0.2 * z.size
    np.testing.assert_array_equal(found, removed)


@pytest.mark.parametrize(("n_sigma", "noise_um", "apart"), [(1.0, 0.2, 0.0005), (3.0, 0.2, 0.002), (3.0, 0.5, 0.002)])
def test_lattice_and_cloud_drop_the_same_points(n_sigma: float, noise_um: float, apart: float) -> None:
    """Over a slope, a step and 1 % of errors: all but a few in a thousand points are judged alike."""
    rng = np.random.default_rng(0)
    rows, cols = np.indices((200, 240))
    z = 0.05 * cols + rng.normal(0, noise_um, rows.shape)
    z[60:140, 80:180] += 40
    wrong = rng.random(z.shape) < 0.01
    z[wrong] += rng.uniform(8, 60, np.count_nonzero(wrong)) * rng.choice([-1, 1], np.count_nonzero(wrong))
    how = Outliers(n_sigma=n_sigma, floor_um=4.0)
    lattice, cloud = far_on_lattice(z.astype(np.float32), how), far_in_cloud(z.astype(np.float32), 0.467, how)
    assert np.mean(lattice != cloud) <= apart
    assert lattice[wrong].mean() > 0.85
    assert cloud[wrong].mean() > 0.95
