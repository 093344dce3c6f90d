"""Statistical outlier removal: points that are far from their nearest neighbours.

`lattice` looks for the neighbours among the pixels round a pixel and measures along z, `cloud` looks in the point cloud
as the paper does; both compare the mean distance to the nearest neighbours with its mean and deviation over the field.
On a clean field that deviation is tiny and the rule would eat the edges of steps, so it never counts as less than a
floor.

Three more kinds of pixel stand alone: those that smoothing had to move by more than the floor, those on strips narrower
than three quarters of the focus window, and those on islands with fewer pixels than the window. Whatever the window
sees shows as wide as the window; what is smaller was made up by light that bleeds over an edge.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Outliers, Recipe
from wafer_viewer.numerics.islands import narrow_parts, small_islands
from wafer_viewer.numerics.neighbours import REACH_PX, beyond, mean_distances

_SAMPLE_EVERY_PX = 7

Finder = Callable[[NDArray[np.float32], float, Outliers, float], NDArray[np.bool_]]


def find_outliers(
    raw_um: NDArray[np.float32], smoothed_um: NDArray[np.float32], pixel_um: float, recipe: Recipe
) -> NDArray[np.bool_]:
    """Which measured pixels of a map are outliers, by the settled recipe; bool [row, col]."""
    how, floor_um = recipe.outliers, float(recipe.outliers.floor_um)
    if how.mode == "none":
        return np.zeros(raw_um.shape, bool)
    found = FINDERS[how.mode](smoothed_um, pixel_um, how, floor_um) | (np.abs(smoothed_um - raw_um) > floor_um)
    rest = np.where(found, np.float32(np.nan), smoothed_um)
    window = int(recipe.window)
    rest[narrow_parts(rest, floor_um, 3 * window // 4)] = np.nan
    rest[small_islands(rest, floor_um, window**2)] = np.nan
    return np.isfinite(raw_um) & np.isnan(rest)


def _lattice(z_um: NDArray[np.float32], pixel_um: float, how: Outliers, floor_um: float) -> NDArray[np.bool_]:
    """The neighbours are the nearest of the 7 x 7 pixels round a pixel; a pixel with too few of them is an outlier."""
    neighbours = min(how.neighbours, (2 * REACH_PX + 1) ** 2 // 2)
    padded = np.pad(z_um, REACH_PX, constant_values=np.nan)
    rows, cols = np.nonzero(np.isfinite(z_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]))
    if not rows.size:
        return np.zeros(z_um.shape, bool)
    usual = mean_distances(padded, rows * _SAMPLE_EVERY_PX, cols * _SAMPLE_EVERY_PX, neighbours)
    return beyond(padded, neighbours, _threshold(usual, how, floor_um))


def _cloud(z_um: NDArray[np.float32], pixel_um: float, how: Outliers, floor_um: float) -> NDArray[np.bool_]:
    """The paper's form, through Open3D's neighbour search."""
    import open3d

    rows, cols = np.nonzero(np.isfinite(z_um))
    found = np.zeros(z_um.shape, bool)
    if len(rows) <= how.neighbours:
        return found
    points = np.stack([cols * pixel_um, -rows * pixel_um, z_um[rows, cols]], axis=1).astype(np.float64)
    cloud = open3d.core.Tensor.from_numpy(points)
    tree = open3d.core.nns.NearestNeighborSearch(cloud)
    tree.knn_index()
    _, squared = tree.knn_search(cloud, how.neighbours + 1)
    distance = np.sqrt(squared.numpy())[:, 1:].mean(axis=1)
    far = distance > _threshold(distance, how, floor_um)
    found[rows[far], cols[far]] = True
    return found


def _threshold(distances: NDArray[np.floating], how: Outliers, floor_um: float) -> float:
    known = distances[np.isfinite(distances)]
    if not known.size:
        return floor_um
    return float(known.mean() + max(how.n_sigma * known.std(), floor_um))


FINDERS: dict[str, Finder] = {"lattice": _lattice, "cloud": _cloud}
