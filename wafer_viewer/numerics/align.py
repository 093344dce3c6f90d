"""The shift between two pictures to a small part of a pixel, and how sure it is.

Gauss-Newton on grey values (B. D. Lucas, T. Kanade, IJCAI 1981), block by block: each block has a brightness and a
contrast of its own, so that no light that differs matters, and counts by how well it fits. How sure the shift is comes
from how differently the blocks pull (the sandwich of P. J. Huber, 1967): noise that neighbouring pixels share, or
pictures that do not quite agree, make it less sure, as they should.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.arrays import Float32s
from wafer_viewer.numerics.blocks import block_sums

MOST_STEPS = 6
_CLOSE_PX = 0.004
_TELLING_PX = 0.05
_PROBE = np.array([0.2, 0.2])
_NEARLY_NO_NOISE = 0.95
_LEAST_EASE = 0.05
_AREAS = (4, 8)
_SHOWS, _SMOOTHED = 3.0, 0.33
"""A block shows something when its variance is over three times that of the noise that is left in reading it."""
_LEAST_PIXELS = 0.2
"""A block that knows fewer of its pixels tells nothing."""

Numbers = NDArray[np.float64]
Lag = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A part of a picture and which of its pixels are known (1 or 0), float32 [row, col].

    noise: at most the standard deviation of its noise, as far as it differs from pixel to pixel.
    """

    values: Float32s
    known: Float32s
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A lag (rows, cols) in pixels: pixel (r, c) of the second lies on (r + lag row, c + lag col) of the first.

    covariance: [2, 2], infinite where nothing tells; correlation: of what varies within blocks, -1 ... 1; agreeing:
    share of the contrast that lies in blocks which fit on their own; bent_px: by how much the blocks at the far ends
    want other lags than the middle, and bent_sigmas, how surely they do.
    """

    lag: Lag
    covariance: Numbers
    correlation: float
    agreeing: float
    bent_px: float
    bent_sigmas: float
    n_pixels: float


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """What the blocks tell, all [n block]: index [n, 2], place [n, 2] in -1 ... 1, pixels, variances and covariance of
    the two, pull [n, 2] and stiffness [n, 2, 2] of the lag."""

    index: NDArray[np.intp]
    place: Numbers
    pixels: Numbers
    first: Numbers
    second: Numbers
    both: Numbers
    pull: Numbers
    stiffness: Numbers


def align(first: Picture, second: Picture, lag: Lag, side: int) -> Alignment:
    """Refine a lag that is right within about a pixel; blocks of about side x side pixels."""
    blocks, ease = _blocks(first, second, lag, side), 1.0
    for _ in range(MOST_STEPS):
        step = _step(blocks, ease)
        lag, before = (lag[0] + step[0], lag[1] + step[1]), blocks
        blocks = _blocks(first, second, lag, side)
        if np.abs(step).max() > _TELLING_PX:
            ease = _eased(before, blocks, step)
        if np.abs(step).max() < _CLOSE_PX:
            break
    if ease == 1 and _correlation(blocks) < _NEARLY_NO_NOISE:
        ease = _eased(blocks, _blocks(first, second, (lag[0] + _PROBE[0], lag[1] + _PROBE[1]), side), _PROBE)
    return _judged(blocks, lag, ease, math.sqrt(first.noise * second.noise))


def _eased(before: _Blocks, after: _Blocks, step: Numbers) -> float:
    """How much of the stiffness is real: noise makes slopes too, which do not move with the picture."""
    told = float(step @ (before.pull.sum(axis=0) - after.pull.sum(axis=0)))
    return min(1.0, max(_LEAST_EASE, told / max(float(step @ before.stiffness.sum(axis=0) @ step), 1e-30)))


def _blocks(first: Picture, second: Picture, lag: Lag, side: int) -> _Blocks:
    sums = block_sums(first.values, first.known, second.values, second.known, lag, side)
    index = np.indices(sums.shape[:2]).reshape(2, -1).T
    place = 2 * (index + 0.5) / np.array(sums.shape[:2]) - 1
    flat = sums.reshape(-1, *sums.shape[2:])
    pixels = flat[:, 0, 0]
    enough = pixels > max(_LEAST_PIXELS * pixels.max(initial=0), 12.0)
    return _of_sums(flat[enough], index[enough], place[enough])


def _of_sums(sums: Numbers, index: NDArray[np.intp], place: Numbers) -> _Blocks:
    """Each block with a brightness and contrast of its own: what is left is what a shift explains."""
    n = sums[:, 0, 0]
    spread = sums[:, 1:, 1:] - sums[:, 1:, :1] * sums[:, :1, 1:] / n[:, None, None]
    first, second, both = spread[:, 0, 0], spread[:, 1, 1], spread[:, 0, 1]
    room = np.maximum(second, 1e-9 * n)
    gain = np.maximum(both, 0) / room
    left = spread - spread[:, :, 1:2] * spread[:, 1:2, :] / room[:, None, None]
    weight = n / np.maximum(left[:, 0, 0], 1e-9 * n)
    weight = weight / (1 + weight / (4 * np.median(weight))) if len(weight) else weight
    pull = -(weight * gain)[:, None] * left[:, 0, 2:]
    stiffness = (weight * gain**2)[:, None, None] * left[:, 2:, 2:]
    return _Blocks(index, place, n, first, second, both, pull, stiffness)


def _step(blocks: _Blocks, ease: float) -> Numbers:
    """One step of Gauss-Newton, a pixel at most."""
    stiffness = blocks.stiffness.sum(axis=0) * ease
    stiffness = stiffness + 1e-6 * np.trace(stiffness) * np.eye(2) + 1e-30 * np.eye(2)
    return np.linalg.solve(stiffness, blocks.pull.sum(axis=0)).clip(-1, 1)


def _judged(blocks: _Blocks, lag: Lag, ease: float, noise: float) -> Alignment:
    bent_px, bent_sigmas = _bent(blocks)
    covariance, n_pixels = _covariance(blocks) / ease**2, float(blocks.pixels.sum())
    agreeing = _agreeing(blocks, noise)
    return Alignment(lag, covariance, _correlation(blocks), agreeing, bent_px / ease, bent_sigmas, n_pixels)


def _correlation(blocks: _Blocks) -> float:
    energy = float(blocks.first.sum() * blocks.second.sum())
    return float(blocks.both.sum()) / energy**0.5 if energy > 0 else 0.0


def _covariance(blocks: _Blocks) -> Numbers:
    """Of the lag, from how differently the blocks pull."""
    n, stiffness = len(blocks.pixels), blocks.stiffness.sum(axis=0)
    if n < 4 or not np.linalg.det(stiffness) > 1e-12 * np.trace(stiffness) ** 2:
        return np.full((2, 2), np.inf)
    spread = blocks.pull.T @ blocks.pull * (n / (n - 2))
    inverse = np.linalg.inv(stiffness)
    wider = np.maximum(np.diag(_spread_of_lines(blocks)), np.diag(_spread_of_areas(blocks)))
    more = np.sqrt(np.maximum(1.0, wider / np.maximum(np.diag(spread), 1e-30)))
    return np.asarray(inverse @ (spread * np.outer(more, more)) @ inverse, np.float64)


def _spread_of_lines(blocks: _Blocks) -> Numbers:
    """The spread of the pulls when blocks in a row and those in a column may err together, as along a straight edge.

    Source: A. C. Cameron, J. B. Gelbach, D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238.
    """
    rows, cols = (_spread_of(blocks.pull, blocks.index[:, axis]) for axis in (0, 1))
    return rows + cols - blocks.pull.T @ blocks.pull


def _spread_of_areas(blocks: _Blocks) -> Numbers:
    """The same for blocks that are near each other: parts of a picture that come from different frames."""
    return np.maximum(*(_spread_of(blocks.pull, _numbered(blocks.index // side)) for side in _AREAS))


def _numbered(index: NDArray[np.intp]) -> NDArray[np.intp]:
    return index[:, 0] * (1 + index[:, 1].max()) + index[:, 1]


def _spread_of(pull: Numbers, cluster: NDArray[np.intp]) -> Numbers:
    _, of_cluster = np.unique(cluster, return_inverse=True)
    sums = np.stack([np.bincount(of_cluster, one) for one in pull.T], axis=1)
    return np.asarray(sums.T @ sums * (len(sums) / max(1, len(sums) - 1)), np.float64)


def _agreeing(blocks: _Blocks, noise: float) -> float:
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


def _bent(blocks: _Blocks) -> tuple[float, float]:
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
