"""Ground classes by noise: plain ground, unmeasured ground, patterns and walls. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import ReferenceDie
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.sliding_filters import sliding_range

PLAIN_TO = 4.0
"""Largest relief of plain ground, in median spreads."""
AROUND_PX = 5
KINDS = 4
"""Number of ground classes: plain (0), without heights (1), uneven in the image (2), uneven in the heights (3).

Plain ground without heights was nowhere in focus: the image there is an arbitrary blurred frame.
"""
Kinds = NDArray[np.uint8]


def kinds_of(golden: ReferenceDie) -> Kinds:
    """Return the ground class of every pixel of a cell."""
    layers = (golden.picture, golden.picture_spread), (golden.z_um, golden.z_spread_um)
    patterned, walled = (sliding_range(layer, AROUND_PX) > PLAIN_TO * _usual(spread) for layer, spread in layers)
    return np.select([walled, patterned, np.isnan(golden.z_um)], [3, 2, 1], 0).astype(np.uint8)


def coarser(kinds: Kinds, side: int) -> Kinds:
    """Return the most uneven ground class in squares of `side` pixels; incomplete squares are dropped."""
    rows, cols = (n // side for n in kinds.shape)
    return kinds[: rows * side, : cols * side].reshape(rows, side, cols, side).max(axis=(1, 3)) if side > 1 else kinds


def _usual(spread: Plane) -> float:
    known = spread[np.isfinite(spread)]
    return float(np.median(known)) if known.size else 1.0
