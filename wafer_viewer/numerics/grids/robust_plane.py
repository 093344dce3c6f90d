"""Robust plane fit to the differences of two height maps, with its covariance.

M-estimate with Tukey's biweight (A. E. Beaton, J. W. Tukey, Technometrics 16 (1974) 147): false heights and edges that
are not quite aligned are far from the plane and have no weight. Errors of neighbouring pixels are correlated, so the
plane is less certain than its number of pixels implies; sums over blocks of pixels show by how much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float32s, Real, lean_kernel, lean_part
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, median


@dataclass(frozen=True, slots=True)
class PlaneFitParameters:
    """Limits of the robust plane fit.

    Parameters
    ----------
    least_pixels : int
        Smallest number of pixels with a difference for a plane.
    most_steps : int
        Largest number of reweighted steps.
    samples : int
        Largest number of pixels for the start and for the scale of the residuals, which it knows to 2 %; more of them
        change neither errors nor uncertainties of `tests/bench/bench_overlaps.py`.
    least_bend : float
        Smallest mean derivative of the weighted residuals, 1 for small ones; it bounds the covariance.
    least_scale : float, in units of the differences
        Lower limit of the residual scale, and of its part in the covariance.
    close : float
        Largest change of the plane, relative to the cut-off of the biweight, at which the fit ends.

    Notes
    -----
    `tests/bench/bench_overlaps.py` compares the errors of overlaps with their uncertainties.
    """

    least_pixels: int = 30
    most_steps: int = 8
    samples: int = 3_000
    least_bend: float = 0.2
    least_scale: float = 1e-5
    close: float = 1e-3


PLANE_FIT = PlaneFitParameters()
_TUKEY = 4.685
"""Cut-off of the biweight in standard deviations: 95 % efficiency for normal errors."""
_TUKEY_SQUARES = 0.6605
"""Weighted sum of squares over the sum of weights for normal errors of standard deviation 1."""
_N_SUMS = 9
"""Number of sums for each band and column, see `_band_sums`."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """value + slope_down (row - row0) + slope_right (col - col0), with (row0, col0) the centroid of the used pixels.

    information: float64 [3, 3], inverse covariance of (value, slope_down, slope_right); n_pixels: number of used
    pixels; rms: of their residuals.
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
    """Fit a plane to a map of differences, NaN where not compared; None with fewer than 30 pixels.

    side: block size, larger than the correlation length of the errors.
    """
    sample = _sample(differences)
    if len(sample) < min(PLANE_FIT.least_pixels, differences.size):
        return None
    plane: Numbers = np.array([median(sample[:, 0]), 0.0, 0.0])
    limit = 1.0
    for _ in range(PLANE_FIT.most_steps):
        residuals = sample[:, 0] - plane[0] - sample[:, 1:] @ plane[1:]
        limit = _TUKEY * (MAD_TO_SIGMA * median(np.abs(residuals)) + PLANE_FIT.least_scale)
        normal, right = _normal(_band_sums(differences, plane, limit, side))
        step = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
        plane += step
        if np.all(np.abs(step) * np.array([1, *differences.shape]) < PLANE_FIT.close * limit):
            break
    return _with_covariance(plane, _band_sums(differences, plane, limit, side), side)


def _sample(differences: Float32s) -> Numbers:
    """Return difference, row and column of a sample of the known pixels, [n, 3]."""
    stride = max(1, math.ceil(math.sqrt(differences.size / PLANE_FIT.samples)))
    some = differences[::stride, ::stride]
    rows, cols = np.nonzero(some == some)
    return np.stack([some[rows, cols], rows * stride, cols * stride], axis=1).astype(np.float64)


def _band_sums(differences: Float32s, plane: Numbers, limit: float, side: int) -> Numbers:
    """Return sums over bands of about `side` rows, with weights w and residuals r, float64 [9, band, col].

    Of w, w row, w row^2, w r, w r row, (w r)^2, row (w r)^2, (row w r)^2 and the derivative of w r.
    """
    n_rows, n_cols = differences.shape
    sums = np.zeros((max(1, n_rows // side), _N_SUMS, n_cols), np.float32)
    _add_bands(differences, plane.astype(np.float32), np.float32(1 / limit), np.empty((4, n_cols), np.float32), sums)
    return sums.astype(np.float64).transpose(1, 0, 2)


def _normal(sums: Numbers) -> tuple[Numbers, Numbers]:
    """Return normal matrix and right side of (value, slope down, slope right)."""
    _, _, _, wr, wry = sums[:5].sum(axis=1)
    x = np.arange(len(wr), dtype=np.float64)
    return _moments(*sums[:3]), np.array([wr.sum(), wry.sum(), wr @ x])


def _moments(w: Numbers, wy: Numbers, wyy: Numbers) -> Numbers:
    """Return the weighted sums of the products of (1, row, col) from sums [band, col]."""
    w, wy, wyy = w.sum(axis=0), wy.sum(axis=0), wyy.sum(axis=0)
    x = np.arange(len(w), dtype=np.float64)
    corner = float(wy @ x)
    return np.array([[w.sum(), wy.sum(), w @ x], [wy.sum(), wyy.sum(), corner], [w @ x, corner, w @ x**2]])


def _with_covariance(plane: Numbers, sums: Numbers, side: int) -> Plane | None:
    """Return the plane about its centroid with the sandwich covariance of its residuals (P. J. Huber, 1967)."""
    normal = _moments(*sums[:3])
    weight = normal[0, 0]
    if not weight > 0:
        return None
    row0, col0 = normal[0, 1] / weight, normal[0, 2] / weight
    to_centroid = np.array([[1, 0, 0], [-row0, 1, 0], [-col0, 0, 1]])
    squares = _moments(*sums[5:8])
    scatter = to_centroid @ squares @ to_centroid.T * _variance_inflation(sums[3], float(squares[0, 0]), side)
    about = to_centroid @ normal @ to_centroid.T * max(PLANE_FIT.least_bend, float(sums[8].sum()) / weight)
    scatter += PLANE_FIT.least_scale**2 * about
    information: Numbers = about @ np.linalg.pinv(scatter, rcond=1e-14, hermitian=True) @ about
    value = float(plane[0] + plane[1] * row0 + plane[2] * col0)
    rms = math.sqrt(float(squares[0, 0]) / (weight * _TUKEY_SQUARES))
    return Plane(row0, col0, value, float(plane[1]), float(plane[2]), information, round(weight), rms)


def _variance_inflation(residuals: Numbers, squares: float, side: int) -> float:
    """Return the number of pixels equivalent to one independent pixel, from the excess variance of block sums.

    Rows and columns of blocks are also used, for residuals along a straight wall that is not quite aligned.
    """
    n_blocks = max(1, residuals.shape[1] // side)
    starts = np.arange(n_blocks) * residuals.shape[1] // n_blocks
    blocks = np.add.reduceat(residuals, starts, axis=1)
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
        residuals = row[x] - (start + slope * np.float32(x))
        share = (residuals * per_limit) * (residuals * per_limit)
        room = one - share
        counts = room > none
        weight[x] = room * room if counts else none
        pull[x] = room * room * residuals if counts else none
        bend[x] = room * (one - five * share) if counts else none


@lean_part
def _add(line: Float32s, factor: Real, total: Float32s) -> None:
    for x in range(total.size):
        total[x] += factor * line[x]


def differences(first: Float32s, second: Float32s, row_part: Real, col_part: Real, max_step: Real) -> Float32s:
    """Return the second minus the first at the pixels of the first; float32, NaN where either has no height.

    first: [row, col]; second: [row + 1, col + 1]; pixel (r, c) of the first is at (r + row_part, c + col_part) of the
    second, the parts in 0 ... 1. The second is interpolated bilinearly, not next to NaN or steps over `max_step`.
    """
    out = np.empty(first.shape, np.float32)
    parts = np.array([row_part, col_part], np.float32)
    _subtract(first, second, parts, np.float32(max_step), out)
    return out


@lean_kernel
def _subtract(first: Float32s, second: Float32s, parts: Float32s, max_step: Real, out: Float32s) -> None:
    for r in range(out.shape[0]):
        above, below = second[r], second[r + 1]
        _subtract_row(first[r], above, above[1:], below, below[1:], parts[0], parts[1], max_step, out[r])


@lean_part
def _subtract_row(
    first: Float32s,
    a: Float32s,
    b: Float32s,
    c: Float32s,
    d: Float32s,
    s: Real,
    t: Real,
    max_step: Real,
    out: Float32s,
) -> None:
    """Subtract one row; NaN fails every comparison."""
    for x in range(out.size):
        above, below = a[x] + t * (b[x] - a[x]), c[x] + t * (d[x] - c[x])
        flat = (abs(b[x] - a[x]) <= max_step) & (abs(d[x] - c[x]) <= max_step) & (abs(c[x] - a[x]) <= max_step)
        out[x] = above + s * (below - above) - first[x] if flat else np.float32(np.nan)
