"""How sure a fitted step is when neighbouring points err alike: tiles of the regions are taken as the observations.

The error of a depth map is correlated over the focus window and by the form of the surface itself; the standard error
of single points would be several times too small. Means of tiles that are larger than the correlation scatter as much
as they are wrong. How far it reaches is not known beforehand, so tiles of several sizes are tried and the largest
answer is taken.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.measure.heights import Floats, Points
from wafer_viewer.measure.level import plane_design

SIDES = (8, 4, 3)
"""Tiles along each side of a region."""
MIN_FILL = 0.25
"""A tile with fewer points than this share of the median tile is left out."""
PLANES = 6
"""Coefficients that were fitted to the tiles: a plane for each region."""
MIN_FREEDOM = 2
Residuals = tuple[Points, Floats]
"""Points of a region, and how far each lies from the region's own plane."""


def scatter_um(upper: Residuals, lower: Residuals) -> float | None:
    """Standard uncertainty of the step between two regions by the scatter of their tiles; None when they are too few.

    It is widened by Student's t so that an expansion by k = 2 still covers 95 % with few tiles.
    """
    found = [_of_tiles(tile_means(*upper, side), tile_means(*lower, side)) for side in SIDES]
    return max((u for u in found if u is not None), default=None)


def tile_means(points: Points, residuals: Floats, side: int) -> Residuals:
    """Mean position, height and residual of the points in each of side x side tiles over them; nearly empty ones go."""
    columns = np.stack([points.x_um, points.y_um, points.z_um, residuals], axis=1)
    x_um, y_um, z_um, left = _means(points, columns, side).T
    return Points(x_um, y_um, z_um), left


def parameter_u(points: Points, design: Floats, residuals: Floats, gradient: Floats) -> float | None:
    """Standard uncertainty of gradient [p] times the parameters of a fit of `design` [n, p], by the scatter of tiles.

    None when they are too few; widened as `scatter_um`.
    """
    found = [_of_means(_means(points, np.column_stack([design, residuals]), side), gradient) for side in SIDES]
    return max((u for u in found if u is not None), default=None)


def _of_means(means: Floats, gradient: Floats) -> float | None:
    design, residuals = means[:, :-1], means[:, -1]
    freedom = len(residuals) - design.shape[1]
    if freedom < MIN_FREEDOM:
        return None
    scale = np.sqrt(np.mean(design**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    normal = (design / scale).T @ (design / scale)
    factor = float((gradient / scale) @ np.linalg.pinv(normal, hermitian=True) @ (gradient / scale))
    return math.sqrt(max(0.0, factor) * float(np.sum(residuals**2)) / freedom) * _student(freedom) / 2


def _means(points: Points, columns: Floats, side: int) -> Floats:
    """Means of columns [n, c] over the points in each of side x side tiles, [tile, c]."""
    cell = _cells(points.x_um, side) * side + _cells(points.y_um, side)
    count = np.bincount(cell, minlength=side**2)
    full = count >= max(1.0, MIN_FILL * float(np.median(count[count > 0])))
    sums = np.stack([np.bincount(cell, column, side**2) for column in columns.T], axis=1)
    return sums[full] / count[full, None]


def _of_tiles(upper: Residuals, lower: Residuals) -> float | None:
    """The spread of h as the least-squares estimate of the common-plane model with the tiles as observations."""
    residuals = np.concatenate([upper[1], lower[1]])
    freedom = len(residuals) - PLANES
    if freedom < MIN_FREEDOM:
        return None
    both = upper[0].and_also(lower[0])
    center = float(both.x_um.mean()), float(both.y_um.mean())
    is_upper = np.repeat([1.0, 0.0], [len(upper[1]), len(lower[1])])
    design = np.column_stack([plane_design(both, center), is_upper])
    factor = np.linalg.pinv(design.T @ design)[3, 3]
    return float(np.sqrt(factor * np.sum(residuals**2) / freedom)) * _student(freedom) / 2


def _cells(coordinate: Floats, side: int) -> np.ndarray:
    """The tile of each point along one axis, from 0."""
    low, high = float(coordinate.min()), float(coordinate.max())
    return np.minimum(((coordinate - low) / max(high - low, 1e-12) * side).astype(np.intp), side - 1)


def _student(freedom: int) -> float:
    """Two-sided 95.45 % point of Student's t, which is 2 for many degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.97725))
