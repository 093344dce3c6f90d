"""Search for pairs of fields with sufficient overlap, without assuming a grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Outline

LEAST_SIDE_FRACTION = 0.5
"""Minimum shared fraction of a side; corner overlaps have little to compare and others are more informative."""
LEAST_WIDTH_PX = 12.0
"""A narrower overlap vanishes when the stage is off by a typical error."""

Numbers = NDArray[np.float64]


def neighbours(outlines: Sequence[Outline]) -> NDArray[np.int32]:
    """Return the pairs of fields with sufficient overlap, int32 [n, 2] indices with first < second.

    They share at least half of a side (of the shorter one where they differ), along an overlap of at least 12 px.
    Candidates, whose centres are closer to each other than the width and height of the largest field, are found by a
    k-d tree, so that a million fields take seconds. The pairs are sorted.
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
    """Return the low and high corners (x, y) of all fields, [n, 2], including border pixels, and pixel sizes."""
    told = np.array([(o.x0_um, o.y0_um, o.pixel_um, *o.shape) for o in outlines], np.float64).reshape(-1, 5)
    x0, y0, pixel, rows, cols = told.T
    low = np.stack([x0 - pixel / 2, y0 - (rows - 0.5) * pixel], axis=1)
    high = np.stack([x0 + (cols - 0.5) * pixel, y0 + pixel / 2], axis=1)
    return low, high, pixel


def _near(low: Numbers, high: Numbers) -> NDArray[np.intp]:
    """Return the pairs whose boxes may overlap, [n, 2], first < second."""
    from scipy.spatial import KDTree

    if len(low) < 2:
        return np.zeros((0, 2), np.intp)
    largest = (high - low).max(axis=0)
    tree = KDTree((low + high) / (2 * largest), balanced_tree=False, compact_nodes=False)
    pairs: NDArray[np.intp] = tree.query_pairs(1.0, p=np.inf, output_type="ndarray")
    return np.sort(pairs, axis=1)
