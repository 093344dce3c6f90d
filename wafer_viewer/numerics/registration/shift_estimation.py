"""Gradient, agreement and covariance of a shift estimate from blocks of two overlapping pictures.

The covariance comes from the scatter of the block gradients (the sandwich of P. J. Huber, 1967): noise shared by
neighbouring pixels, or pictures that differ slightly, increase it as they should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_AREAS = (4, 8)
_SHOWS, _SMOOTHED = 3.0, 0.33
"""A block has signal if its variance exceeds three times that of the noise left after smoothing."""

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
    left = spread - spread[:, :, 1:2] * spread[:, 1:2, :] / room[:, None, None]
    weight = n / np.maximum(left[:, 0, 0], 1e-9 * n)
    weight = weight / (1 + weight / (4 * np.median(weight))) if len(weight) else weight
    pull = -(weight * gain)[:, None] * left[:, 0, 2:]
    stiffness = (weight * gain**2)[:, None, None] * left[:, 2:, 2:]
    return BlockGradients(index, place, n, first, second, both, pull, stiffness, weight * gain**2)


def correlation(blocks: BlockGradients) -> float:
    """Return the correlation within blocks, -1 ... 1."""
    energy = float(blocks.first.sum() * blocks.second.sum())
    return float(blocks.both.sum()) / energy**0.5 if energy > 0 else 0.0


def covariance(blocks: BlockGradients, stiffness: Numbers) -> Numbers:
    """Return the covariance of the lag from the scatter of the gradients; infinite for a singular Hessian."""
    n = len(blocks.pixels)
    if n < 4 or not (np.diag(stiffness) > 0).all() or np.linalg.det(stiffness) <= 1e-9 * np.prod(np.diag(stiffness)):
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
    seen = blocks.pixels * strength**2 / (strength**2 + (_SHOWS * (_SMOOTHED * noise) ** 2) ** 2 + 1e-30)
    if not seen.sum() > 0:
        return 0.0
    alike = blocks.both / np.maximum(strength * blocks.pixels, 1e-30)
    best = alike[np.argsort(seen)[len(seen) // 2 :]].max()
    return float(seen[alike > 0.5 * best].sum() / seen.sum())


def shift_gradient(blocks: BlockGradients) -> tuple[float, float]:
    """Return the deviation of lags at the ends from that in the middle, in pixels and in standard deviations.

    Fits a lag that varies linearly across the blocks, for contents rotated or scaled against each other.
    """
    n = len(blocks.pixels)
    if n < 8:
        return 0.0, 0.0
    basis = np.einsum("bi,jk->bijk", blocks.place, np.eye(2)).reshape(n, 4, 2)
    pulls = np.einsum("bpj,bj->bp", basis, blocks.pull)
    stiffness = np.einsum("bpi,bij,bqj->pq", basis, blocks.stiffness, basis)
    stiffness += (1e-6 * np.trace(stiffness) + 1e-30) * np.eye(4)
    inverse = np.linalg.inv(stiffness)
    bend = inverse @ pulls.sum(axis=0)
    left = np.einsum("bpj,bj->bp", basis, blocks.pull - np.einsum("bij,bqj,q->bi", blocks.stiffness, basis, bend))
    spread = inverse @ (left.T @ left) @ inverse
    most = int(np.argmax(np.abs(bend)))
    return float(np.abs(bend[most])), float(np.abs(bend[most]) / np.sqrt(max(spread[most, most], 1e-30)))
