"""Least-squares planes in a sliding window of a map with gaps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.filters.sliding_filters import box_mean

Plane = NDArray[np.float64]


class LocalPlanes(NamedTuple):
    """Planes fitted to the finite pixels of the window around each pixel, all float64 [row, col].

    coverage: finite fraction of the part of the window inside the map; gradient: steepest slope, height per pixel;
    residual: root mean square distance from the plane; explained: fraction of the variance that the plane explains.
    """

    coverage: Plane
    gradient: Plane
    residual: Plane
    explained: Plane


def local_planes(z: NDArray[np.floating], size: int) -> LocalPlanes:
    """Fit a plane to the finite heights of size x size pixels around each pixel of z [row, col].

    At the border of the map the window is cut off. Where the finite pixels do not determine a plane its gradient is 0.
    """
    valid = np.isfinite(z)
    heights = np.where(valid, z - (np.mean(z[valid]) if valid.any() else 0), 0).astype(np.float64)
    rows, cols = (np.arange(n, dtype=np.float64) - (n - 1) / 2 for n in z.shape)
    y, x, w = rows[:, None], cols[None, :], valid.astype(np.float64)
    n = np.maximum(_sums(w, size), 0.5)
    mean_y, mean_x, mean_z = (_sums(part, size) / n for part in (w * y, w * x, heights))
    yy = _sums(w * y * y, size) / n - mean_y**2
    xx = _sums(w * x * x, size) / n - mean_x**2
    xy = _sums(w * x * y, size) / n - mean_x * mean_y
    zy = _sums(heights * y, size) / n - mean_z * mean_y
    zx = _sums(heights * x, size) / n - mean_z * mean_x
    zz = np.maximum(_sums(heights**2, size) / n - mean_z**2, 0)
    determinant = xx * yy - xy**2
    inverse = np.divide(1.0, determinant, out=np.zeros_like(n), where=determinant > _LEAST_DETERMINANT)
    down, right = inverse * (xx * zy - xy * zx), inverse * (yy * zx - xy * zy)
    off = np.maximum(zz - down * zy - right * zx, 0)
    explained = 1 - np.divide(off, zz, out=np.zeros_like(n), where=zz > 0)
    coverage = _sums(w, size) / _sums(np.ones(z.shape), size)
    return LocalPlanes(coverage, np.hypot(down, right), np.sqrt(off), explained)


_LEAST_DETERMINANT = 1e-3
"""Smallest determinant of the scatter of the finite pixels that determines a plane, px^4; a full 3 x 3 has 4 / 9."""


def _sums(plane: Plane, size: int) -> Any:
    """Sliding sum of size x size pixels, with zeros beyond the border."""
    return box_mean(plane, size, repeats=False) * size**2
