"""Block-wise sums of products of two overlapping pictures, sufficient for a fit of their shift.

Between its pixels a picture is interpolated by a Gaussian wide enough for equal noise at every position. A narrower
kernel would bias a fit towards the middle between pixels, where noise is smoothed most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Float32s, Int64s
from wafer_viewer.numerics.jit import lean_kernel, lean_part

REACH = 3
"""Half width of the interpolation kernel in pixels."""
N_LINES = 5
N_PRODUCTS = 15
_SIGMA_PX = 0.85
_TAPS = 2 * REACH + 1


def taps(part: float) -> Float32s:
    """Return the weights of value and slope at a position `part` (-0.5 ... 0.5) from the middle of 7 pixels, [2, 7]."""
    away = np.arange(-REACH, REACH + 1) - part
    value = np.exp(-((away / _SIGMA_PX) ** 2) / 2)
    value /= value.sum()
    slope = value * (away - value @ away)
    return np.stack([value, slope / (slope @ away)]).astype(np.float32)


def block_sums(
    first: Float32s,
    first_known: Float32s,
    second: Float32s,
    second_known: Float32s,
    lag: tuple[float, float],
    side: int,
) -> NDArray[np.float64]:
    """Return the block sums of all products of (1, first, second, slope down, slope right).

    float64 [block row, block col, 5, 5], over blocks of about side x side pixels. Pixel (r, c) of the first is compared
    with the second at (r - lag row, c - lag col), both smoothed equally; the slopes are those of the second. Pixels
    unknown in either (known: 1 or 0) and a rim of 3 do not count. Empty without common pixels.
    """
    spans = [_span(a, b, n) for a, b, n in zip(first.shape, second.shape, lag, strict=True)]
    n_rows, n_cols = (stop - start for start, stop, _ in spans)
    if n_rows <= 0 or n_cols <= 0:
        return np.zeros((0, 0, N_LINES, N_LINES))
    corner = np.array([spans[0][0], spans[1][0], spans[0][0] - spans[0][2], spans[1][0] - spans[1][2]], np.int64)
    parts = [round(n) - n for n in lag]
    weights = np.stack([taps(0.0), taps(parts[0]), taps(parts[1])])
    n_bands = max(1, n_rows // side)
    sums = np.zeros((n_bands, N_PRODUCTS, n_cols), np.float32)
    lines = np.zeros((N_LINES + 2, n_cols + 2 * REACH), np.float32)
    _sum(first, first_known, second, second_known, corner, weights, n_rows, lines, sums)
    return _square(np.add.reduceat(sums, _starts(n_cols, side), axis=2, dtype=np.float64))


def _span(first: int, second: int, lag: float) -> tuple[int, int, int]:
    """Return the range of the first's pixels with all neighbours in both, and the integer part of the lag."""
    whole = round(lag)
    return max(0, whole) + REACH, min(first, whole + second) - REACH, whole


def _starts(n: int, side: int) -> NDArray[np.intp]:
    """Return the start indices of blocks of about `side` pixels."""
    n_blocks = max(1, n // side)
    return np.arange(n_blocks) * n // n_blocks


def _square(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert [band, product, block] to symmetric matrices."""
    i, j = np.triu_indices(N_LINES)
    out = np.empty((sums.shape[0], sums.shape[2], N_LINES, N_LINES))
    out[:, :, i, j] = out[:, :, j, i] = sums.transpose(0, 2, 1)
    return out


@lean_kernel
def _sum(
    first: Float32s,
    first_known: Float32s,
    second: Float32s,
    second_known: Float32s,
    corner: Int64s,
    weights: Float32s,
    n_rows: int,
    lines: Float32s,
    sums: Float32s,
) -> None:
    n_bands, n_cols = sums.shape[0], sums.shape[2]
    left, other_left = corner[1], corner[3]
    known, a, b, down, right = lines[0], lines[1], lines[2], lines[3], lines[4]
    smooth, slope = lines[5], lines[6]
    for r in range(n_rows):
        row, other = corner[0] + r, corner[2] + r
        _weigh(first, row, left, weights[0, 0], smooth)
        _along(smooth, weights[0, 0], a)
        _weigh(second, other, other_left, weights[1, 0], smooth)
        _weigh(second, other, other_left, weights[1, 1], slope)
        _along(smooth, weights[2, 0], b)
        _along(slope, weights[2, 0], down)
        _along(smooth, weights[2, 1], right)
        _multiply(first_known[row, left:], second_known[other, other_left:], known[:n_cols])
        _apply_mask(known[:n_cols], a, b, down, right)
        band = sums[r * n_bands // n_rows]
        n = 0
        for i in range(5):
            for j in range(i, 5):
                _add_product(lines[i], lines[j], band[n])
                n += 1


@lean_part
def _weigh(picture: Float32s, row: int, left: int, weights: Float32s, out: Float32s) -> None:
    """Interpolate one row between the rows of a picture."""
    w0, w1, w2, w3, w4, w5, w6 = weights
    start = left - 3
    a, b, c = picture[row - 3, start:], picture[row - 2, start:], picture[row - 1, start:]
    d, e, f, g = picture[row, start:], picture[row + 1, start:], picture[row + 2, start:], picture[row + 3, start:]
    for x in range(out.size):
        out[x] = w0 * a[x] + w1 * b[x] + w2 * c[x] + w3 * d[x] + w4 * e[x] + w5 * f[x] + w6 * g[x]


@lean_part
def _along(row: Float32s, weights: Float32s, out: Float32s) -> None:
    w0, w1, w2, w3, w4, w5, w6 = weights
    for x in range(out.size - 6):
        out[x] = (
            w0 * row[x] + w1 * row[x + 1] + w2 * row[x + 2] + w3 * row[x + 3] + w4 * row[x + 4] + w5 * row[x + 5]
        ) + w6 * row[x + 6]


@lean_part
def _multiply(first: Float32s, second: Float32s, out: Float32s) -> None:
    for x in range(out.size):
        out[x] = first[x] * second[x]


@lean_part
def _apply_mask(known: Float32s, a: Float32s, b: Float32s, down: Float32s, right: Float32s) -> None:
    for x in range(known.size):
        a[x], b[x], down[x], right[x] = a[x] * known[x], b[x] * known[x], down[x] * known[x], right[x] * known[x]


@lean_part
def _add_product(first: Float32s, second: Float32s, total: Float32s) -> None:
    for x in range(total.size):
        total[x] += first[x] * second[x]
