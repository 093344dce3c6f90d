"""Gradients of the misfit of two pictures in each block, and the covariance of their lag.

The covariance of a lag comes from the scatter of the block gradients (the sandwich of P. J. Huber, 1967): noise shared
by neighbouring pixels, or pictures that differ slightly, increase it as they should.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.numerics.block_sums import N_LINES, N_SHADING, Numbers
from wafer_viewer.numerics.jit import Float64s, Int, Int64s, lean_kernel, lean_part

LOOSE_PX = 1000.0
"""Standard uncertainty of a lag along lines, where nothing determines it."""
(_ONE,) = np.ones(1, np.int64)
"""A numpy integer: numba would compile a function anew for a literal one."""
_AREAS = (4, 8)
"""Sides of the areas, in blocks, over which errors may be correlated."""
_SHOWS = 3.0
"""Variance of a block with signal, relative to that of the noise left after smoothing."""
_SMOOTHED = 0.33
"""Noise left after smoothing, relative to that of a pixel."""
_SOLID = 1e-9
"""Part of the trace that keeps the shading of a block solvable whose known pixels lie in one line."""
_LEAST_REAL = 0.05
"""Smallest real fraction of a Hessian."""
_LEAST_BLOCKS = 4
"""Smallest number of blocks for a covariance."""
_DRIFT = 2.1
"""Variance of a lag by drift, relative to that of the shifts of blocks over the root of its degrees of freedom.

Drift is what shifts blocks smoothly: parts of a picture that come from different frames. That of n equal parts would
fall with n, but nothing tells how large they are. Simulated optics of tests/truth/field_grid.py set it and the numbers
of blocks: fields of 200 x 270 to 1080 x 1440, seeds 2 to 21 and 200 to 299.
"""
_DRIFT_BLOCKS, _LEAST_FREEDOM = 8.0, 2.0
"""Number of blocks for a degree of freedom of drift, and the smallest number of these."""
_LEAST_BLOCKS_BENT = 8
"""Smallest number of blocks for a shift that varies across them."""
_LEAST_BLOCKS_CURVED = 10
"""The same for one that varies with the square of the place."""
N_BEND_TERMS = 6
"""Number of terms of a bend."""


@dataclass(frozen=True, slots=True, eq=False)
class LagErrors:
    """Covariance of a lag, [2, 2], drift included, infinite where undetermined; and what the drift is.

    drift: variance of the shifts of blocks beyond those between neighbours, along rows and columns, [2]; below zero by
    chance, NaN where it is unknown; freedom: its degrees of freedom.
    """

    covariance: Numbers
    drift: Numbers
    freedom: float


def variance_per_drift(freedom: Numbers | float) -> Numbers:
    """Return the variance of a lag for a unit variance of drift with some degrees of freedom."""
    return np.asarray(_DRIFT / np.sqrt(freedom), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BlockGradients:
    """Statistics of the blocks, all [n block].

    index: row and column of a block, [n, 2]; table, total: what the properties show, by block and over all of them;
    grid: rows and columns of blocks.
    """

    index: Int64s
    table: Numbers
    total: Numbers
    grid: tuple[int, int]

    @property
    def place(self) -> Numbers:
        """Middle of a block, -1 ... 1, [n, 2]."""
        return self.table[:, :2]

    @property
    def pixels(self) -> Numbers:
        """Number of known pixels."""
        return self.table[:, 2]

    @property
    def first(self) -> Numbers:
        """Variance of the first picture, times the pixels."""
        return self.table[:, 3]

    @property
    def second(self) -> Numbers:
        """Variance of the second picture, times the pixels."""
        return self.table[:, 4]

    @property
    def both(self) -> Numbers:
        """Their covariance, times the pixels."""
        return self.table[:, 5]

    @property
    def pull(self) -> Numbers:
        """Gradient of the lag, [n, 2]."""
        return self.table[:, 6:8]

    @property
    def stiffness(self) -> Numbers:
        """Hessian of the lag, [n, 2, 2]."""
        return self.table[:, 8:12].reshape(len(self.table), 2, 2)

    @property
    def trust(self) -> Numbers:
        """Weight of a block's slopes in the Hessian."""
        return self.table[:, 12]

    @property
    def total_pull(self) -> Numbers:
        """Sum of the gradients, [2]."""
        return self.total[:2]

    @property
    def total_stiffness(self) -> Numbers:
        """Sum of the Hessians, [2, 2]."""
        return self.total[2:6].reshape(2, 2)

    @property
    def correlation(self) -> float:
        """Correlation within all blocks, -1 ... 1."""
        first, second, both = self.total[6:9].tolist()
        return both / (first * second) ** 0.5 if first * second > 0 else 0.0


def block_gradients(sums: Numbers, noise: float, least_pixels: float, least_filled: float) -> BlockGradients:
    """Return the block gradients with a separate brightness and contrast per block, so only a shift remains.

    The brightness has a slope along both axes: light that falls off to the corners of a field differs between the two
    pictures of an overlap. The contrast is that of a regression, which noise (standard deviation of a pixel of the
    second picture) reduces, less this reduction where it is under a half: too small a contrast would move an edge that
    lies across the border. Blocks with fewer known pixels than given, or than this fraction of the fullest, are
    omitted. The sums are overwritten.
    """
    n = sums.shape[0] * sums.shape[1]
    index, table, room, total = np.empty((n, 2), np.int64), np.empty((n, 13)), np.empty((3, n)), np.zeros(9)
    n = _fill_gradients(sums, noise, least_pixels, least_filled, index, table, total, room)
    return BlockGradients(index[:n], table[:n], total, (sums.shape[0], sums.shape[1]))


@lean_kernel
def _fill_gradients(
    sums: Float64s,
    noise: float,
    least_pixels: float,
    least_filled: float,
    index: Int64s,
    table: Float64s,
    total: Float64s,
    room: Float64s,
) -> int:
    """Fill rows (place, pixels, first, second, both, pull, stiffness, trust) of the blocks, and return their number."""
    n_rows, n_cols = sums.shape[0], sums.shape[1]
    fullest = 0.0
    for r in range(n_rows):
        for c in range(n_cols):
            fullest = max(fullest, sums[r, c, 0, 0])
    weight, gains, n = room[0], room[1], 0
    for r in range(n_rows):
        for c in range(n_cols):
            pixels = sums[r, c, 0, 0]
            if pixels > max(least_filled * fullest, least_pixels):
                _without_shading(sums[r, c])
                s = sums[r, c, N_SHADING:, N_SHADING:]
                first, second, both = max(s[0, 0], 0.0), max(s[1, 1], 0.0), max(s[0, 1], 0.0)
                strength, of_noise = max(second, 1e-9 * pixels), pixels * (_SMOOTHED * noise) ** 2
                regressed = both / strength
                gain = both / (strength - (of_noise if of_noise < strength / 2 else 0.0))
                weight[n] = pixels / max(first - regressed * both, 1e-9 * pixels)
                gains[n] = gain
                index[n, 0], index[n, 1] = r, c
                row = table[n]
                row[0], row[1] = 2 * (r + 0.5) / n_rows - 1, 2 * (c + 0.5) / n_cols - 1
                row[2], row[3], row[4], row[5] = pixels, first, second, s[0, 1]
                row[6], row[7] = gain * s[1, 2] - s[0, 2], gain * s[1, 3] - s[0, 3]
                down, right = s[1, 2] / strength, s[1, 3] / strength
                row[8], row[11] = s[2, 2] - down * s[1, 2], s[3, 3] - right * s[1, 3]
                row[9] = row[10] = s[2, 3] - down * s[1, 3]
                row[12] = regressed
                n += 1
    usual = _median(weight[:n], room[2])
    for k in range(n):
        row = table[k]
        trust = weight[k] / (1 + weight[k] / (4 * usual)) * row[12] ** 2
        per_gain = trust / gains[k] if gains[k] > 0 else 0.0
        row[6], row[7], row[12] = row[6] * per_gain, row[7] * per_gain, trust
        for j in range(8, 12):
            row[j] *= trust
        for j in range(6):
            total[j] += row[6 + j]
        for j in range(3):
            total[6 + j] += row[3 + j]
    return n


@lean_part
def _without_shading(matrix: Float64s) -> None:
    """Take what 1, row and column explain of a block off the products of values and slopes."""
    solid = _SOLID * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2])
    matrix[1, 1] += solid
    matrix[2, 2] += solid
    for i in range(N_SHADING):
        pivot = max(matrix[i, i], solid)
        for j in range(i + 1, N_LINES + 1):
            part = matrix[i, j] / pivot
            for k in range(j, N_LINES + 1):
                matrix[j, k] -= part * matrix[i, k]
                matrix[k, j] = matrix[j, k]


@lean_part
def _median(values: Float64s, room: Float64s) -> float:
    n = values.size
    if n == 0:
        return 1.0
    ordered = room[:n]
    _sort(values, ordered)
    return (ordered[(n - 1) // 2] + ordered[n // 2]) / 2


@lean_part
def _sort(values: Float64s, ordered: Float64s) -> None:
    n = values.size
    for i in range(n):
        ordered[i] = values[i]
    gap = n // 2
    while gap > 0:
        for i in range(gap, n):
            value, j = ordered[i], i
            while j >= gap and ordered[j - gap] > value:
                ordered[j] = ordered[j - gap]
                j -= gap
            ordered[j] = value
        gap //= 2


def lag_errors(blocks: BlockGradients, stiffness: Numbers, held: Numbers) -> LagErrors:
    """Return the covariance of the lag from the scatter of the gradients; infinite for a singular Hessian.

    held: unit vectors of the determined directions, [2, k]; `LOOSE_PX` is the standard uncertainty in the other.

    Errors that neighbouring blocks have in common increase the scatter: along rows and columns, as at a straight edge
    (A. C. Cameron, J. B. Gelbach, D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238), or in areas of a picture that come
    from different frames, whichever is more. Shifts of single blocks beyond those between neighbours do too.
    """
    n, known, drift = len(blocks.pixels), np.full((2, 2), np.inf), np.full(2, np.nan)
    freedom = max(_LEAST_FREEDOM, n / _DRIFT_BLOCKS)
    if n >= _LEAST_BLOCKS:
        room, table, small = np.empty((blocks.grid[0] * blocks.grid[1], 3)), np.empty((2, n, 2)), np.empty((14, 2))
        _fill_covariance(
            *(blocks.pull, blocks.stiffness, blocks.index, blocks.grid, stiffness, held),
            *(float(variance_per_drift(freedom)), room, table, small, known, drift),
        )
    return LagErrors(known, drift if held.shape[1] == 2 else np.full(2, np.nan), freedom)


@lean_kernel
def _fill_covariance(
    block_pull: Float64s,
    block_stiffness: Float64s,
    index: Int64s,
    grid: tuple[int, int],
    stiffness: Float64s,
    held: Float64s,
    per_drift: float,
    room: Float64s,
    table: Float64s,
    small: Float64s,
    known: Float64s,
    drift: Float64s,
) -> None:
    n, k = index.shape[0], held.shape[1]
    pull, stiff = table[0, :, :k], table[1, :, :k]
    hessian, inverse, spread, by, clusters = small[:2], small[2:4], small[4:6], small[6:8], small[8:12]
    more, by_drift = small[12], small[13]
    _project(block_pull, block_stiffness, held, pull, stiff)
    for i in range(k):
        for j in range(k):
            hessian[i, j] = spread[i, j] = 0.0
            for a in range(2):
                for b in range(2):
                    hessian[i, j] += held[a, i] * stiffness[a, b] * held[b, j]
            for b in range(n):
                spread[i, j] += pull[b, i] * pull[b, j] * (n / (n - 2))
    if not _invert(hessian[:k, :k], inverse):
        known[:] = math.inf
        return
    _fill_spread(pull, index, _ONE, grid[1], room, clusters[0])
    _fill_spread(pull, index, grid[0], _ONE, room, clusters[1])
    for of_area in range(2):
        _fill_spread(pull, index, _AREAS[of_area], _AREAS[of_area], room, clusters[2 + of_area])
    _fill_drift(pull, stiff, index, drift[:k])
    for j in range(k):
        along_either = clusters[0, j] + clusters[1, j] - spread[j, j] * ((n - 2) / n)
        correlated = max(along_either, clusters[2, j], clusters[3, j])
        more[j] = math.sqrt(max(1.0, correlated / max(spread[j, j], 1e-30)))
        total = 0.0
        for b in range(n):
            total += stiff[b, j]
        drift[j] /= max(hessian[j, j] / max(total, 1e-30), _LEAST_REAL) ** 2
        by_drift[j] = per_drift * drift[j] if drift[j] > 0 else 0.0
        for a in range(2):
            by[a, j] = 0.0
            for i in range(k):
                by[a, j] += held[a, i] * inverse[i, j] * more[j]
    for a in range(2):
        for b in range(2):
            known[a, b] = LOOSE_PX**2 if k == 1 and a == b else 0.0
            for i in range(k):
                known[a, b] += held[a, i] * held[b, i] * (by_drift[i] - (LOOSE_PX**2 if k == 1 else 0.0))
                for j in range(k):
                    known[a, b] += by[a, i] * spread[i, j] * by[b, j]


@lean_part
def _project(block_pull: Float64s, block_stiffness: Float64s, held: Float64s, pull: Float64s, stiff: Float64s) -> None:
    """Fill the gradients and the stiffness of blocks along the determined directions, [n, k]."""
    for b in range(pull.shape[0]):
        for j in range(pull.shape[1]):
            pull[b, j] = stiff[b, j] = 0.0
            for i in range(2):
                pull[b, j] += block_pull[b, i] * held[i, j]
                for m in range(2):
                    stiff[b, j] += held[i, j] * block_stiffness[b, i, m] * held[m, j]


@lean_part
def _invert(matrix: Float64s, inverse: Float64s) -> bool:
    """Invert a positive definite matrix, [1, 1] or [2, 2]; return whether it is not singular."""
    if matrix.shape[0] == 1:
        inverse[0, 0] = 1 / matrix[0, 0] if matrix[0, 0] > 0 else 0.0
        return matrix[0, 0] > 0
    a, b, c, d = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    determinant = a * d - b * c
    if not (a > 0 and d > 0 and determinant > 1e-9 * a * d):
        return False
    inverse[0, 0], inverse[0, 1], inverse[1, 0], inverse[1, 1] = d, -b, -c, a
    inverse /= determinant
    return True


@lean_part
def _fill_drift(pull: Float64s, stiff: Float64s, index: Int64s, out: Float64s) -> None:
    """Write the variance of the shifts of blocks beyond that of noise, which shifts between neighbours show.

    A shift has a variance of noise / stiffness, and one degree of freedom went into the lag.
    """
    for j in range(out.size):
        n = n_pairs = total = of_all = between = 0.0
        for b in range(index.shape[0]):
            if stiff[b, j] > 0:
                n += 1
                total += pull[b, j] ** 2 / stiff[b, j]
                of_all += stiff[b, j]
                for c in range(b):
                    apart = abs(index[b, 0] - index[c, 0]) + abs(index[b, 1] - index[c, 1])
                    if apart == 1 and stiff[c, j] > 0:
                        off = pull[b, j] / stiff[b, j] - pull[c, j] / stiff[c, j]
                        between += off * off * stiff[b, j] * stiff[c, j] / (stiff[b, j] + stiff[c, j])
                        n_pairs += 1
        out[j] = (total - between / n_pairs * (n - 1)) / of_all if n_pairs > 0 else math.nan


@lean_part
def _fill_spread(pull: Float64s, index: Int64s, n_rows: Int, n_cols: Int, room: Float64s, out: Float64s) -> None:
    """Sum up the squares of the sums over clusters of n_rows x n_cols blocks."""
    across, k = room.shape[0], pull.shape[1]
    widest = 0
    for b in range(index.shape[0]):
        widest = max(widest, index[b, 1] // n_cols)
    for cluster in range(across):
        room[cluster] = 0.0
    for b in range(index.shape[0]):
        cluster = index[b, 0] // n_rows * (widest + 1) + index[b, 1] // n_cols
        room[cluster, 2] = 1.0
        for j in range(k):
            room[cluster, j] += pull[b, j]
    n = 0.0
    out[:] = 0.0
    for cluster in range(across):
        n += room[cluster, 2]
        for j in range(k):
            out[j] += room[cluster, j] ** 2
    for j in range(k):
        out[j] *= n / max(1.0, n - 1)


def agreement_fraction(blocks: BlockGradients, noise: float) -> float:
    """Return the fraction of the signal in blocks with at least half the correlation of the best ones.

    A block of strong contrast has no more weight than others with a signal above noise.
    """
    return _agreement(blocks.table, noise, np.empty((3, len(blocks.table))))


@lean_kernel
def _agreement(table: Float64s, noise: float, room: Float64s) -> float:
    """Return that fraction; a column of one block would be another kind of array, for which numba compiles anew."""
    n, of_noise, total = len(table), (_SHOWS * (_SMOOTHED * noise) ** 2) ** 2, 0.0
    visible, correlation = room[0], room[1]
    for b in range(n):
        pixels, first, second, both = table[b, 2], table[b, 3], table[b, 4], table[b, 5]
        strength = math.sqrt(first * second) / max(pixels, 1.0)
        visible[b] = pixels * strength**2 / (strength**2 + of_noise + 1e-30)
        correlation[b] = both / max(strength * pixels, 1e-30)
        total += visible[b]
    if not total > 0:
        return 0.0
    _sort(visible, room[2])
    best, agreeing = -1.0, 0.0
    for b in range(n):
        if visible[b] >= room[2, n // 2]:
            best = max(best, correlation[b])
    for b in range(n):
        if correlation[b] > 0.5 * best:
            agreeing += visible[b]
    return agreeing / total


def shift_gradient(blocks: BlockGradients) -> tuple[float, float]:
    """Return the deviation of lags at the ends from that in the middle, in pixels and in standard deviations.

    Fits a lag that varies linearly across the blocks, for contents rotated or scaled against each other.
    """
    if len(blocks.pixels) < _LEAST_BLOCKS_BENT:
        return 0.0, 0.0
    bend, u = _fitted_bend(blocks, blocks.place)
    most = int(np.argmax(np.abs(bend)))
    return abs(float(bend[most])), abs(float(bend[most] / u[most]))


def bend_terms(blocks: BlockGradients) -> Numbers:
    """Return how the lag (down, right) changes over the blocks, and the standard uncertainties, [2, 6], in pixels.

    The terms are the changes from the middle to the ends along rows and along columns, and the coefficient of the
    Legendre polynomial of second degree along the longer side: 1 at its ends, -1/2 in the middle. NaN for few blocks.
    """
    if len(blocks.pixels) < _LEAST_BLOCKS_CURVED:
        return np.full((2, N_BEND_TERMS), np.nan)
    along = blocks.place[:, 0] if blocks.grid[0] > blocks.grid[1] else blocks.place[:, 1]
    basis = np.column_stack((np.ones_like(along), blocks.place, 1.5 * along**2 - 0.5))
    return np.stack(_fitted_bend(blocks, basis))[:, 2:]


def _fitted_bend(blocks: BlockGradients, basis: Numbers) -> tuple[Numbers, Numbers]:
    """Return the coefficients (down, right) of functions [n, k] in the shifts of blocks, and their uncertainties."""
    size = 2 * basis.shape[1]
    square, line = np.zeros((3, size, size)), np.zeros((2, size))
    _fit_bend(np.ascontiguousarray(basis), blocks.pull, blocks.stiffness, *square, *line)
    return line[1], np.sqrt(np.maximum(line[0], 1e-30))


@lean_kernel
def _fit_bend(
    basis: Float64s,
    pull: Float64s,
    stiffness: Float64s,
    hessian: Float64s,
    inverse: Float64s,
    spread: Float64s,
    sums: Float64s,
    bend: Float64s,
) -> None:
    """Fit a bend, and write its variances over the sums."""
    size = bend.size
    _fill_bend(basis, pull, stiffness, bend, sums, hessian, spread)
    trace = 0.0
    for p in range(size):
        trace += hessian[p, p]
    for p in range(size):
        hessian[p, p] += 1e-6 * trace + 1e-30
    _invert_in_place(hessian, inverse)
    for p in range(size):
        for q in range(size):
            bend[p] += inverse[p, q] * sums[q]
    _fill_bend(basis, pull, stiffness, bend, sums, hessian, spread)
    for k in range(size):
        sums[k] = 0.0
        for p in range(size):
            for q in range(size):
                sums[k] += inverse[k, p] * spread[p, q] * inverse[k, q]


@lean_part
def _invert_in_place(matrix: Float64s, inverse: Float64s) -> None:
    """Fill the inverse of a positive definite matrix, which is overwritten (Gauss and Jordan)."""
    n = matrix.shape[0]
    for i in range(n):
        for j in range(n):
            inverse[i, j] = 1.0 if i == j else 0.0
    for i in range(n):
        pivot = matrix[i, i]
        for j in range(n):
            matrix[i, j] /= pivot
            inverse[i, j] /= pivot
        for k in range(n):
            if k != i:
                part = matrix[k, i]
                for j in range(n):
                    matrix[k, j] -= part * matrix[i, j]
                    inverse[k, j] -= part * inverse[i, j]


@lean_part
def _fill_bend(
    basis: Float64s,
    pull: Float64s,
    stiffness: Float64s,
    bend: Float64s,
    sums: Float64s,
    hessian: Float64s,
    spread: Float64s,
) -> None:
    """Sum up gradient, Hessian and scatter of the gradient of a bend: (down, right) of each function of the place."""
    size = bend.size
    sums[:], hessian[:], spread[:] = 0.0, 0.0, 0.0
    for b in range(basis.shape[0]):
        rest0, rest1 = pull[b, 0], pull[b, 1]
        for j in range(basis.shape[1]):
            down, right = basis[b, j] * bend[2 * j], basis[b, j] * bend[2 * j + 1]
            rest0 -= stiffness[b, 0, 0] * down + stiffness[b, 0, 1] * right
            rest1 -= stiffness[b, 1, 0] * down + stiffness[b, 1, 1] * right
        for p in range(size):
            of_p = basis[b, p // 2] * (rest0 if p % 2 == 0 else rest1)
            sums[p] += of_p
            for q in range(size):
                spread[p, q] += of_p * basis[b, q // 2] * (rest0 if q % 2 == 0 else rest1)
                hessian[p, q] += basis[b, p // 2] * basis[b, q // 2] * stiffness[b, p % 2, q % 2]


def decreases(before: BlockGradients, after: BlockGradients, step: tuple[float, float]) -> tuple[float, float] | None:
    """Return by how much the gradient decreased along a step, and by how much its Hessian says that it does.

    Both gradients count with the weights after the step, which a better fit has changed. None where the blocks are not
    the same.
    """
    if len(before.index) != len(after.index) or not np.array_equal(before.index, after.index):
        return None
    out = np.zeros(2)
    _fill_decreases(before.pull, before.stiffness, before.trust, after.pull, after.trust, step, out)
    return float(out[0]), float(out[1])


@lean_kernel
def _fill_decreases(
    pull: Float64s,
    stiffness: Float64s,
    trust: Float64s,
    later_pull: Float64s,
    later_trust: Float64s,
    step: tuple[float, float],
    out: Float64s,
) -> None:
    down, right = step[0], step[1]
    for b in range(trust.size):
        weight = later_trust[b] / trust[b] if trust[b] > 0 else 0.0
        out[0] += down * (weight * pull[b, 0] - later_pull[b, 0]) + right * (weight * pull[b, 1] - later_pull[b, 1])
        s = stiffness[b]
        out[1] += weight * (down * (s[0, 0] * down + s[0, 1] * right) + right * (s[1, 0] * down + s[1, 1] * right))
