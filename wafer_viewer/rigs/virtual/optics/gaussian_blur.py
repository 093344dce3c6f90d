"""Gaussian blur with exact discrete variance.

Blur levels are computed from one another, so an error in the variance of one would propagate to the next.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import fast_kernel

Plane = NDArray[np.float32]
REACH_SIGMA = 3.3


def gaussian_half(variance_px2: float) -> Plane:
    """Return the weights of a symmetric Gaussian from its centre outwards, of exactly this discrete variance.

    The number of outer weights is even (the last may be 0), because the kernel processes them in pairs.
    """
    sigma = math.sqrt(max(variance_px2, 1e-6))
    reach = max(1, math.ceil(REACH_SIGMA * sigma))
    offset = np.arange(reach + 1)
    twice = np.where(offset == 0, 1.0, 2.0)
    weights = np.ones(reach + 1)
    for _ in range(12):
        weights = np.exp(-(offset**2) / (2 * sigma**2))
        weights /= np.sum(twice * weights)
        sigma *= math.sqrt(variance_px2 / np.sum(twice * weights * offset**2))
    return np.pad(weights, (0, reach % 2)).astype(np.float32)


def blurred(plane: Plane, variance_px2: float) -> Plane:
    """Return the plane [row, col] blurred by a Gaussian of a variance in px^2, with edge values repeated outside."""
    out = np.empty_like(plane)
    convolve(plane, gaussian_half(variance_px2), out)
    return out


@fast_kernel
def convolve(plane: Plane, half: Plane, out: Plane) -> None:
    """Blur row by row, first along the columns and then along the row while it is in the cache."""
    rows, cols = plane.shape
    reach = half.size - 1
    line = np.empty(cols + 2 * reach, np.float32)
    for y in range(rows):
        down_columns(plane, y, half, line[reach : reach + cols])
        for x in range(reach):
            line[x] = line[reach]
            line[reach + cols + x] = line[reach + cols - 1]
        along_row(line, half, out[y])


@fast_kernel
def down_columns(plane: Plane, y: int, half: Plane, out: Plane) -> None:
    """Blur one row of the plane along the columns."""
    last = plane.shape[0] - 1
    centre = plane[y]
    for x in range(out.size):
        out[x] = half[0] * centre[x]
    for d in range(1, half.size, 2):
        up, down = plane[max(y - d, 0)], plane[min(y + d, last)]
        farther_up, farther_down = plane[max(y - d - 1, 0)], plane[min(y + d + 1, last)]
        near, far = half[d], half[d + 1]
        for x in range(out.size):
            out[x] += near * (up[x] + down[x]) + far * (farther_up[x] + farther_down[x])


@fast_kernel
def along_row(line: Plane, half: Plane, out: Plane) -> None:
    """Blur a line that has a margin on both sides."""
    reach = half.size - 1
    for x in range(out.size):
        out[x] = half[0] * line[x + reach]
    for d in range(1, half.size, 2):
        near, far = half[d], half[d + 1]
        left, right = line[reach - d :], line[reach + d :]
        farther_left, farther_right = line[reach - d - 1 :], line[reach + d + 1 :]
        for x in range(out.size):
            out[x] += near * (left[x] + right[x]) + far * (farther_left[x] + farther_right[x])
