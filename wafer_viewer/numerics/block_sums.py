"""Products of two pictures at a lag, summed over blocks.

Between its pixels a picture is interpolated by a Gaussian wide enough for equal noise at every position. A narrower
kernel would bias a fit towards the middle between pixels, where noise is smoothed most.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float32s, Float64s, bare_kernel, lean_kernel, lean_part

Numbers = NDArray[np.float64]
REACH = 3
"""Half width of the interpolation kernel in pixels."""
N_LINES = 6
"""Number of quantities multiplied in pairs along a row: 1, row, both values, slope down, slope right."""
N_PRODUCTS = 21
"""Number of different products of two of them."""
N_SHADING = 3
"""Number of terms of the brightness of a block: 1, row and column."""
_TOGETHER = 4
"""Number of rows whose products are added together."""
_STRIDE = 32
"""Rows of products are a multiple of so many pixels wide: what is left over is not computed by vector instructions."""
_SIGMA_PX = 0.85
"""Standard deviation of the Gaussian interpolation kernel, wide enough for equal noise at every position, px."""


def taps(part: float) -> Float32s:
    """Return the weights of value and slope at a position `part` (-0.5 ... 0.5) from the middle of 7 pixels, [2, 7]."""
    out = np.empty((2, 2 * REACH + 1), np.float32)
    _fill_taps(part, out)
    return out


@lean_kernel
def _fill_taps(part: float, out: Float32s) -> None:
    total = moment = square = 0.0
    for k in range(2 * REACH + 1):
        away = k - REACH - part
        value = math.exp(-((away / _SIGMA_PX) ** 2) / 2)
        total, moment, square = total + value, moment + value * away, square + value * away * away
    mean = moment / total
    for k in range(2 * REACH + 1):
        away = k - REACH - part
        value = math.exp(-((away / _SIGMA_PX) ** 2) / 2) / total
        out[0, k], out[1, k] = value, value * (away - mean) / (square / total - mean * mean)


def smoothed(picture: Float32s) -> Float32s:
    """Return a picture as `block_sums` compares it with another, without a rim of 3 pixels."""
    out = np.empty((max(0, picture.shape[0] - 2 * REACH), max(0, picture.shape[1] - 2 * REACH)), np.float32)
    _fill_smoothed(picture, np.empty((2, 2 * REACH + 1), np.float32), np.empty(picture.shape[1], np.float32), out)
    return out


def block_sums(
    first: Float32s,
    first_valid: Float32s,
    second: Float32s,
    second_valid: Float32s,
    lag: tuple[float, float],
    side: int,
) -> NDArray[np.float64]:
    """Return the block sums of all products of (1, row, col, first, second, slope down, slope right).

    float64 [block row, block col, 7, 7], over blocks of about side x side pixels. first: `smoothed`; pixel (r, c) of it
    is compared with the second at (r - lag row, c - lag col), smoothed equally; the slopes are those of the second.
    Rows and columns are counted from the middle of a block, in its sides. Pixels unknown in either (valid: 1 or 0) and
    a rim of 3 do not count. Empty without common pixels.
    """
    (top, bottom, down), (left, right, across) = (
        _span(first_valid.shape[axis], second.shape[axis], lag[axis]) for axis in (0, 1)
    )
    n_rows, n_cols = bottom - top, right - left
    if n_rows <= 0 or n_cols <= 0:
        return np.zeros((0, 0, N_LINES + 1, N_LINES + 1))
    n_bands, width = max(1, n_rows // side), -(-n_cols // _STRIDE) * _STRIDE
    sums = np.zeros((n_bands, N_PRODUCTS, width), np.float32)
    lines, smooth = np.zeros((_TOGETHER, N_LINES, width), np.float32), np.zeros((2, width + 2 * REACH), np.float32)
    weights, cols = np.empty((4, 2 * REACH + 1), np.float32), np.empty(n_cols)
    out = np.empty((n_bands, max(1, n_cols // side), N_LINES + 1, N_LINES + 1))
    corner, parts = (top, left, top - down, left - across), (down - lag[0], across - lag[1])
    _fill_sums(first, first_valid, second, second_valid, corner, parts, n_rows, weights, lines, smooth, cols, sums, out)
    return out


def _span(first: int, second: int, lag: float) -> tuple[int, int, int]:
    """Return the range of the first's pixels with all neighbours in both, and the integer part of the lag."""
    nearest = round(lag)
    return max(0, nearest) + REACH, min(first, nearest + second) - REACH, nearest


@lean_kernel
def _fill_smoothed(picture: Float32s, weights: Float32s, line: Float32s, out: Float32s) -> None:
    _fill_taps(0.0, weights)
    for r in range(out.shape[0]):
        _weigh(picture, r + REACH, REACH, weights[0], line)
        _along(line, weights[0], out[r])


@lean_kernel
def _fill_sums(
    first: Float32s,
    first_valid: Float32s,
    second: Float32s,
    second_valid: Float32s,
    corner: tuple[int, int, int, int],
    parts: tuple[float, float],
    n_rows: int,
    weights: Float32s,
    lines: Float32s,
    smooth: Float32s,
    cols: Float64s,
    sums: Float32s,
    out: Float64s,
) -> None:
    """Fill the products of all blocks; parts: positions between the pixels of the second's axes."""
    for k in range(2):
        _fill_taps(parts[k], weights[2 * k : 2 * k + 2])
    _sum(first, first_valid, second, second_valid, corner, weights, n_rows, cols.size, lines, smooth, sums)
    _to_blocks(sums, cols, out)


@lean_part
def _to_blocks(sums: Float32s, cols: Float64s, out: Float64s) -> None:
    """Convert sums over the rows of a band, [band, product, col], to symmetric matrices with a line for the column.

    cols: room for the position of each column in its block.
    """
    n_cols, n_blocks = cols.size, out.shape[1]
    for x in range(n_cols):
        cols[x] = (x * n_blocks % n_cols) / n_cols - 0.5
    for band in range(sums.shape[0]):
        for block in range(n_blocks):
            start, stop, matrix = block * n_cols // n_blocks, (block + 1) * n_cols // n_blocks, out[band, block]
            n = 0
            for i in range(N_LINES):
                for j in range(i, N_LINES):
                    a, b = i + (i > 1), j + (j > 1)
                    matrix[a, b] = matrix[b, a] = _total(sums[band, n, start:stop])
                    n += 1
            for j in range(N_LINES):
                b = j + (j > 1)
                matrix[2, b] = matrix[b, 2] = _moment(sums[band, j, start:stop], cols[start:stop])
            matrix[2, 2] = _second_moment(sums[band, 0, start:stop], cols[start:stop])


@bare_kernel
def _total(row: Float32s) -> float:
    total = 0.0
    for x in range(row.size):
        total += row[x]
    return total


@bare_kernel
def _moment(row: Float32s, cols: Float64s) -> float:
    total = 0.0
    for x in range(row.size):
        total += row[x] * cols[x]
    return total


@bare_kernel
def _second_moment(row: Float32s, cols: Float64s) -> float:
    total = 0.0
    for x in range(row.size):
        total += row[x] * cols[x] * cols[x]
    return total


@lean_part
def _sum(
    first: Float32s,
    first_valid: Float32s,
    second: Float32s,
    second_valid: Float32s,
    corner: tuple[int, int, int, int],
    weights: Float32s,
    n_rows: int,
    n_cols: int,
    lines: Float32s,
    smooth: Float32s,
    sums: Float32s,
) -> None:
    """Add the products of all rows to those of their band; rows of a band are added several together."""
    n_bands, left, other_left, n_waiting, last = sums.shape[0], corner[1], corner[3], 0, 0
    for r in range(n_rows):
        row, other, band = corner[0] + r, corner[2] + r, r * n_bands // n_rows
        if n_waiting == _TOGETHER or band != last:
            _add_products(lines, n_waiting, sums[last])
            n_waiting, last = 0, band
        valid, place, a = lines[n_waiting, 0], lines[n_waiting, 1], lines[n_waiting, 2]
        b, down, right = lines[n_waiting, 3], lines[n_waiting, 4], lines[n_waiting, 5]
        _weigh(second, other, other_left, weights[0], smooth[0, : n_cols + 2 * REACH])
        _weigh(second, other, other_left, weights[1], smooth[1, : n_cols + 2 * REACH])
        _along_with_slope(smooth[0], weights[2], weights[3], b, right)
        _along(smooth[1], weights[2], down)
        _multiply(first_valid[row, left:], second_valid[other, other_left:], valid[:n_cols])
        _multiply(first[row - REACH, left - REACH :], valid, a[:n_cols])
        _apply_mask(valid, np.float32(r * n_bands % n_rows / n_rows - 0.5), place, b, down, right)
        n_waiting += 1
    _add_products(lines, n_waiting, sums[last])


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
    for x in range(out.size):
        out[x] = (
            w0 * row[x] + w1 * row[x + 1] + w2 * row[x + 2] + w3 * row[x + 3] + w4 * row[x + 4] + w5 * row[x + 5]
        ) + w6 * row[x + 6]


@lean_part
def _along_with_slope(
    row: Float32s, weights: Float32s, slope_weights: Float32s, value: Float32s, slope: Float32s
) -> None:
    w0, w1, w2, w3, w4, w5, w6 = weights
    s0, s1, s2, s3, s4, s5, s6 = slope_weights
    for x in range(value.size):
        value[x] = (
            w0 * row[x] + w1 * row[x + 1] + w2 * row[x + 2] + w3 * row[x + 3] + w4 * row[x + 4] + w5 * row[x + 5]
        ) + w6 * row[x + 6]
        slope[x] = (
            s0 * row[x] + s1 * row[x + 1] + s2 * row[x + 2] + s3 * row[x + 3] + s4 * row[x + 4] + s5 * row[x + 5]
        ) + s6 * row[x + 6]


@lean_part
def _multiply(first: Float32s, second: Float32s, out: Float32s) -> None:
    for x in range(out.size):
        out[x] = first[x] * second[x]


@lean_part
def _apply_mask(
    valid: Float32s, row: np.float32, place: Float32s, b: Float32s, down: Float32s, right: Float32s
) -> None:
    for x in range(valid.size):
        place[x] = row * valid[x]
        b[x], down[x], right[x] = b[x] * valid[x], down[x] * valid[x], right[x] * valid[x]


@lean_part
def _add_products(lines: Float32s, n: int, band: Float32s) -> None:
    """Add the products of `n` rows, in their order: the sums stay those of one row after the other."""
    k = 0
    for i in range(N_LINES):
        for j in range(i, N_LINES):
            if n == _TOGETHER:
                _add_four(
                    *(lines[0, i], lines[1, i], lines[2, i], lines[3, i]),
                    *(lines[0, j], lines[1, j], lines[2, j], lines[3, j]),
                    band[k],
                )
            else:
                for m in range(n):
                    _add_product(lines[m, i], lines[m, j], band[k])
            k += 1


@lean_part
def _add_four(
    a: Float32s,
    b: Float32s,
    c: Float32s,
    d: Float32s,
    of_a: Float32s,
    of_b: Float32s,
    of_c: Float32s,
    of_d: Float32s,
    total: Float32s,
) -> None:
    for x in range(total.size):
        total[x] = total[x] + a[x] * of_a[x] + b[x] * of_b[x] + c[x] * of_c[x] + d[x] * of_d[x]


@lean_part
def _add_product(first: Float32s, second: Float32s, total: Float32s) -> None:
    for x in range(total.size):
        total[x] += first[x] * second[x]
