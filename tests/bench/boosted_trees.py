"""Gradient boosting of symmetric trees for a probability, in few lines, so that training needs no other package.

Every tree asks the same questions on every path. Questions are found among quantiles of each score by histograms of
the first and second derivatives of the logistic loss. A score may be forced to raise or to lower the probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

BINS = 64
_SAMPLE = 200_000


class Boosted(NamedTuple):
    """Trees: numbers of the scores and limits [tree, question], leaves [tree, leaf], and the sum before any tree."""

    scores: NDArray[np.intp]
    limits: NDArray[np.float32]
    leaves: NDArray[np.float64]
    bias: float


@dataclass(frozen=True)
class Boosting:
    """How many trees, how many questions each, the share of each that counts, and how leaves are drawn to zero.

    every: of so many trees, the others ask only of scores that are cheap; share: of the points, and of the scores, that
    a tree sees.
    """

    trees: int = 240
    questions: int = 3
    every: int = 6
    rate: float = 0.12
    ridge: float = 20.0
    share: float = 0.5
    seed: int = 0


def fit(
    scores: NDArray[np.float32],
    is_right: NDArray[np.bool_],
    weight: NDArray[np.floating],
    direction: NDArray[np.integer],
    cheap: NDArray[np.bool_],
    how: Boosting = Boosting(),
) -> Boosted:
    """Fit trees to points [n, score]; direction: 1 where a score may only raise the probability, -1 only lower it."""
    rng = np.random.default_rng(how.seed)
    weight = weight / weight.mean()
    limits = _quantiles(scores[rng.choice(len(scores), min(_SAMPLE, len(scores)), replace=False)])
    bins = np.stack([np.searchsorted(q, s) for q, s in zip(limits, scores.T, strict=True)], axis=1).astype(np.uint8)
    n = len(scores)
    bias = float(np.log(weight[is_right].sum() / weight[~is_right].sum()))
    total = np.full(n, bias)
    asked, at, leaves = [], [], []
    for number in range(how.trees):
        p = 1 / (1 + np.exp(-total))
        slope, curvature = weight * (is_right - p), weight * p * (1 - p)
        rows = np.flatnonzero(rng.random(n) < how.share)
        open_ = np.flatnonzero(cheap) if (number + 1) % how.every else np.arange(cheap.size)
        cols = np.sort(rng.choice(open_, int(open_.size * how.share), replace=False))
        leaf, questions = np.zeros(n, np.uint8), []
        for bit in range(how.questions):
            sums = _histogram(bins, leaf, slope, curvature, rows, cols, 1 << bit)
            gain = _gain(sums, how.ridge, direction[cols])
            for k, col in enumerate(cols):
                gain[k, len(limits[col]) :] = -1
            k, b = np.unravel_index(gain.argmax(), gain.shape)
            questions.append((cols[k], b))
            leaf |= (bins[:, cols[k]] > b).astype(np.uint8) << bit
        values = _leaves(leaf[rows], slope[rows], curvature[rows], questions, direction, how)
        total += values[leaf]
        asked.append([col for col, _ in questions])
        at.append([limits[col][b] for col, b in questions])
        leaves.append(values)
    return Boosted(np.array(asked), np.array(at, np.float32), np.array(leaves), bias)


def probability(trees: Boosted, scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """The probability of points [n, score]."""
    total = np.full(len(scores), trees.bias)
    for asked, limits, leaves in zip(trees.scores, trees.limits, trees.leaves, strict=True):
        bits = scores[:, asked] > limits
        total += leaves[bits @ (1 << np.arange(len(asked)))]
    return 1 / (1 + np.exp(-total))


def _quantiles(scores: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    at = np.linspace(0, 1, BINS + 1)[1:-1]
    return [np.unique(np.quantile(one, at, method="lower")).astype(np.float32) for one in scores.T]


@numba.njit(cache=False)
def _histogram(bins, leaf, slope, curvature, rows, cols, n_leaves):  # pragma: no cover
    out = np.zeros((n_leaves, cols.size, BINS, 2))
    for i in rows:
        for k in range(cols.size):
            cell = out[leaf[i], k, bins[i, cols[k]]]
            cell[0] += slope[i]
            cell[1] += curvature[i]
    return out


def _gain(sums: NDArray[np.float64], ridge: float, direction: NDArray[np.integer]) -> NDArray[np.float64]:
    """The gain of each question [score, bin], -1 where an answer would act against its direction."""
    below = sums.cumsum(axis=2)
    every = below[:, :, -1:]
    above = every - below
    low, high = (part[..., 0] / (part[..., 1] + ridge) for part in (below, above))
    gain = below[..., 0] * low + above[..., 0] * high - every[..., 0] ** 2 / (every[..., 1] + ridge)
    against = ((high - low) * direction[:, None] < 0).any(axis=0)
    return np.where(against, -1, gain.sum(axis=0))


def _leaves(leaf, slope, curvature, questions, direction, how) -> NDArray[np.float64]:
    """The value of each leaf; leaves that a forced score would order wrongly take their mean."""
    n = 1 << how.questions
    slopes, curvatures = np.bincount(leaf, slope, n), np.bincount(leaf, curvature, n)
    values = how.rate * slopes / (curvatures + how.ridge)
    weights = curvatures + 1e-9
    for _ in range(how.questions):
        for bit, (col, _) in enumerate(questions):
            low = np.flatnonzero(~np.arange(n) >> bit & 1)
            high = low | 1 << bit
            wrong = (values[high] - values[low]) * direction[col] < 0
            pair = low[wrong], high[wrong]
            mean = sum(weights[one] * values[one] for one in pair) / sum(weights[one] for one in pair)
            for one in pair:
                values[one] = mean
    return values
