"""Local contrast of the image of a surface without dies. Pure.

It is meaningful on a plain surface only. On a pattern every edge contrasts with its neighbourhood.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import LEAST_CONTRAST, robust_sigma
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.multiscale_gaussian import smooth

AROUND_PX = 20.0
"""Standard deviation of the Gaussian for the local mean."""
FAR, FEW = 6.0, 0.003
"""Outlier limit in deviations of the local contrast; largest outlier fraction of a plain surface, defects aside."""
WIDE_PX, EVEN = 8.0, 0.3
"""Smoothing width, and the largest ratio of smoothed to single-pixel scatter of a plain surface."""
LOOKED_AT = "The picture was compared with what is around each place: wide and faint stains do not show there."
LEFT_OUT = "The picture shows a pattern, or nothing, and was not looked at: only the heights were."


def subtract_local_mean(picture: Plane) -> Plane:
    """Subtract the local mean of the known pixels; NaN where unknown."""
    known = np.isfinite(picture)
    total, weight = (
        smooth(np.where(known, picture, np.float32(0)), AROUND_PX),
        smooth(known.astype(np.float32), AROUND_PX),
    )
    return np.where(known, picture - total / np.maximum(weight, np.float32(1e-6)), np.float32(np.nan)).astype(
        np.float32
    )


def contrast_of(picture: Plane) -> tuple[float, float]:
    """Return the scatter of the local contrast and a pattern measure: over 1 for a pattern, NaN for an empty image.

    Noise and grain average out over WIDE_PX, and few pixels of a plain surface are outliers; a pattern violates either.
    """
    contrast = subtract_local_mean(picture)
    sigma = robust_sigma(contrast)
    if not sigma > 0:
        return float("nan"), float("nan")
    known = np.isfinite(contrast)
    wide = robust_sigma(smooth(np.where(known, contrast, np.float32(0)), WIDE_PX)) / sigma
    far = float((np.abs(contrast[known]) > FAR * max(sigma, LEAST_CONTRAST)).mean())
    return sigma, max(wide / EVEN, far / FEW)


def is_plain(patterned: NDArray[np.float64]) -> bool:
    """Return whether a surface is plain, by the pattern measures of some cells; up to half may have defects."""
    return bool(np.isfinite(patterned).any() and np.nanmedian(patterned) <= 1)
