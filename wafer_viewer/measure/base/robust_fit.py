"""Least-squares planes, paraboloids, lines and spheres with rejection of outliers. Pure.

z = top - c r^2 / (1 + sqrt(1 - c^2 r^2)), r the distance from the axis and c the curvature, holds for shallow caps and
for steep ones, for bumps (c > 0) and for pits (c < 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.correlated_errors import Scatter, chain_uncertainty
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

REJECT_BEYOND = 3.0
"""Distance from the median, in robust deviations of the accepted points, beyond which a point is rejected."""
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
"""Largest number of rounds of rejection."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Coefficients, residuals float64 [n], and mask of the accepted points bool [n]."""

    coefficients: Floats
    residuals: Floats
    inliers: NDArray[np.bool_]


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


def exact_fit(design: Floats, values: Floats) -> Fit:
    """Fit `values` [n] on `design` [n, p] by least squares without rejection, for hardly more values than unknowns."""
    coefficients = least_squares(design, values)
    return Fit(coefficients, values - design @ coefficients, np.ones(len(values), bool))


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
    inliers = _within(residuals, fit.residuals[fit.inliers], rounding)
    return _settled(_fit(design, values, inliers), design, values, rounding)


def _begun(design: Floats, values: Floats) -> Fit:
    return _fit(design, values, np.ones(len(values), bool))


def _settled(fit: Fit, design: Floats, values: Floats, rounding: float) -> Fit:
    for _ in range(_MAX_ROUNDS):
        within = _within(fit.residuals, fit.residuals[fit.inliers], rounding)
        if np.count_nonzero(within != fit.inliers) <= SETTLED_FRACTION * len(values):
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
    x_um, y_um = float(np.mean(points.x_um[fit.inliers])), float(np.mean(points.y_um[fit.inliers]))
    return LevelPlane(x_um, y_um, float(about.at(x_um, y_um)), slope_x, slope_y), fit


def plane_design(points: HeightSamples, center_um: tuple[float, float]) -> Floats:
    """Return the design matrix with columns x, y, 1 about a centre."""
    return np.stack([points.x_um - center_um[0], points.y_um - center_um[1], np.ones(len(points))], axis=1)


def paraboloid_design(points: HeightSamples, center_um: tuple[float, float]) -> Floats:
    """Return the design matrix with columns x, y, 1, x^2, x y, y^2 about a centre."""
    flat = plane_design(points, center_um)
    x_um, y_um = flat[:, 0], flat[:, 1]
    return np.column_stack([flat, x_um**2, x_um * y_um, y_um**2])


def _fit(design: Floats, values: Floats, inliers: NDArray[np.bool_]) -> Fit:
    coefficients = least_squares(design[inliers], values[inliers])
    return Fit(coefficients, values - design @ coefficients, inliers)


def _centroid(points: HeightSamples) -> tuple[float, float]:
    return float(np.mean(points.x_um)), float(np.mean(points.y_um))


def _within(residuals: Floats, inliers: Floats, rounding: float) -> NDArray[np.bool_]:
    """Return the mask of residuals within the rejection limit of the accepted ones."""
    sampled = inliers[_some_of(len(inliers))]
    middle = np.median(sampled)
    return np.abs(residuals - middle) <= REJECT_BEYOND * _spread(np.abs(sampled - middle), rounding)


def _some_of(n: int) -> slice:
    """Return a slice of about BEGIN_WITH of n rows, with an odd step so that they do not align in columns."""
    return slice(None, None, 1 if n < 2 * BEGIN_WITH else n // BEGIN_WITH | 1)


def _spread(deviations: Floats, rounding: float) -> float:
    """Return a robust standard deviation: that of the MAD, or of the 75 % quantile if larger.

    Heights from unrefined focus peaks cluster at two values: by the MAD alone the smaller cluster would be outliers.
    """
    half, most = np.quantile(deviations, (0.5, 0.75))
    return max(MAD_TO_SIGMA * float(half), float(most) / SIGMAS_OF_75, rounding)


_TURNS = 3
"""Number of rounds of a line fit; each turns the axes along the line of the round before."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """A straight edge in stage um: centroid of its points, direction, and the points accepted by the fit.

    along_um, off_um: coordinates of each point along the line from the centroid, and to the left of the line.
    """

    x_um: float
    y_um: float
    direction: tuple[float, float]
    along_um: Floats
    off_um: Floats

    @property
    def normal(self) -> tuple[float, float]:
        """Unit normal, to the left of the direction."""
        return -self.direction[1], self.direction[0]

    @property
    def angle_deg(self) -> float:
        """Angle of the direction, counter-clockwise from x."""
        return math.degrees(math.atan2(self.direction[1], self.direction[0]))

    def off(self, x_um: Floats | float, y_um: Floats | float) -> Floats | float:
        """Return the signed distance of places to the left of the line."""
        return (x_um - self.x_um) * self.normal[0] + (y_um - self.y_um) * self.normal[1]

    def along(self, x_um: Floats | float, y_um: Floats | float) -> Floats | float:
        """Return the coordinate of places along the line, from its centroid."""
        return (x_um - self.x_um) * self.direction[0] + (y_um - self.y_um) * self.direction[1]

    def at(self, along_um: float) -> tuple[float, float]:
        """Return the place at a coordinate along the line."""
        return self.x_um + along_um * self.direction[0], self.y_um + along_um * self.direction[1]

    def u_um(self, along_um: float = 0.0) -> Scatter | None:
        """Return the uncertainty of the line's lateral position there, by its residuals; None with too few points."""
        return chain_uncertainty(self._design, self.off_um, np.array([along_um, 1.0]))

    @property
    def u_angle_deg(self) -> Scatter | None:
        """Uncertainty of the angle; None with too few points."""
        u = chain_uncertainty(self._design, self.off_um, np.array([1.0, 0.0]))
        return None if u is None else u.times(math.degrees(1))

    @property
    def region(self) -> Region:
        """Line region from the first point to the last."""
        ends = (self.at(float(along)) for along in (self.along_um.min(), self.along_um.max()))
        return Region.line(*(round(v, 3) for end in ends for v in end))

    @property
    def _design(self) -> Floats:
        return np.stack([self.along_um, np.ones(len(self.along_um))], axis=1)


def fit_line(x_um: Floats, y_um: Floats) -> EdgeLine:
    """Fit a total least-squares line through ordered points, with rejection beyond 3 robust deviations.

    Raises MeasureError when the points do not determine a line.
    """
    along = _principal(x_um, y_um)
    middle, inliers = (float(x_um.mean()), float(y_um.mean())), np.ones(len(x_um), bool)
    for _ in range(_TURNS):
        ahead, left = _turned(x_um, y_um, middle, along)
        fit = robust_fit(np.stack([ahead, np.ones(len(ahead))], axis=1), left)
        turn, inliers = math.atan(float(fit.coefficients[0])), fit.inliers
        along = _rotated(along, turn)
        middle = float(x_um[inliers].mean()), float(y_um[inliers].mean())
    ahead, left = _turned(x_um[inliers], y_um[inliers], middle, along)
    return EdgeLine(*middle, along, ahead, left)


def _principal(x_um: Floats, y_um: Floats) -> tuple[float, float]:
    """Return the direction of largest variance of points, oriented from the first point to the last."""
    offsets = np.stack([x_um - x_um.mean(), y_um - y_um.mean()])
    direction = np.linalg.eigh(offsets @ offsets.T)[1][:, 1]
    ends = x_um[-1] - x_um[0], y_um[-1] - y_um[0]
    direction = direction if direction @ np.array(ends) >= 0 else -direction
    return float(direction[0]), float(direction[1])


def _turned(x_um: Floats, y_um: Floats, middle: tuple[float, float], along: tuple[float, float]) -> tuple[Floats, ...]:
    x, y = x_um - middle[0], y_um - middle[1]
    return x * along[0] + y * along[1], y * along[0] - x * along[1]


def _rotated(direction: tuple[float, float], angle: float) -> tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return direction[0] * cos - direction[1] * sin, direction[0] * sin + direction[1] * cos


def angle_between_lines(first: EdgeLine, second: EdgeLine) -> float:
    """Return the angle between two lines, degrees, 0 to 90, regardless of their orientation."""
    cross = first.direction[0] * second.direction[1] - first.direction[1] * second.direction[0]
    dot = first.direction[0] * second.direction[0] + first.direction[1] * second.direction[1]
    return math.degrees(math.atan2(abs(cross), abs(dot)))


def crossing(first: EdgeLine, second: EdgeLine) -> tuple[float, float]:
    """Return the intersection of two lines. Raises MeasureError when they are parallel."""
    cross = first.direction[0] * second.direction[1] - first.direction[1] * second.direction[0]
    if abs(cross) < 1e-6:
        raise MeasureError("Two edges of the die run side by side: draw the region round one die.")
    direction = second.x_um - first.x_um, second.y_um - first.y_um
    return first.at((direction[0] * second.direction[1] - direction[1] * second.direction[0]) / cross)


STEEPEST = 0.95
"""Largest distance from the axis, in sphere radii; beyond it walls are too steep for a height map."""
LEAST_POINTS = 10
"""Smallest number of points within reach of a sphere for a step of its fit."""
_ROUNDS = 50
"""Largest number of steps of the fit of a sphere."""
_SETTLED = 1e-4
"""Relative convergence limit of the curvature; convergence is quadratic, so the next step is negligible."""


@dataclass(frozen=True, slots=True, eq=False)
class Cap:
    """Apex (highest or lowest point) of a sphere and its curvature 1 / R, negative for a pit."""

    x_um: float
    y_um: float
    z_um: float
    curvature: float

    @property
    def radius_um(self) -> float:
        """The sphere's radius."""
        return 1 / abs(self.curvature)

    def at(self, points: HeightSamples) -> Floats:
        """Return the heights of the sphere at points within its reach."""
        squares = self._squares(points)
        return self.z_um - self.curvature * squares / (1 + self._cosine(squares))

    def slopes(self, points: HeightSamples) -> Floats:
        """Return the derivatives of the heights by x, y, z and curvature, [n, 4]."""
        squares = self._squares(points)
        cosine = self._cosine(squares)
        x, y = points.x_um - self.x_um, points.y_um - self.y_um
        along = self.curvature * x / cosine, self.curvature * y / cosine
        return np.stack([*along, np.ones(len(points)), -squares / (cosine * (1 + cosine))], axis=1)

    def within_reach(self, points: HeightSamples) -> NDArray[np.bool_]:
        """Return which points lie within the reach of the sphere, not beyond its walls."""
        return np.abs(self.curvature) * np.sqrt(self._squares(points)) < STEEPEST

    def moved(self, by: Floats) -> Cap:
        """Return the sphere with its four parameters changed by an increment."""
        return Cap(*(np.array([self.x_um, self.y_um, self.z_um, self.curvature]) + by).tolist())

    def _squares(self, points: HeightSamples) -> Floats:
        return (points.x_um - self.x_um) ** 2 + (points.y_um - self.y_um) ** 2

    def _cosine(self, squares: Floats) -> Floats:
        return np.sqrt(1 - self.curvature**2 * squares)


def fit_cap(points: HeightSamples, start: Cap | None = None) -> tuple[Cap, HeightSamples]:
    """Fit a sphere; return it and the accepted points. start: initial estimate.

    Raises MeasureError when no sphere fits.
    """
    cap = start or _first_guess(points)
    for _ in range(_ROUNDS):
        before, cap = cap, _nearer(points, cap)
        if abs(cap.curvature - before.curvature) <= _SETTLED * abs(cap.curvature):
            break
    near = points.select(cap.within_reach(points))
    inliers = near.select(robust_fit(cap.slopes(near), near.z_um - cap.at(near)).inliers)
    if not cap.curvature or not len(inliers):
        raise no_sphere()
    return cap, inliers


def _nearer(points: HeightSamples, cap: Cap) -> Cap:
    """Return the sphere after one Gauss-Newton step with outlier rejection."""
    near = points.select(cap.within_reach(points))
    if len(near) < LEAST_POINTS:
        raise no_sphere()
    return cap.moved(robust_fit(cap.slopes(near), near.z_um - cap.at(near)).coefficients)


def no_sphere() -> MeasureError:
    """Return the error for heights that no sphere fits."""
    return MeasureError("No sphere fits the heights in the circle: draw it round a single bump or pit.")


def _first_guess(points: HeightSamples) -> Cap:
    """Return the initial estimate by a paraboloid.

    It is too curved for a steep cap; the rim is excluded until the sphere reaches it.
    """
    x_um, y_um = float(points.x_um.mean()), float(points.y_um.mean())
    x, y = points.x_um - x_um, points.y_um - y_um
    fit = robust_fit(np.stack([x**2 + y**2, x, y, np.ones(len(x))], axis=1), points.z_um)
    bend, along_x, along_y, z_um = fit.coefficients.tolist()
    if not bend:
        raise no_sphere()
    top_um = z_um - (along_x**2 + along_y**2) / (4 * bend)
    return Cap(x_um - along_x / (2 * bend), y_um - along_y / (2 * bend), top_um, -2 * bend)
