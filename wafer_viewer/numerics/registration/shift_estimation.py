"""How blocks of two pictures that lie on each other pull at their lag, how much they agree, and how sure they make it.

How sure comes from how differently they pull (the sandwich of P. J. Huber, 1967): noise that neighbouring pixels share,
or pictures that do not quite agree, make it less sure, as they should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_AREAS = (4, 8)
_SHOWS, _SMOOTHED = 3.0, 0.33
"""A block shows something when its variance is over three times that of the noise that is left in reading it."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BlockGradients:
    """What the blocks tell, all [n block]: index [n, 2], place [n, 2] in -1 ... 1, pixels, variances and covariance of
    the two, pull [n, 2] and stiffness [n, 2, 2] of the lag, and trust: how much of its slopes a block adds to that."""

    index: NDArray[np.intp]
    place: Numbers
    pixels: Numbers
    first: Numbers
    second: Numbers
    both: Numbers
    pull: Numbers
    stiffness: Numbers
    trust: Numbers


def pulls_of(sums: Numbers, index: NDArray[np.intp], place: Numbers) -> BlockGradients:
    """Each block with a brightness and contrast of its own: what is left is what a shift explains."""
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
    """Of what varies within blocks, -1 ... 1."""
    energy = float(blocks.first.sum() * blocks.second.sum())
    return float(blocks.both.sum()) / energy**0.5 if energy > 0 else 0.0


def covariance(blocks: BlockGradients, stiffness: Numbers) -> Numbers:
    """Of the lag, from how differently the blocks pull; infinite where the stiffness holds it in no direction."""
    n = len(blocks.pixels)
    if n < 4 or not (np.diag(stiffness) > 0).all() or np.linalg.det(stiffness) <= 1e-9 * np.prod(np.diag(stiffness)):
        return np.full((2, 2), np.inf)
    spread = blocks.pull.T @ blocks.pull * (n / (n - 2))
    inverse = np.linalg.inv(stiffness)
    wider = np.maximum(np.diag(_spread_of_lines(blocks)), np.diag(_spread_of_areas(blocks)))
    more = np.sqrt(np.maximum(1.0, wider / np.maximum(np.diag(spread), 1e-30)))
    return np.asarray(inverse @ (spread * np.outer(more, more)) @ inverse, np.float64)


def _spread_of_lines(blocks: BlockGradients) -> Numbers:
    """The spread of the pulls when blocks in a row and those in a column may err together, as along a straight edge.

    Source: A. C. Cameron, J. B. Gelbach, D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238.
    """
    rows, cols = (_spread_of(blocks.pull, blocks.index[:, axis]) for axis in (0, 1))
    return rows + cols - blocks.pull.T @ blocks.pull


def _spread_of_areas(blocks: BlockGradients) -> Numbers:
    """The same for blocks that are near each other: parts of a picture that come from different frames."""
    return np.maximum(*(_spread_of(blocks.pull, _numbered(blocks.index // side)) for side in _AREAS))


def _numbered(index: NDArray[np.intp]) -> NDArray[np.intp]:
    return index[:, 0] * (1 + index[:, 1].max()) + index[:, 1]


def _spread_of(pull: Numbers, cluster: NDArray[np.intp]) -> Numbers:
    _, of_cluster = np.unique(cluster, return_inverse=True)
    sums = np.stack([np.bincount(of_cluster, one) for one in pull.T], axis=1)
    return np.asarray(sums.T @ sums * (len(sums) / max(1, len(sums) - 1)), np.float64)


def agreeing(blocks: BlockGradients, noise: float) -> float:
    """How much of what is to be seen lies in blocks that are at least half as alike as the best of them.

    A block of strong contrast does not count for more than others that show more than noise.
    """
    strength = np.sqrt(blocks.first * blocks.second) / np.maximum(blocks.pixels, 1)
    seen = blocks.pixels * strength**2 / (strength**2 + (_SHOWS * (_SMOOTHED * noise) ** 2) ** 2 + 1e-30)
    if not seen.sum() > 0:
        return 0.0
    alike = blocks.both / np.maximum(strength * blocks.pixels, 1e-30)
    best = alike[np.argsort(seen)[len(seen) // 2 :]].max()
    return float(seen[alike > 0.5 * best].sum() / seen.sum())


def bent(blocks: BlockGradients) -> tuple[float, float]:
    """How far lags at the ends differ from that in the middle, in pixels and in standard deviations.

    Fits a lag that changes evenly across the blocks: content that is turned or grown against the other.
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
