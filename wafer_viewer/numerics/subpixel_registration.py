"""Subpixel shift between two pictures, with covariance.

Between its pixels a picture is interpolated by a Gaussian wide enough for equal noise at every position. A narrower
kernel would bias a fit towards the middle between pixels, where noise is smoothed most.

The covariance comes from the scatter of the block gradients (the sandwich of P. J. Huber, 1967): noise shared by
neighbouring pixels, or pictures that differ slightly, increase it as they should.

Gauss-Newton on grey values (B. D. Lucas, T. Kanade, IJCAI 1981), block by block. Each block has its own brightness and
contrast, so differences in illumination do not matter, and a weight by its quality of fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float32s, Int64s, lean_kernel, lean_part

REACH = 3
"""Half width of the interpolation kernel in pixels."""
N_LINES = 5
"""Number of quantities multiplied in pairs: 1, both values, slope down, slope right."""
N_PRODUCTS = 15
"""Number of different products of two of them."""
_SIGMA_PX = 0.85
"""Standard deviation of the Gaussian interpolation kernel, wide enough for equal noise at every position, px."""


def taps(part: float) -> Float32s:
    """Return the weights of value and slope at a position `part` (-0.5 ... 0.5) from the middle of 7 pixels, [2, 7]."""
    away = np.arange(-REACH, REACH + 1) - part
    value = np.exp(-((away / _SIGMA_PX) ** 2) / 2)
    value /= value.sum()
    slope = value * (away - value @ away)
    return np.stack([value, slope / (slope @ away)]).astype(np.float32)


def block_sums(
    first: Float32s,
    first_valid: Float32s,
    second: Float32s,
    second_valid: Float32s,
    lag: tuple[float, float],
    side: int,
) -> NDArray[np.float64]:
    """Return the block sums of all products of (1, first, second, slope down, slope right).

    float64 [block row, block col, 5, 5], over blocks of about side x side pixels. Pixel (r, c) of the first is compared
    with the second at (r - lag row, c - lag col), both smoothed equally; the slopes are those of the second. Pixels
    unknown in either (valid: 1 or 0) and a rim of 3 do not count. Empty without common pixels.
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
    _sum(first, first_valid, second, second_valid, corner, weights, n_rows, lines, sums)
    return _square(np.add.reduceat(sums, _starts(n_cols, side), axis=2, dtype=np.float64))


def _span(first: int, second: int, lag: float) -> tuple[int, int, int]:
    """Return the range of the first's pixels with all neighbours in both, and the integer part of the lag."""
    nearest = round(lag)
    return max(0, nearest) + REACH, min(first, nearest + second) - REACH, nearest


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
    first_valid: Float32s,
    second: Float32s,
    second_valid: Float32s,
    corner: Int64s,
    weights: Float32s,
    n_rows: int,
    lines: Float32s,
    sums: Float32s,
) -> None:
    n_bands, n_cols = sums.shape[0], sums.shape[2]
    left, other_left = corner[1], corner[3]
    valid, a, b, down, right = lines[0], lines[1], lines[2], lines[3], lines[4]
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
        _multiply(first_valid[row, left:], second_valid[other, other_left:], valid[:n_cols])
        _apply_mask(valid[:n_cols], a, b, down, right)
        band = sums[r * n_bands // n_rows]
        n = 0
        for i in range(N_LINES):
            for j in range(i, N_LINES):
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
def _apply_mask(valid: Float32s, a: Float32s, b: Float32s, down: Float32s, right: Float32s) -> None:
    for x in range(valid.size):
        a[x], b[x], down[x], right[x] = a[x] * valid[x], b[x] * valid[x], down[x] * valid[x], right[x] * valid[x]


@lean_part
def _add_product(first: Float32s, second: Float32s, total: Float32s) -> None:
    for x in range(total.size):
        total[x] += first[x] * second[x]


_AREAS = (4, 8)
"""Sides of the areas, in blocks, over which errors may be correlated."""
_SHOWS = 3.0
"""Variance of a block with signal, relative to that of the noise left after smoothing."""
_SMOOTHED = 0.33
"""Noise left after smoothing, relative to that of a pixel."""
_LEAST_BLOCKS = 4
"""Smallest number of blocks for a covariance."""
_LEAST_BLOCKS_BENT = 8
"""Smallest number of blocks for a shift that varies across them."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BlockGradients:
    """Statistics of the blocks, all [n block].

    index: [n, 2]; place: [n, 2] in -1 ... 1; pixels: number; first, second, both: variances and covariance of the two
    pictures; pull [n, 2] and stiffness [n, 2, 2]: gradient and Hessian of the lag; trust: weight of a block's slopes in
    the Hessian.
    """

    index: NDArray[np.intp]
    place: Numbers
    pixels: Numbers
    first: Numbers
    second: Numbers
    both: Numbers
    pull: Numbers
    stiffness: Numbers
    trust: Numbers


def block_gradients(sums: Numbers, index: NDArray[np.intp], place: Numbers) -> BlockGradients:
    """Return the block gradients with a separate brightness and contrast per block, so only a shift remains."""
    n = sums[:, 0, 0]
    spread = sums[:, 1:, 1:] - sums[:, 1:, :1] * sums[:, :1, 1:] / n[:, None, None]
    first, second, both = np.maximum(spread[:, 0, 0], 0), np.maximum(spread[:, 1, 1], 0), spread[:, 0, 1]
    room = np.maximum(second, 1e-9 * n)
    gain = np.maximum(both, 0) / room
    projector = spread - spread[:, :, 1:2] * spread[:, 1:2, :] / room[:, None, None]
    weight = n / np.maximum(projector[:, 0, 0], 1e-9 * n)
    weight = weight / (1 + weight / (4 * np.median(weight))) if len(weight) else weight
    pull = -(weight * gain)[:, None] * projector[:, 0, 2:]
    stiffness = (weight * gain**2)[:, None, None] * projector[:, 2:, 2:]
    return BlockGradients(index, place, n, first, second, both, pull, stiffness, weight * gain**2)


def correlation(blocks: BlockGradients) -> float:
    """Return the correlation within blocks, -1 ... 1."""
    energy = float(blocks.first.sum() * blocks.second.sum())
    return float(blocks.both.sum()) / energy**0.5 if energy > 0 else 0.0


def covariance(blocks: BlockGradients, stiffness: Numbers) -> Numbers:
    """Return the covariance of the lag from the scatter of the gradients; infinite for a singular Hessian."""
    n = len(blocks.pixels)
    if (
        n < _LEAST_BLOCKS
        or not (np.diag(stiffness) > 0).all()
        or np.linalg.det(stiffness) <= 1e-9 * np.prod(np.diag(stiffness))
    ):
        return np.full((2, 2), np.inf)
    spread = blocks.pull.T @ blocks.pull * (n / (n - 2))
    inverse = np.linalg.inv(stiffness)
    wider = np.maximum(np.diag(_spread_of_lines(blocks)), np.diag(_spread_of_areas(blocks)))
    more = np.sqrt(np.maximum(1.0, wider / np.maximum(np.diag(spread), 1e-30)))
    return np.asarray(inverse @ (spread * np.outer(more, more)) @ inverse, np.float64)


def _spread_of_lines(blocks: BlockGradients) -> Numbers:
    """Return the scatter of the gradients with errors correlated along rows and columns, as at a straight edge.

    Source: A. C. Cameron, J. B. Gelbach, D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238.
    """
    rows, cols = (_spread_of(blocks.pull, blocks.index[:, axis]) for axis in (0, 1))
    return rows + cols - blocks.pull.T @ blocks.pull


def _spread_of_areas(blocks: BlockGradients) -> Numbers:
    """Return the same for nearby blocks: areas of a picture that come from different frames."""
    return np.maximum(*(_spread_of(blocks.pull, _numbered(blocks.index // side)) for side in _AREAS))


def _numbered(index: NDArray[np.intp]) -> NDArray[np.intp]:
    return index[:, 0] * (1 + index[:, 1].max()) + index[:, 1]


def _spread_of(pull: Numbers, cluster: NDArray[np.intp]) -> Numbers:
    _, of_cluster = np.unique(cluster, return_inverse=True)
    sums = np.stack([np.bincount(of_cluster, one) for one in pull.T], axis=1)
    return np.asarray(sums.T @ sums * (len(sums) / max(1, len(sums) - 1)), np.float64)


def agreement_fraction(blocks: BlockGradients, noise: float) -> float:
    """Return the fraction of the signal in blocks with at least half the correlation of the best ones.

    A block of strong contrast has no more weight than others with a signal above noise.
    """
    strength = np.sqrt(blocks.first * blocks.second) / np.maximum(blocks.pixels, 1)
    visible = blocks.pixels * strength**2 / (strength**2 + (_SHOWS * (_SMOOTHED * noise) ** 2) ** 2 + 1e-30)
    if not visible.sum() > 0:
        return 0.0
    correlation = blocks.both / np.maximum(strength * blocks.pixels, 1e-30)
    best = correlation[np.argsort(visible)[len(visible) // 2 :]].max()
    return float(visible[correlation > 0.5 * best].sum() / visible.sum())


def shift_gradient(blocks: BlockGradients) -> tuple[float, float]:
    """Return the deviation of lags at the ends from that in the middle, in pixels and in standard deviations.

    Fits a lag that varies linearly across the blocks, for contents rotated or scaled against each other.
    """
    n = len(blocks.pixels)
    if n < _LEAST_BLOCKS_BENT:
        return 0.0, 0.0
    basis = np.einsum("bi,jk->bijk", blocks.place, np.eye(2)).reshape(n, 4, 2)
    pulls = np.einsum("bpj,bj->bp", basis, blocks.pull)
    stiffness = np.einsum("bpi,bij,bqj->pq", basis, blocks.stiffness, basis)
    stiffness += (1e-6 * np.trace(stiffness) + 1e-30) * np.eye(4)
    inverse = np.linalg.inv(stiffness)
    bend = inverse @ pulls.sum(axis=0)
    residual = np.einsum("bpj,bj->bp", basis, blocks.pull - np.einsum("bij,bqj,q->bi", blocks.stiffness, basis, bend))
    spread = inverse @ (residual.T @ residual) @ inverse
    most = int(np.argmax(np.abs(bend)))
    return float(np.abs(bend[most])), float(np.abs(bend[most]) / np.sqrt(max(spread[most, most], 1e-30)))


@dataclass(frozen=True, slots=True)
class AlignmentParameters:
    """Limits of the subpixel alignment.

    Parameters
    ----------
    most_steps : int
        Largest number of Gauss-Newton steps.
    close_px : float, px
        Step below which the alignment ends.
    roughly_close_px : float, px
        The same for a rough alignment.
    telling_px : float, px
        Step above which the change of the gradient shows the real fraction of the Hessian.
    probe_px : float, px
        Distance to either side of the lag for a Hessian by finite differences.
    least_hessian_fraction : float
        Lower limit of the real fraction of the Hessian.
    noise_slope : float, per px
        Slope of the interpolated noise, relative to the noise of a pixel.
    clearly : float
        Smallest ratio of the stiffness to that of noise, to attribute it to the picture; a weaker one is
        probed.
    least_filled : float
        Smallest known fraction of a block's pixels, relative to the fullest block.
    least_pixels : float, px
        Smallest number of known pixels of a block.

    Notes
    -----
    `tests/bench/bench_overlaps.py` compares the errors of overlaps with their uncertainties.
    """

    most_steps: int = 6
    close_px: float = 0.005
    roughly_close_px: float = 0.05
    telling_px: float = 0.05
    probe_px: float = 0.2
    least_hessian_fraction: float = 0.05
    noise_slope: float = 0.3
    clearly: float = 10.0
    least_filled: float = 0.2
    least_pixels: float = 12.0


ALIGNMENT = AlignmentParameters()

Lag = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredImage:
    """Part of a picture with its mask of known pixels (1 or 0), float32 [row, col].

    noise: upper bound of the standard deviation of its pixel-to-pixel noise.
    """

    values: Float32s
    valid: Float32s
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class SubpixelShift:
    """A lag (rows, cols) in pixels: pixel (r, c) of the second is at (r + lag row, c + lag col) of the first.

    covariance: [2, 2], infinite if undetermined; correlation: within blocks, -1 ... 1; agreeing: fraction of the
    contrast in blocks that fit on their own; bent_px: deviation of the lags of the outermost blocks from that in the
    middle, and bent_sigmas: its significance.
    """

    lag: Lag
    covariance: Numbers
    correlation: float
    agreeing: float
    bent_px: float
    bent_sigmas: float
    n_pixels: float


def align(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, roughly: bool = False) -> SubpixelShift:
    """Refine a lag that is correct within about a pixel.

    side: approximate block size in pixels; roughly: stop at a twentieth of a pixel, with a covariance that is too small
    under strong noise.
    """
    pulls, ease, close_px = (
        _gradients(first, second, lag, side),
        1.0,
        ALIGNMENT.roughly_close_px if roughly else ALIGNMENT.close_px,
    )
    for _ in range(ALIGNMENT.most_steps):
        step, before = _step(pulls, ease), pulls
        lag = lag[0] + float(step[0]), lag[1] + float(step[1])
        if np.abs(step).max() < close_px:
            break
        pulls = _gradients(first, second, lag, side)
        if np.abs(step).max() > ALIGNMENT.telling_px:
            ease = _hessian_fraction(before, pulls, step)
    noise = math.sqrt(first.noise * second.noise)
    clear = roughly or _is_clear(pulls, noise)
    stiffness = pulls.stiffness.sum(axis=0) if clear else _hessian_by_differences(first, second, lag, side)
    bent_px, bent_sigmas = shift_gradient(pulls)
    shares = correlation(pulls), agreement_fraction(pulls, noise)
    return SubpixelShift(
        lag, covariance(pulls, stiffness), *shares, bent_px / ease, bent_sigmas, float(pulls.pixels.sum())
    )


def _hessian_fraction(before: BlockGradients, after: BlockGradients, step: Numbers) -> float:
    """Return the real fraction of the Hessian: slopes of the noise do not move with the picture."""
    decrease = float(step @ (before.pull.sum(axis=0) - after.pull.sum(axis=0)))
    return min(
        1.0,
        max(ALIGNMENT.least_hessian_fraction, decrease / max(float(step @ before.stiffness.sum(axis=0) @ step), 1e-30)),
    )


def _is_clear(pulls: BlockGradients, noise: float) -> bool:
    """Return whether the slopes are those of the picture in every direction."""
    of_noise = float((pulls.trust * pulls.pixels).sum()) * (ALIGNMENT.noise_slope * noise) ** 2
    return bool(np.linalg.eigvalsh(pulls.stiffness.sum(axis=0))[0] > ALIGNMENT.clearly * of_noise)


def _hessian_by_differences(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> Numbers:
    """Return the Hessian by finite differences of the gradient on both sides of a lag."""
    felt = np.empty((2, 2))
    for axis in (0, 1):
        ahead, behind = (
            _gradients(first, second, (lag[0] + off * (1 - axis), lag[1] + off * axis), side).pull.sum(axis=0)
            for off in (ALIGNMENT.probe_px, -ALIGNMENT.probe_px)
        )
        felt[axis] = (behind - ahead) / (2 * ALIGNMENT.probe_px)
    return (felt + felt.T) / 2


def _gradients(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> BlockGradients:
    sums = block_sums(first.values, first.valid, second.values, second.valid, lag, side)
    index = np.indices(sums.shape[:2]).reshape(2, -1).T
    place = 2 * (index + 0.5) / np.array(sums.shape[:2]) - 1
    flat = sums.reshape(-1, *sums.shape[2:])
    pixels = flat[:, 0, 0]
    enough = pixels > max(ALIGNMENT.least_filled * pixels.max(initial=0), ALIGNMENT.least_pixels)
    return block_gradients(flat[enough], index[enough], place[enough])


def _step(pulls: BlockGradients, ease: float) -> Numbers:
    """Return one Gauss-Newton step of at most a pixel."""
    stiffness = pulls.stiffness.sum(axis=0) * ease
    stiffness = stiffness + 1e-6 * np.trace(stiffness) * np.eye(2) + 1e-30 * np.eye(2)
    return np.linalg.solve(stiffness, pulls.pull.sum(axis=0)).clip(-1, 1)
