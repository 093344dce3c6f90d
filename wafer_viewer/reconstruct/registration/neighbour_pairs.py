"""Which fields overlap enough to be compared, wherever they lie: a grid is not assumed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Outline

LEAST_SIDE_FRACTION = 0.5
"""Neighbours share half of a side at least: corners that meet have little to compare, and others tell it better."""
LEAST_WIDTH_PX = 12.0
"""A narrower overlap is gone when the stage is off by a usual amount."""

Numbers = NDArray[np.float64]


def neighbours(outlines: Sequence[Outline]) -> NDArray[np.int32]:
    """Pairs of fields that overlap enough to be compared, int32 [n, 2] by their place in the list, first < second.

    They share at least half of a side (of the shorter one where they differ), along an overlap of at least 12 px. Those
    whose centres are nearer to each other than the largest field is wide and high are found by a k-d tree, so that a
    million fields take seconds. The pairs are sorted.
    """
    low, high, pixel_um = _boxes(outlines)
    pairs = _near(low, high)
    first, second = pairs[:, 0], pairs[:, 1]
    shared = np.minimum(high[first], high[second]) - np.maximum(low[first], low[second])
    side = np.minimum(high[first] - low[first], high[second] - low[second])
    beside = (shared >= LEAST_SIDE_FRACTION * side).any(axis=1)
    enough = (shared >= LEAST_WIDTH_PX * pixel_um[first, None]).all(axis=1)
    kept = pairs[beside & enough]
    return kept[np.lexsort((kept[:, 1], kept[:, 0]))].astype(np.int32)


def _boxes(outlines: Sequence[Outline]) -> tuple[Numbers, Numbers, Numbers]:
    """The low and high corners (x, y) of all fields, [n, 2], pixels counted whole, and their pixel sizes."""
    told = np.array([(o.x0_um, o.y0_um, o.pixel_um, *o.shape) for o in outlines], np.float64).reshape(-1, 5)
    x0, y0, pixel, rows, cols = told.T
    low = np.stack([x0 - pixel / 2, y0 - (rows - 0.5) * pixel], axis=1)
    high = np.stack([x0 + (cols - 0.5) * pixel, y0 + pixel / 2], axis=1)
    return low, high, pixel


def _near(low: Numbers, high: Numbers) -> NDArray[np.intp]:
    """Pairs whose boxes may overlap, [n, 2], first < second."""
    from scipy.spatial import KDTree

    if len(low) < 2:
        return np.zeros((0, 2), np.intp)
    largest = (high - low).max(axis=0)
    tree = KDTree((low + high) / (2 * largest), balanced_tree=False, compact_nodes=False)
    pairs: NDArray[np.intp] = tree.query_pairs(1.0, p=np.inf, output_type="ndarray")
    return np.sort(pairs, axis=1)
