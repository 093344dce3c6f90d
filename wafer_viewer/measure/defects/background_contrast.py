"""The picture of a surface without dies to compare: what is brighter or darker than all around it. Pure.

That says something of a plain surface only. On a pattern every edge is brighter than what is beside it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import LEAST_CONTRAST, robust_sigma
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.multiscale_gaussian import smooth

AROUND_PX = 20.0
"""Deviation of the Gaussian over which the mean around a place is taken."""
FAR, FEW = 6.0, 0.003
"""On a plain surface so few pixels, defects apart, lie so many deviations from what is around them."""
WIDE_PX, EVEN = 8.0, 0.3
"""On a plain surface a mean over so many pixels scatters by so much of what a pixel does, at most."""
LOOKED_AT = "The picture was compared with what is around each place: wide and faint stains do not show there."
LEFT_OUT = "The picture shows a pattern, or nothing, and was not looked at: only the heights were."


def against_around(picture: Plane) -> Plane:
    """Less the mean of what is known around; NaN where it is not known."""
    known = np.isfinite(picture)
    total, weight = (
        smooth(np.where(known, picture, np.float32(0)), AROUND_PX),
        smooth(known.astype(np.float32), AROUND_PX),
    )
    return np.where(known, picture - total / np.maximum(weight, np.float32(1e-6)), np.float32(np.nan)).astype(
        np.float32
    )


def contrast_of(picture: Plane) -> tuple[float, float]:
    """Deviation of a picture from what is around, and how plain it is: over 1 shows a pattern; NaN shows nothing.

    Noise and grain even out over WIDE_PX, and few pixels of a plain surface lie far off: a pattern has either.
    """
    contrast = against_around(picture)
    sigma = robust_sigma(contrast)
    if not sigma > 0:
        return float("nan"), float("nan")
    known = np.isfinite(contrast)
    wide = robust_sigma(smooth(np.where(known, contrast, np.float32(0)), WIDE_PX)) / sigma
    far = float((np.abs(contrast[known]) > FAR * max(sigma, LEAST_CONTRAST)).mean())
    return sigma, max(wide / EVEN, far / FEW)


def is_plain(patterned: NDArray[np.float64]) -> bool:
    """By the numbers of some cells, half of which may have their defects."""
    return bool(np.isfinite(patterned).any() and np.nanmedian(patterned) <= 1)
