"""Statistical outlier removal: points that are far from their nearest neighbours.

`cloud` is the paper's form: neighbours in the point cloud, with their mean distance compared to its mean and deviation
over the field. `lattice` takes the neighbours among the surrounding pixels and measures along z. On a clean field that
deviation is tiny and the rule would remove the edges of steps, so it has a lower bound.

`lattice` detects three more kinds of isolated pixels: those that smoothing moved by much more than usual, those on
strips narrower than three quarters of the focus window, and those on islands smaller than the square of two windows.
Any real structure appears at least as wide as the window; smaller ones are artefacts of light that bleeds over an edge.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.recipe import Outliers, Recipe
from wafer_viewer.numerics.filters.connected_components import narrow_parts, small_components
from wafer_viewer.numerics.filters.neighbour_distances import REACH_PX, mean_distances, near_counts
from wafer_viewer.numerics.filters.spline_fill import fill_gaps

BRIDGED_PX = 2
"""Gaps up to this size are bridged when the width of a strip is measured."""

_SAMPLE_EVERY_PX = 7
_MOVED_DEVIATIONS = 6.0
_MOVED_FLOORS = 1 / 3
_MAD_TO_DEVIATION = 1.4826

Map = NDArray[np.float32]
Found = NDArray[np.bool_]


def find_outliers(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    """Return a mask of the outliers among the measured pixels, by the settled recipe; bool [row, col]."""
    return FINDERS[recipe.outliers.mode](raw_um, smoothed_um, pixel_um, recipe)


def _none(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    return np.zeros(raw_um.shape, bool)


def _lattice(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    """Judge moved pixels at their smoothed position, so that one wrong pixel does not make a strip narrow."""
    floor_um, window = float(recipe.outliers.floor_um), int(recipe.window)
    found = far_on_lattice(smoothed_um, recipe.outliers) | _moved(raw_um, smoothed_um, floor_um)
    found |= narrow_parts(fill_gaps(smoothed_um, BRIDGED_PX, floor_um), floor_um, 3 * window // 4)
    rest = np.where(found, np.float32(np.nan), smoothed_um)
    found |= small_components(rest, floor_um, (2 * window) ** 2)
    return found & np.isfinite(raw_um)


def _cloud(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    return far_in_cloud(smoothed_um, pixel_um, recipe.outliers)


def _moved(raw_um: Map, smoothed_um: Map, floor_um: float) -> Found:
    moved_um = np.abs(smoothed_um - raw_um)
    some = moved_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]
    usual_um = _MAD_TO_DEVIATION * float(np.median(some[np.isfinite(some)])) if np.isfinite(some).any() else 0.0
    return moved_um > max(_MOVED_FLOORS * floor_um, _MOVED_DEVIATIONS * usual_um)


def far_on_lattice(z_um: Map, how: Outliers) -> Found:
    """Detect outliers by the mean distance to the nearest of 7 x 7 pixels; too few neighbours also count.

    Beyond its border the map is extended by its edge values, so that the edge of a step is no outlier there. Pixels
    with enough neighbours within the threshold are skipped, which leaves few to test.
    """
    neighbours = min(how.neighbours, (2 * REACH_PX + 1) ** 2 // 2)
    padded = np.pad(z_um, REACH_PX, mode="edge")
    found = np.zeros(z_um.shape, bool)
    rows, cols = np.nonzero(np.isfinite(z_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]))
    if not rows.size:
        return found
    usual = mean_distances(padded, rows * _SAMPLE_EVERY_PX, cols * _SAMPLE_EVERY_PX, neighbours)
    threshold_um = _threshold(usual, how)
    rows, cols = np.nonzero(np.isfinite(z_um) & (near_counts(padded, threshold_um) < neighbours))
    found[rows, cols] = mean_distances(padded, rows, cols, neighbours) > threshold_um
    return found


def far_in_cloud(z_um: Map, pixel_um: float, how: Outliers) -> Found:
    """Detect outliers by the paper's method, with Open3D's neighbour search."""
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
    far = distance > _threshold(distance, how)
    found[rows[far], cols[far]] = True
    return found


def _threshold(distances: NDArray[np.floating], how: Outliers) -> float:
    known, floor_um = distances[np.isfinite(distances)], float(how.floor_um)
    if not known.size:
        return floor_um
    return float(known.mean() + max(how.n_sigma * known.std(), floor_um))


FINDERS: dict[str, Callable[[Map, Map, float, Recipe], Found]] = {"none": _none, "lattice": _lattice, "cloud": _cloud}
"""Each takes the raw and the smoothed map, the pixel size and the settled recipe."""
