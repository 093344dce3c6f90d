"""How far a plane rises and falls round each pixel."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.arrays import Float32s


def relief(plane: Float32s, side_px: int, *, repeats: bool = False) -> Float32s:
    """Highest less lowest of what is known within a square of side_px pixels round each, 0 where nothing is.

    repeats: beyond a border the plane goes on with the opposite one.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    known, beyond = np.isfinite(plane), "wrap" if repeats else "nearest"
    high = maximum_filter(np.where(known, plane, np.float32(-np.inf)), side_px, mode=beyond)
    low = minimum_filter(np.where(known, plane, np.float32(np.inf)), side_px, mode=beyond)
    return np.where(high >= low, high - low, np.float32(0))
