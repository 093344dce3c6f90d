"""Statistical outlier removal: points that are far from their nearest neighbours.

`lattice` looks for the neighbours among the pixels round a pixel and measures along z, `cloud` looks in the point cloud
as the paper does; both compare the mean distance to the nearest neighbours with its mean and deviation over the field.
On a clean field that deviation is tiny and the rule would eat the edges of steps, so it never counts as less than a
floor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Outliers
from wafer_viewer.numerics.neighbours import REACH_PX, beyond, mean_distances

_SAMPLE_EVERY_PX = 7

Finder = Callable[[NDArray[np.float32], float, Outliers, float], NDArray[np.bool_]]


def find_outliers(z_um: NDArray[np.float32], pixel_um: float, how: Outliers, floor_um: float) -> NDArray[np.bool_]:
    """Which measured pixels of a map are outliers; bool [row, col]."""
    return FINDERS[how.mode](z_um, pixel_um, how, floor_um)


def _none(z_um: NDArray[np.float32], pixel_um: float, how: Outliers, floor_um: float) -> NDArray[np.bool_]:
    return np.zeros(z_um.shape, bool)


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
    tree = open3d.core.nns.NearestNeighborSearch(open3d.core.Tensor(points))
    tree.knn_index()
    _, squared = tree.knn_search(open3d.core.Tensor(points), how.neighbours + 1)
    distance = np.sqrt(squared.numpy())[:, 1:].mean(axis=1)
    far = distance > _threshold(distance, how, floor_um)
    found[rows[far], cols[far]] = True
    return found


def _threshold(distances: NDArray[np.floating], how: Outliers, floor_um: float) -> float:
    known = distances[np.isfinite(distances)]
    if not known.size:
        return floor_um
    return float(known.mean() + max(how.n_sigma * known.std(), floor_um))


FINDERS: dict[str, Finder] = {"none": _none, "lattice": _lattice, "cloud": _cloud}
