"""Sphere fit with outlier rejection; residuals are taken along z, the direction of the noise.

z = top - c r^2 / (1 + sqrt(1 - c^2 r^2)), r the distance from the axis and c the curvature, holds for shallow caps and
for steep ones, for bumps (c > 0) and for pits (c < 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples
from wafer_viewer.measure.base.robust_plane import robust_fit
from wafer_viewer.model.errors import MeasureError

STEEPEST = 0.95
"""Largest distance from the axis, in sphere radii; beyond it walls are too steep for a height map."""
LEAST_POINTS = 10
_ROUNDS = 50
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
    near = points.kept(cap.within_reach(points))
    kept = near.kept(robust_fit(cap.slopes(near), near.z_um - cap.at(near)).kept)
    if not cap.curvature or not len(kept):
        raise no_sphere()
    return cap, kept


def _nearer(points: HeightSamples, cap: Cap) -> Cap:
    """Return the sphere after one Gauss-Newton step with outlier rejection."""
    near = points.kept(cap.within_reach(points))
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
