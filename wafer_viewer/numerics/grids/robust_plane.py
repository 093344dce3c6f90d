"""A robust plane through the differences of two height maps, and how sure it is.

M-estimate with Tukey's biweight (A. E. Beaton, J. W. Tukey, Technometrics 16 (1974) 147): false heights and edges that
do not quite lie on each other are far from the plane and count nothing. Errors of neighbouring pixels are alike, so
that a plane is less sure than the number of its pixels says: by how much is seen from the sums over blocks of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Float32s, Real
from wafer_viewer.numerics.jit import lean_kernel, lean_part

LEAST_PIXELS = 30
_TUKEY = 4.685
"""Deviations from which on a difference counts nothing: 95 % as sharp as least squares where errors are normal."""
_TUKEY_SQUARES = 0.6605
"""What the weighted squares of normal errors of deviation 1 come to, by weight."""
_MAD = 1.4826
_STEPS = 8
_SAMPLES = 5000
_N_SUMS = 9
_LEAST_BEND = 0.2
_LEAST_SCALE = 1e-5
_CLOSE = 1e-3

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """value + slope_down (row - row0) + slope_right (col - col0), (row0, col0) the centroid of what was compared.

    information: float64 [3, 3], inverse covariance of (value, slope_down, slope_right); n_pixels: that counted; rms: of
    what they leave.
    """

    row0: float
    col0: float
    value: float
    slope_down: float
    slope_right: float
    information: Numbers
    n_pixels: int
    rms: float


def fit_plane(differences: Float32s, side: int) -> Plane | None:
    """A plane through a map of differences, NaN where nothing is compared; None where less than 30 pixels are.

    side: of the blocks, larger than errors of neighbours are alike.
    """
    sample = _sample(differences)
    if len(sample) < min(LEAST_PIXELS, differences.size):
        return None
    plane: Numbers = np.array([float(np.median(sample[:, 0])), 0.0, 0.0])
    limit = 1.0
    for _ in range(_STEPS):
        left = sample[:, 0] - plane[0] - sample[:, 1:] @ plane[1:]
        limit = _TUKEY * (_MAD * float(np.median(np.abs(left))) + _LEAST_SCALE)
        normal, right = _normal(_summed(differences, plane, limit, side))
        step = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
        plane += step
        if np.all(np.abs(step) * np.array([1, *differences.shape]) < _CLOSE * limit):
            break
    return _judged(plane, _summed(differences, plane, limit, side), side)


def _sample(differences: Float32s) -> Numbers:
    """Difference, row and column of some of the known pixels, [n, 3]."""
    stride = max(1, math.isqrt(differences.size // _SAMPLES))
    some = differences[::stride, ::stride]
    rows, cols = np.nonzero(some == some)
    return np.stack([some[rows, cols], rows * stride, cols * stride], axis=1).astype(np.float64)


def _summed(differences: Float32s, plane: Numbers, limit: float, side: int) -> Numbers:
    """Sums over bands of about `side` rows, with weights w and what is left r, float64 [9, band, col].

    Of w, w row, w row^2, w r, w r row, (w r)^2, row (w r)^2, (row w r)^2 and the slope of w r.
    """
    n_rows, n_cols = differences.shape
    sums = np.zeros((max(1, n_rows // side), _N_SUMS, n_cols), np.float32)
    _add_bands(differences, plane.astype(np.float32), np.float32(1 / limit), np.empty((4, n_cols), np.float32), sums)
    return sums.astype(np.float64).transpose(1, 0, 2)


def _normal(sums: Numbers) -> tuple[Numbers, Numbers]:
    """Normal matrix and right side of (value, slope down, slope right)."""
    _, _, _, wr, wry = sums[:5].sum(axis=1)
    x = np.arange(len(wr), dtype=np.float64)
    return _moments(*sums[:3]), np.array([wr.sum(), wry.sum(), wr @ x])


def _moments(w: Numbers, wy: Numbers, wyy: Numbers) -> Numbers:
    """Sums of the products of (1, row, col), weighted; all [band, col]."""
    w, wy, wyy = w.sum(axis=0), wy.sum(axis=0), wyy.sum(axis=0)
    x = np.arange(len(w), dtype=np.float64)
    corner = float(wy @ x)
    return np.array([[w.sum(), wy.sum(), w @ x], [wy.sum(), wyy.sum(), corner], [w @ x, corner, w @ x**2]])


def _judged(plane: Numbers, sums: Numbers, side: int) -> Plane | None:
    """The plane about its centroid, with what its residuals say of it (the sandwich of P. J. Huber, 1967)."""
    normal = _moments(*sums[:3])
    weight = normal[0, 0]
    if not weight > 0:
        return None
    row0, col0 = normal[0, 1] / weight, normal[0, 2] / weight
    to_centroid = np.array([[1, 0, 0], [-row0, 1, 0], [-col0, 0, 1]])
    squares = _moments(*sums[5:8])
    scatter = to_centroid @ squares @ to_centroid.T * _alike_pixels(sums[3], float(squares[0, 0]), side)
    about = to_centroid @ normal @ to_centroid.T * max(_LEAST_BEND, float(sums[8].sum()) / weight)
    scatter += _LEAST_SCALE**2 * about
    information: Numbers = about @ np.linalg.pinv(scatter, rcond=1e-14, hermitian=True) @ about
    value = float(plane[0] + plane[1] * row0 + plane[2] * col0)
    rms = math.sqrt(float(squares[0, 0]) / (weight * _TUKEY_SQUARES))
    return Plane(row0, col0, value, float(plane[1]), float(plane[2]), information, round(weight), rms)


def _alike_pixels(left: Numbers, squares: float, side: int) -> float:
    """How many pixels tell as much as an independent one: how much more sums over blocks scatter than they would.

    Rows and columns of blocks count as well, as on a straight wall that does not quite lie on the other.
    """
    n_blocks = max(1, left.shape[1] // side)
    starts = np.arange(n_blocks) * left.shape[1] // n_blocks
    blocks = np.add.reduceat(left, starts, axis=1)
    alone = _scatter(blocks.ravel(), 3)
    lines = _scatter(blocks.sum(axis=0), 1) + _scatter(blocks.sum(axis=1), 1) - alone
    return max(1.0, alone / max(squares, 1e-30), lines / max(squares, 1e-30))


def _scatter(sums: Numbers, fitted: int) -> float:
    return float((sums**2).sum()) * sums.size / max(1, sums.size - fitted)


@lean_kernel
def _add_bands(differences: Float32s, plane: Float32s, per_limit: Real, lines: Float32s, sums: Float32s) -> None:
    n_rows, n_bands = differences.shape[0], sums.shape[0]
    weight, pull, bend, square = lines[0], lines[1], lines[2], lines[3]
    for r in range(n_rows):
        _weigh(differences[r], plane[0] + plane[1] * np.float32(r), plane[2], per_limit, weight, pull, bend)
        band, y = sums[r * n_bands // n_rows], np.float32(r)
        _add(weight, np.float32(1), band[0])
        _add(weight, y, band[1])
        _add(weight, y * y, band[2])
        _add(pull, np.float32(1), band[3])
        _add(pull, y, band[4])
        for x in range(pull.size):
            square[x] = pull[x] * pull[x]
        _add(square, np.float32(1), band[5])
        _add(square, y, band[6])
        _add(square, y * y, band[7])
        _add(bend, np.float32(1), band[8])


@lean_part
def _weigh(
    row: Float32s, start: Real, slope: Real, per_limit: Real, weight: Float32s, pull: Float32s, bend: Float32s
) -> None:
    one, five, none = np.float32(1), np.float32(5), np.float32(0)
    for x in range(row.size):
        left = row[x] - (start + slope * np.float32(x))
        share = (left * per_limit) * (left * per_limit)
        room = one - share
        counts = room > none
        weight[x] = room * room if counts else none
        pull[x] = room * room * left if counts else none
        bend[x] = room * (one - five * share) if counts else none


@lean_part
def _add(line: Float32s, factor: Real, total: Float32s) -> None:
    for x in range(total.size):
        total[x] += factor * line[x]
