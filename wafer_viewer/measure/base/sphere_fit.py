"""A sphere through points that outliers do not disturb, fitted along z, where the noise is.

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
"""Of the sphere's radius: points further from its axis lie on walls that no height map shows."""
LEAST_POINTS = 10
_ROUNDS = 50
_SETTLED = 1e-4
"""Of the curvature: steps become smaller by their squares, so the one after this counts nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Cap:
    """A sphere's highest (lowest) point and its curvature 1 / R, negative for a pit."""

    x_um: float
    y_um: float
    z_um: float
    curvature: float

    @property
    def radius_um(self) -> float:
        """The sphere's radius."""
        return 1 / abs(self.curvature)

    def at(self, points: HeightSamples) -> Floats:
        """Heights of the sphere over points that it reaches."""
        squares = self._squares(points)
        return self.z_um - self.curvature * squares / (1 + self._cosine(squares))

    def slopes(self, points: HeightSamples) -> Floats:
        """How the heights change with x, y, z and curvature, [n, 4]."""
        squares = self._squares(points)
        cosine = self._cosine(squares)
        x, y = points.x_um - self.x_um, points.y_um - self.y_um
        along = self.curvature * x / cosine, self.curvature * y / cosine
        return np.stack([*along, np.ones(len(points)), -squares / (cosine * (1 + cosine))], axis=1)

    def reaches(self, points: HeightSamples) -> NDArray[np.bool_]:
        """Which points lie over the sphere, not beyond its walls."""
        return np.abs(self.curvature) * np.sqrt(self._squares(points)) < STEEPEST

    def moved(self, by: Floats) -> Cap:
        """Another sphere, its four numbers changed."""
        return Cap(*(np.array([self.x_um, self.y_um, self.z_um, self.curvature]) + by).tolist())

    def _squares(self, points: HeightSamples) -> Floats:
        return (points.x_um - self.x_um) ** 2 + (points.y_um - self.y_um) ** 2

    def _cosine(self, squares: Floats) -> Floats:
        return np.sqrt(1 - self.curvature**2 * squares)


def fit_cap(points: HeightSamples, start: Cap | None = None) -> tuple[Cap, HeightSamples]:
    """The sphere, and the points that were not rejected; start: one that is nearly it.

    Raises MeasureError when no sphere fits.
    """
    cap = start or _first_guess(points)
    for _ in range(_ROUNDS):
        before, cap = cap, _nearer(points, cap)
        if abs(cap.curvature - before.curvature) <= _SETTLED * abs(cap.curvature):
            break
    near = points.kept(cap.reaches(points))
    kept = near.kept(robust_fit(cap.slopes(near), near.z_um - cap.at(near)).kept)
    if not cap.curvature or not len(kept):
        raise no_sphere()
    return cap, kept


def _nearer(points: HeightSamples, cap: Cap) -> Cap:
    """One step of Gauss and Newton, outliers apart."""
    near = points.kept(cap.reaches(points))
    if len(near) < LEAST_POINTS:
        raise no_sphere()
    return cap.moved(robust_fit(cap.slopes(near), near.z_um - cap.at(near)).coefficients)


def no_sphere() -> MeasureError:
    """What to say where heights are not those of a sphere."""
    return MeasureError("No sphere fits the heights in the circle: draw it round a single bump or pit.")


def _first_guess(points: HeightSamples) -> Cap:
    """By a paraboloid: too curved for a steep cap, whose rim is left out then until the sphere reaches it."""
    x_um, y_um = float(points.x_um.mean()), float(points.y_um.mean())
    x, y = points.x_um - x_um, points.y_um - y_um
    fit = robust_fit(np.stack([x**2 + y**2, x, y, np.ones(len(x))], axis=1), points.z_um)
    bend, along_x, along_y, z_um = fit.coefficients.tolist()
    if not bend:
        raise no_sphere()
    top_um = z_um - (along_x**2 + along_y**2) / (4 * bend)
    return Cap(x_um - along_x / (2 * bend), y_um - along_y / (2 * bend), top_um, -2 * bend)
