"""Edges of a profile: two of a groove or a ridge, or one of a step, for any tilt of the profile.

The model with the largest explained sum of squares is chosen: z = a x + b + h delta, where delta is 1 between two
places and 0 outside. Running sums give the explained sum of squares of every pair of places, so that all are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats

BINS = 300
"""Number of means along the profile for the exhaustive search; then single samples are tried."""
MEDIAN_OF = 5
"""Window of the running median, in samples, which removes single false heights."""
LEAST_BINS = 2
ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class SideSums:
    """Running sums over samples of a profile: count, centred place, and residual from a straight line."""

    n: Floats
    x: Floats
    left: Floats
    x_squares: float

    @classmethod
    def of(cls, x: Floats, z: Floats) -> SideSums:
        """Return the running sums of samples at x with heights z, both [n]."""
        about = x - x.mean()
        squares = float(about @ about)
        left = z - z.mean() - about * (float(about @ z) / squares)
        count, place, rest = (np.concatenate([[0.0], np.cumsum(c)]) for c in (np.ones(len(x)), about, left))
        return cls(count, place, rest, squares)

    def explained(self, first: np.ndarray, end: np.ndarray) -> Floats:
        """Return the sum of squares explained by a jump of samples first ... end - 1; indices broadcast."""
        count, place, left = (column[end] - column[first] for column in (self.n, self.x, self.left))
        spread = count - count**2 / self.n[-1] - place**2 / self.x_squares
        return np.where(spread > 1e-9, left**2 / np.maximum(spread, 1e-9), 0.0)


def groove_edges(x: Floats, z: Floats) -> tuple[int, int]:
    """Return the range of the bottom's samples: first and end, 0 < first < end < n."""
    even, ends = smooth(z), _bins(len(x))
    coarse = SideSums.of(_means(x, ends), _means(even, ends))
    n = len(ends) - 1
    first, end = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    allowed = (first >= LEAST_BINS) & (end <= n - LEAST_BINS) & (end - first >= LEAST_BINS)
    best = np.argmax(np.where(allowed, coarse.explained(first, end), -1.0))
    i, j = (int(ends[k]) for k in divmod(int(best), n + 1))
    fine, reach = SideSums.of(x, even), 2 * -(-len(x) // n)
    for _ in range(ROUNDS):
        i = _best(fine, np.arange(max(1, i - reach), min(j, i + reach + 1)), np.array(j))
        j = _best(fine, np.array(i), np.arange(max(i + 1, j - reach), min(len(x), j + reach + 1)))
    return i, j


def step_edge(x: Floats, z: Floats) -> int:
    """Return the first sample beyond the edge of a single step."""
    sums = SideSums.of(x, smooth(z))
    return _best(sums, np.arange(LEAST_BINS, len(x) - LEAST_BINS), np.array(len(x)))


def _best(sums: SideSums, first: np.ndarray, end: np.ndarray) -> int:
    """Return the varying index with the largest explained sum of squares."""
    varies = first if first.ndim else end
    return int(varies[np.argmax(sums.explained(first, end))])


def smooth(z: Floats) -> Floats:
    """Remove single false heights with a running median."""
    from scipy.ndimage import median_filter

    return median_filter(z, MEDIAN_OF, mode="nearest")


def _bins(n: int) -> np.ndarray:
    return np.unique(np.linspace(0, n, min(n, BINS) + 1).round().astype(np.intp))


def _means(values: Floats, ends: np.ndarray) -> Floats:
    return np.add.reduceat(values, ends[:-1]) / np.diff(ends)
