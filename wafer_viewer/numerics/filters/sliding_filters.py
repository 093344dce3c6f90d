"""Sliding filters of small maps by SciPy, which is imported on first use; borders are replicated."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Plane = TypeVar("Plane", bound=NDArray[Any])
Floats = NDArray[np.float32]


def highest(plane: Plane, size: int) -> Plane:
    """Sliding maximum of size x size pixels."""
    from scipy.ndimage import maximum_filter

    return _as(plane, maximum_filter(plane, size, mode="nearest"))


def lowest(plane: Plane, size: int) -> Plane:
    """Sliding minimum of size x size pixels."""
    from scipy.ndimage import minimum_filter

    return _as(plane, minimum_filter(plane, size, mode="nearest"))


def sliding_range(plane: Floats, size: int) -> Floats:
    """Sliding range of the finite values of size x size pixels, 0 if there are none."""
    known = np.isfinite(plane)
    high = highest(np.where(known, plane, np.float32(-np.inf)), size)
    low = lowest(np.where(known, plane, np.float32(np.inf)), size)
    return np.where(high >= low, high - low, np.float32(0))


def mean(plane: NDArray[Any], size: int) -> Floats:
    """Sliding mean of size x size pixels."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(plane.astype(np.float32), size, mode="nearest"), np.float32)


def mean_of_known(plane: NDArray[Any], known: NDArray[np.bool_], size: int) -> Floats:
    """Sliding mean of the known ones of size x size pixels; 0 if there are none."""
    share = mean(known, size)
    total = mean(np.where(known, plane, np.zeros_like(plane)), size)
    return total / np.where(share > 0.5 / size**2, share, np.float32(np.inf)).astype(np.float32)


def blurred(plane: NDArray[Any], sigma: float) -> Floats:
    """Gaussian blur."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(plane.astype(np.float32), sigma, mode="nearest"), np.float32)


def nearest(wanted: NDArray[np.bool_]) -> tuple[NDArray[np.float64], tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return the distance to the nearest True pixel and its position as (rows, cols); one must be True."""
    from scipy.ndimage import distance_transform_edt

    distance, where = (np.asarray(a) for a in distance_transform_edt(~wanted, return_indices=True) or ())
    rows, cols = where.astype(np.intp)
    return distance.astype(np.float64), (rows, cols)


def pieces(wanted: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the label of the 4-connected component of each True pixel; 0 elsewhere."""
    from scipy.ndimage import label

    return np.asarray(label(wanted)[0], np.intp)  # pyright: ignore[reportIndexIssue, reportArgumentType]


def halved(plane: NDArray[Any]) -> Floats:
    """Return the mean of 2 x 2 pixels; at an odd border, of the available ones."""
    rows, cols = plane.shape
    padded = np.pad(plane, ((0, rows % 2), (0, cols % 2)), mode="edge") if rows % 2 or cols % 2 else plane
    return padded.reshape((rows + 1) // 2, 2, (cols + 1) // 2, 2).mean(axis=(1, 3), dtype=np.float32)


def doubled(plane: Plane, shape: tuple[int, ...]) -> Plane:
    """Repeat each pixel 2 x 2, cropped to `shape`."""
    return _as(plane, plane.repeat(2, axis=0)[: shape[0]].repeat(2, axis=1)[:, : shape[1]])


def _as(like: Plane, values: Any) -> Plane:
    return np.asarray(values, like.dtype)  # pyright: ignore[reportReturnType]
