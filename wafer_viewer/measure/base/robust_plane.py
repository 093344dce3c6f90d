"""Least-squares planes with outlier rejection beyond 3 robust deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples
from wafer_viewer.model.errors import MeasureError

REJECT_BEYOND = 3.0
SIGMA_OF_MAD = 1.4826
"""Ratio of standard deviation to median absolute deviation for normal noise."""
SIGMAS_OF_75 = 1.1503
"""Half-width, in standard deviations, of the interval that contains 75 % of normal noise."""
ROUNDING = float(np.finfo(np.float32).eps)
"""Relative rounding of heights, which are 32-bit numbers."""
SETTLED_FRACTION = 1e-4
"""Convergence limit: the fraction of points that may still change between accepted and rejected.

Points at the rejection limit do not matter, and with millions of them an exact fixed point takes many rounds.
"""
BEGIN_WITH = 40_000
"""Approximate size of the evenly spaced subset that starts a fit to more points.

Only the last rounds use every point.
"""
_MAX_ROUNDS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Coefficients, residuals float64 [n], and mask of the accepted points bool [n]."""

    coefficients: Floats
    residuals: Floats
    kept: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class LevelPlane:
    """z = z_um + slope_x (x - x_um) + slope_y (y - y_um), about the centroid of its points."""

    x_um: float
    y_um: float
    z_um: float
    slope_x: float
    slope_y: float

    def at(self, x_um: Floats | float, y_um: Floats | float) -> Floats | float:
        """Return the height of the plane at a place."""
        return self.z_um + self.slope_x * (x_um - self.x_um) + self.slope_y * (y_um - self.y_um)


def robust_fit(design: Floats, values: Floats) -> Fit:
    """Fit `values` [n] on `design` [n, p] by least squares with iterated rejection beyond 3 MAD deviations.

    Ends when at most one point in ten thousand changes between accepted and rejected. Raises MeasureError when the
    points do not determine the coefficients.
    """
    rounding = ROUNDING * float(np.abs(values).max(initial=0.0))
    some = _some_of(len(values))
    fit = _settled(_begun(design[some], values[some]), design[some], values[some], rounding)
    if some.step == 1:
        return fit
    residuals = values - design @ fit.coefficients
    kept = _within(residuals, fit.residuals[fit.kept], rounding)
    return _settled(_fit(design, values, kept), design, values, rounding)


def _begun(design: Floats, values: Floats) -> Fit:
    return _fit(design, values, np.ones(len(values), bool))


def _settled(fit: Fit, design: Floats, values: Floats, rounding: float) -> Fit:
    for _ in range(_MAX_ROUNDS):
        within = _within(fit.residuals, fit.residuals[fit.kept], rounding)
        if np.count_nonzero(within != fit.kept) <= SETTLED_FRACTION * len(values):
            break
        fit = _fit(design, values, within)
    return fit


def least_squares(design: Floats, values: Floats) -> Floats:
    """Solve by the normal equations of scaled columns, which is fast for millions of rows.

    Raises MeasureError when the points do not determine the coefficients.
    """
    scale = np.sqrt(np.mean(design**2, axis=0)) if len(design) else np.ones(design.shape[1])
    scaled = design / np.where(scale > 0, scale, 1.0)
    normal = scaled.T @ scaled
    if np.linalg.matrix_rank(normal, hermitian=True) < design.shape[1]:
        raise MeasureError(
            f"The {len(values)} measured points lie on a line or are too few to fit a plane: draw the region larger."
        )
    return np.linalg.solve(normal, scaled.T @ values) / scale


def fit_plane(points: HeightSamples) -> tuple[LevelPlane, Fit]:
    """Fit a robust plane. Raises MeasureError when the points do not determine one."""
    x0_um, y0_um = _centroid(points)
    fit = robust_fit(plane_design(points, (x0_um, y0_um)), points.z_um)
    slope_x, slope_y, z0_um = fit.coefficients.tolist()
    about = LevelPlane(x0_um, y0_um, z0_um, slope_x, slope_y)
    x_um, y_um = float(np.mean(points.x_um[fit.kept])), float(np.mean(points.y_um[fit.kept]))
    return LevelPlane(x_um, y_um, float(about.at(x_um, y_um)), slope_x, slope_y), fit


def plane_design(points: HeightSamples, center_um: tuple[float, float]) -> Floats:
    """Return the design matrix with columns x, y, 1 about a centre."""
    return np.stack([points.x_um - center_um[0], points.y_um - center_um[1], np.ones(len(points))], axis=1)


def _fit(design: Floats, values: Floats, kept: NDArray[np.bool_]) -> Fit:
    coefficients = least_squares(design[kept], values[kept])
    return Fit(coefficients, values - design @ coefficients, kept)


def _centroid(points: HeightSamples) -> tuple[float, float]:
    return float(np.mean(points.x_um)), float(np.mean(points.y_um))


def _within(residuals: Floats, kept: Floats, rounding: float) -> NDArray[np.bool_]:
    """Return the mask of residuals within the rejection limit of the accepted ones."""
    known = kept[_some_of(len(kept))]
    middle = np.median(known)
    return np.abs(residuals - middle) <= REJECT_BEYOND * _spread(np.abs(known - middle), rounding)


def _some_of(n: int) -> slice:
    """Return a slice of about BEGIN_WITH of n rows, with an odd step so that they do not align in columns."""
    return slice(None, None, 1 if n < 2 * BEGIN_WITH else n // BEGIN_WITH | 1)


def _spread(deviations: Floats, rounding: float) -> float:
    """Return a robust standard deviation: that of the MAD, or of the 75 % quantile if larger.

    Heights from unrefined focus peaks cluster at two values: by the MAD alone the smaller cluster would be outliers.
    """
    half, most = np.quantile(deviations, (0.5, 0.75))
    return max(SIGMA_OF_MAD * float(half), float(most) / SIGMAS_OF_75, rounding)
