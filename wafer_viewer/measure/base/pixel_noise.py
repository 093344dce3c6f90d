"""Uncertainty of a weighted sum of heights by the uncertainties of its pixels, which are alike over a focus window.

The residuals of a fit tell the errors of a small area badly: it holds few independent ones, and a faint place has more
noise than what surrounds it. The uncertainty that each pixel was given by its own focus curve is a lower bound.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import MOST_PX, WeightedHeights
from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.focus_measures import focus_measures

PIXEL_FREEDOM = 4.0
"""Degrees of freedom of the noise of pixels: tests/bench/bench_coverage.py --reconstructed, seeds below 1000."""


def pixel_noise_um(reading: MeasurementContext, heights: WeightedHeights) -> float:
    """Return the standard uncertainty of a sum of heights by the noise of its pixels, without what their frames cause.

    0 where the uncertainty of pixels or the focus window is not known, and for more than `MOST_PX` along a side, where
    residuals tell the noise.
    """
    surface, recipe = reading.surface, reading.surface.provenance.recipe
    pixel_um, window = surface.pixel_um, recipe.window
    bounds = [float(end(place)) for end in (np.min, np.max) for place in (heights.x_um, heights.y_um)]
    large = max(bounds[2] - bounds[0], bounds[3] - bounds[1]) > MOST_PX * pixel_um
    if large or reading.layer != "unsmoothed" or isinstance(window, str):
        return 0.0
    margins = (-pixel_um, -pixel_um, pixel_um, pixel_um)
    try:
        part = surface.window(Region.rectangle(*(a + b for a, b in zip(bounds, margins, strict=True))))
    except MeasureError:
        return 0.0
    if part.u_um is None or not np.isfinite(part.u_um).any():
        return 0.0
    rows = np.rint((part.y0_um - heights.y_um) / pixel_um).astype(np.intp).clip(0, part.u_um.shape[0] - 1)
    cols = np.rint((heights.x_um - part.x0_um) / pixel_um).astype(np.intp).clip(0, part.u_um.shape[1] - 1)
    of_frames_um = math.hypot(*reading.frame_lines(math.sqrt(0.5)).values())
    noise_um = np.sqrt(np.maximum(part.u_um.astype(np.float64) ** 2 - of_frames_um**2, 0.0))
    pulls = np.zeros(part.u_um.shape)
    np.add.at(pulls, (rows, cols), heights.weight)
    return _alike_over(window, focus_measures()[recipe.focus_measure].passes, pulls * np.nan_to_num(noise_um))


def noise_um(scatter: Scatter, of_pixels_um: float) -> float:
    """Return the standard uncertainty (k = 1) of a sum by the scatter of the residuals and by the noise of its pixels.

    Where the scatter is less than the pixels say, both are estimates of one variance, pooled by their freedom. More
    scatter is form or texture, which is no noise of pixels.
    """
    freedom = scatter.freedom + PIXEL_FREEDOM
    pooled_um2 = (scatter.freedom * scatter.u**2 + PIXEL_FREEDOM * of_pixels_um**2) / freedom
    return max(scatter.widened, Scatter(math.sqrt(pooled_um2), freedom).widened)


def _alike_over(window: int, passes: int, pulls_um: Floats) -> float:
    """Return the root of the sum over all pairs of pulls [row, col] times the correlation of two focus windows."""
    from scipy.ndimage import convolve1d

    kernel = np.ones(1)
    for _ in range(passes):
        kernel = np.convolve(kernel, np.ones(window) / window)
    wide = np.pad(pulls_um, len(kernel) // 2)
    for axis in (0, 1):
        wide = convolve1d(wide, kernel, axis=axis, mode="constant")
    return float(np.sqrt(np.sum(wide**2)) / np.sum(kernel**2))
