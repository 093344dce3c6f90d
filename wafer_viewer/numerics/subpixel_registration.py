"""Subpixel shift between two pictures, with covariance.

Between its pixels a picture is interpolated by a Gaussian wide enough for equal noise at every position. A narrower
kernel would bias a fit towards the middle between pixels, where noise is smoothed most.

The covariance comes from the scatter of the block gradients (the sandwich of P. J. Huber, 1967): noise shared by
neighbouring pixels, or pictures that differ slightly, increase it as they should.

Gauss-Newton on grey values (B. D. Lucas, T. Kanade, IJCAI 1981), block by block. Each block has its own contrast and
brightness, which slopes along both axes, so differences in illumination do not matter, and a weight by its quality of
fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float32s, Int64s, lean_kernel, lean_part

REACH = 3
"""Half width of the interpolation kernel in pixels."""
N_LINES = 6
"""Number of quantities multiplied in pairs along a row: 1, row, both values, slope down, slope right."""
N_PRODUCTS = 21
"""Number of different products of two of them."""
N_SHADING = 3
"""Number of terms of the brightness of a block: 1, row and column."""
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
    """Return the block sums of all products of (1, row, col, first, second, slope down, slope right).

    float64 [block row, block col, 7, 7], over blocks of about side x side pixels. Pixel (r, c) of the first is compared
    with the second at (r - lag row, c - lag col), both smoothed equally; the slopes are those of the second. Rows and
    columns are counted from the middle of a block, in its sides. Pixels unknown in either (valid: 1 or 0) and a rim of
    3 do not count. Empty without common pixels.
    """
    spans = [_span(a, b, n) for a, b, n in zip(first.shape, second.shape, lag, strict=True)]
    n_rows, n_cols = (stop - start for start, stop, _ in spans)
    if n_rows <= 0 or n_cols <= 0:
        return np.zeros((0, 0, N_LINES + 1, N_LINES + 1))
    corner = np.array([spans[0][0], spans[1][0], spans[0][0] - spans[0][2], spans[1][0] - spans[1][2]], np.int64)
    parts = [round(n) - n for n in lag]
    weights = np.stack([taps(0.0), taps(parts[0]), taps(parts[1])])
    n_bands = max(1, n_rows // side)
    sums = np.zeros((n_bands, N_PRODUCTS, n_cols), np.float32)
    lines = np.zeros((N_LINES + 2, n_cols + 2 * REACH), np.float32)
    _sum(first, first_valid, second, second_valid, corner, weights, n_rows, lines, sums)
    return _with_columns(sums, max(1, n_cols // side))


def _span(first: int, second: int, lag: float) -> tuple[int, int, int]:
    """Return the range of the first's pixels with all neighbours in both, and the integer part of the lag."""
    nearest = round(lag)
    return max(0, nearest) + REACH, min(first, nearest + second) - REACH, nearest


def _with_columns(sums: Float32s, n_blocks: int) -> NDArray[np.float64]:
    """Convert sums over the rows of a band, [band, product, col], to symmetric matrices with a line for the column."""
    n_cols = sums.shape[2]
    starts = np.arange(n_blocks) * n_cols // n_blocks
    col = np.arange(n_cols) * n_blocks % n_cols / n_cols - 0.5
    i, j = np.triu_indices(N_LINES)
    to = np.array([0, 1, *range(N_SHADING, N_LINES + 1)])
    out = np.empty((sums.shape[0], n_blocks, N_LINES + 1, N_LINES + 1))
    of_blocks = np.add.reduceat(sums, starts, axis=2, dtype=np.float64).transpose(0, 2, 1)
    out[:, :, to[i], to[j]] = out[:, :, to[j], to[i]] = of_blocks
    by_column = sums[:, :N_LINES] * col
    moments = np.add.reduceat(np.concatenate((by_column, by_column[:, :1] * col), axis=1), starts, axis=2)
    with_column = np.append(to, N_SHADING - 1)
    out[:, :, N_SHADING - 1, with_column] = out[:, :, with_column, N_SHADING - 1] = moments.transpose(0, 2, 1)
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
    valid, place, a, b, down, right = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5]
    smooth, slope = lines[6], lines[7]
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
        _apply_mask(valid[:n_cols], np.float32(r * n_bands % n_rows / n_rows - 0.5), place, a, b, down, right)
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
def _apply_mask(
    valid: Float32s, row: np.float32, place: Float32s, a: Float32s, b: Float32s, down: Float32s, right: Float32s
) -> None:
    for x in range(valid.size):
        place[x] = row * valid[x]
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
_SOLID = 1e-9
"""Part of the trace that keeps the shading of a block solvable whose known pixels lie in one line."""
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


def block_gradients(sums: Numbers, index: NDArray[np.intp], place: Numbers, noise: float) -> BlockGradients:
    """Return the block gradients with a separate brightness and contrast per block, so only a shift remains.

    The brightness has a slope along both axes: light that falls off to the corners of a field differs between the two
    pictures of an overlap. The contrast is that of a regression, which noise (standard deviation of a pixel of the
    second picture) reduces, less this reduction where it is under a half: too small a contrast would move an edge that
    lies across the border.
    """
    n = sums[:, 0, 0]
    spread = _without_shading(sums)
    first, second, both = np.maximum(spread[:, 0, 0], 0), np.maximum(spread[:, 1, 1], 0), spread[:, 0, 1]
    room = np.maximum(second, 1e-9 * n)
    regressed = np.maximum(both, 0) / room
    of_noise = n * (_SMOOTHED * noise) ** 2
    gain = np.maximum(both, 0) / (room - np.where(of_noise < room / 2, of_noise, 0.0))
    weight = n / np.maximum(first - regressed * np.maximum(both, 0), 1e-9 * n)
    weight = weight / (1 + weight / (4 * np.median(weight))) if len(weight) else weight
    trust = weight * regressed**2
    per_gain = np.divide(trust, gain, out=np.zeros_like(trust), where=gain > 0)
    pull = -per_gain[:, None] * (spread[:, 0, 2:] - gain[:, None] * spread[:, 1, 2:])
    stiffness = trust[:, None, None] * spread[:, 2:, 2:]
    return BlockGradients(index, place, n, first, second, both, pull, stiffness, trust)


def _without_shading(sums: Numbers) -> Numbers:
    """Return the products [n, 4, 4] of values and slopes, without what 1, row and column explain of a block."""
    shading, to_shading = sums[:, :N_SHADING, :N_SHADING], sums[:, :N_SHADING, N_SHADING:]
    trace = np.trace(shading, axis1=1, axis2=2)
    solid = shading + (_SOLID * trace)[:, None, None] * np.diag([0.0, 1.0, 1.0])
    return sums[:, N_SHADING:, N_SHADING:] - np.swapaxes(to_shading, 1, 2) @ np.linalg.solve(solid, to_shading)


def correlation(blocks: BlockGradients) -> float:
    """Return the correlation within blocks, -1 ... 1."""
    energy = float(blocks.first.sum() * blocks.second.sum())
    return float(blocks.both.sum()) / energy**0.5 if energy > 0 else 0.0


def covariance(blocks: BlockGradients, stiffness: Numbers, held: Numbers | None = None) -> Numbers:
    """Return the covariance of the lag from the scatter of the gradients; infinite for a singular Hessian.

    held: unit vectors of the determined directions, [2, k], both by default; `LOOSE_PX` is the standard uncertainty in
    the other direction.
    """
    basis = np.eye(2) if held is None else held
    n, pull, stiffness = len(blocks.pixels), blocks.pull @ basis, basis.T @ stiffness @ basis
    diagonal = np.diag(stiffness)
    if n < _LEAST_BLOCKS or not (diagonal > 0).all() or np.linalg.det(stiffness) <= 1e-9 * np.prod(diagonal):
        return np.full((2, 2), np.inf)
    spread = pull.T @ pull * (n / (n - 2))
    inverse = np.linalg.inv(stiffness)
    wider = np.maximum(np.diag(_spread_of_lines(pull, blocks.index)), np.diag(_spread_of_areas(pull, blocks.index)))
    more = np.sqrt(np.maximum(1.0, wider / np.maximum(np.diag(spread), 1e-30)))
    known = basis @ inverse @ (spread * np.outer(more, more)) @ inverse @ basis.T
    return np.asarray(known + LOOSE_PX**2 * (np.eye(2) - basis @ basis.T), np.float64)


def _spread_of_lines(pull: Numbers, index: NDArray[np.intp]) -> Numbers:
    """Return the scatter of the gradients with errors correlated along rows and columns, as at a straight edge.

    Source: A. C. Cameron, J. B. Gelbach, D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238.
    """
    rows, cols = (_spread_of(pull, index[:, axis]) for axis in (0, 1))
    return rows + cols - pull.T @ pull


def _spread_of_areas(pull: Numbers, index: NDArray[np.intp]) -> Numbers:
    """Return the same for nearby blocks: areas of a picture that come from different frames."""
    return np.maximum(*(_spread_of(pull, _numbered(index // side)) for side in _AREAS))


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
    anisotropic : float
        Stiffness of a direction beyond that of noise, relative to the other, below which it may be undetermined, as
        along lines.
    loose_noise : float
        Stiffness of such a direction, in that of noise, above which it is determined.
    loose_fraction : float
        The same, relative to the other direction.
    surely_rises : float, per px
        Smallest rise of the misfit in that direction, in the scatter of its gradient; a random picture rises by 1, at
        its best place by 2.
    least_rise : float
        The same without noise, relative to the other direction.
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
    anisotropic: float = 0.2
    loose_noise: float = 2.0
    loose_fraction: float = 0.001
    surely_rises: float = 4.0
    least_rise: float = 1e-5
    least_hessian_fraction: float = 0.05
    noise_slope: float = 0.3
    clearly: float = 10.0
    least_filled: float = 0.2
    least_pixels: float = 12.0


ALIGNMENT = AlignmentParameters()

LOOSE_PX = 1000.0
"""Standard uncertainty of a lag along lines, where nothing determines it."""

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

    covariance: [2, 2], infinite if undetermined, `LOOSE_PX` squared along lines; correlation: within blocks, -1 ... 1;
    agreeing: fraction of the contrast in blocks that fit on their own; bent_px: deviation of the lags of the outermost
    blocks from that in the middle, and bent_sigmas: its significance; n_blocks: number of blocks; unexplained: fraction
    of the variance within them that the lag leaves.
    """

    lag: Lag
    covariance: Numbers
    correlation: float
    agreeing: float
    bent_px: float
    bent_sigmas: float
    n_pixels: float
    n_blocks: int

    @property
    def held(self) -> Numbers:
        """Unit vectors of the directions that the picture determines, [2, k]."""
        return held_directions(self.covariance)

    unexplained: float


def held_directions(covariance: Numbers) -> Numbers:
    """Return the unit vectors along which a covariance is not that of a loose direction, [2, k]."""
    if not np.isfinite(covariance).all():
        return np.zeros((2, 0))
    variances, directions = np.linalg.eigh(covariance)
    return directions[:, variances < (LOOSE_PX / 2) ** 2]


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
    noise = math.sqrt(first.noise * second.noise)
    surface = _Surface.of(first, second, lag, side, pulls, noise)
    for _ in range(ALIGNMENT.most_steps):
        step, before = surface.step(pulls, ease), pulls
        lag = lag[0] + float(step[0]), lag[1] + float(step[1])
        if np.abs(step).max() < close_px:
            break
        pulls = _gradients(first, second, lag, side)
        if np.abs(step).max() > ALIGNMENT.telling_px and surface.measured is None:
            ease = _hessian_fraction(before, pulls, step)
    surface = _Surface.of(first, second, lag, side, pulls, noise)
    stiffness = pulls.stiffness.sum(axis=0)
    if surface.measured is not None:
        stiffness = surface.measured
    elif not roughly and not _is_clear(pulls, noise):
        stiffness = _hessian_by_differences(first, second, lag, side)
    alike = correlation(pulls)
    bent_px, bent_sigmas = shift_gradient(pulls) if surface.held.shape[1] == 2 else (0.0, 0.0)
    return SubpixelShift(
        lag,
        covariance(pulls, stiffness, surface.held),
        alike,
        agreement_fraction(pulls, noise),
        bent_px / ease,
        bent_sigmas,
        float(pulls.pixels.sum()),
        len(pulls.pixels),
        1 - alike**2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Rise of the misfit of two pictures about a lag.

    held: unit vectors of the directions in which it rises, [2, k]: one of lines, both of anything else; measured: its
    Hessian by differences, where the slopes in one direction are mostly those of noise; None elsewhere.
    """

    held: Numbers
    measured: Numbers | None

    @classmethod
    def of(
        cls, first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, pulls: BlockGradients, noise: float
    ) -> _Surface:
        """Look whether the picture determines the weaker direction, where its slopes are hardly more than noise.

        It does where the misfit really rises there, by more than that of a random picture may.
        """
        (weak, strong), directions = np.linalg.eigh(pulls.stiffness.sum(axis=0))
        of_noise = _noise_stiffness(pulls, noise)
        doubtful = max(ALIGNMENT.loose_noise * of_noise, ALIGNMENT.loose_fraction * strong)
        if weak >= doubtful or max(weak - of_noise, 0) >= ALIGNMENT.anisotropic * (strong - of_noise):
            return cls(np.eye(2), None)
        measured = _hessian_by_differences(first, second, lag, side)
        scatter = float(np.sqrt(np.sum((pulls.pull @ directions[:, 0]) ** 2)))
        rises = float(directions[:, 0] @ measured @ directions[:, 0])
        if rises > max(ALIGNMENT.surely_rises * scatter, ALIGNMENT.least_rise * strong):
            return cls(np.eye(2), measured)
        return cls(directions[:, 1:], None)

    def step(self, pulls: BlockGradients, ease: float) -> Numbers:
        """Return one Gauss-Newton step of at most a pixel, along the determined directions."""
        stiffness = pulls.stiffness.sum(axis=0) * ease if self.measured is None else self.measured
        stiffness = stiffness + 1e-6 * np.trace(stiffness) * np.eye(2) + 1e-30 * np.eye(2)
        step = np.linalg.solve(self.held.T @ stiffness @ self.held, self.held.T @ pulls.pull.sum(axis=0))
        return np.asarray(self.held @ step, np.float64).clip(-1, 1)


def _noise_stiffness(pulls: BlockGradients, noise: float) -> float:
    """Return the stiffness along any direction that slopes of pixel noise alone would have."""
    return float((pulls.trust * pulls.pixels).sum()) * (ALIGNMENT.noise_slope * noise) ** 2


def _hessian_fraction(before: BlockGradients, after: BlockGradients, step: Numbers) -> float:
    """Return the real fraction of the Hessian: slopes of the noise do not move with the picture.

    Both gradients count with the weights after the step, which a better fit has changed.
    """
    if not np.array_equal(before.index, after.index):
        return 1.0
    weight = np.divide(after.trust, before.trust, out=np.zeros_like(after.trust), where=before.trust > 0)
    decrease = float(step @ (weight @ before.pull - after.pull.sum(axis=0)))
    expected = float(step @ np.einsum("b,bij->ij", weight, before.stiffness) @ step)
    return min(1.0, max(ALIGNMENT.least_hessian_fraction, decrease / max(expected, 1e-30)))


def _is_clear(pulls: BlockGradients, noise: float) -> bool:
    """Return whether the slopes are those of the picture in every direction."""
    weakest = np.linalg.eigvalsh(pulls.stiffness.sum(axis=0))[0]
    return bool(weakest > ALIGNMENT.clearly * _noise_stiffness(pulls, noise))


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
    return block_gradients(flat[enough], index[enough], place[enough], second.noise)
