"""Where the reference is uneven or unknown: on edges, walls and what has no grain everything errs further. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import ReferenceDie
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.sliding_filters import relief

PLAIN_TO = 4.0
"""In usual spreads: plain ground rises and falls by so much at most."""
AROUND_PX = 5
KINDS = 4
"""Of ground: plain is 0, without heights 1, where the picture is uneven 2, where the heights are 3: patterns and walls.
Where no height is known of plain ground nothing was in focus: the picture shows one blurred frame or another."""
Kinds = NDArray[np.uint8]


def kinds_of(golden: ReferenceDie) -> Kinds:
    """The kind of ground of every pixel of a cell."""
    layers = (golden.picture, golden.picture_spread), (golden.z_um, golden.z_spread_um)
    patterned, walled = (relief(layer, AROUND_PX) > PLAIN_TO * _usual(spread) for layer, spread in layers)
    return np.select([walled, patterned, np.isnan(golden.z_um)], [3, 2, 1], 0).astype(np.uint8)


def coarser(kinds: Kinds, side: int) -> Kinds:
    """Of squares of `side` pixels, the most uneven of these; what is left over at the end is left out."""
    rows, cols = (n // side for n in kinds.shape)
    return kinds[: rows * side, : cols * side].reshape(rows, side, cols, side).max(axis=(1, 3)) if side > 1 else kinds


def _usual(spread: Plane) -> float:
    known = spread[np.isfinite(spread)]
    return float(np.median(known)) if known.size else 1.0
