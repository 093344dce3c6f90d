"""Probability that each height is right, from all its evidence, in place of a limit for every kind of evidence.

The gates accept heights that may vouch for others. A height itself counts where its probability is large enough, by a
sum of small trees over scores: of its focus curve, of its neighbours among the accepted heights, and of their light.
All scores are in units of the noise, of the optics or of the window, so that they mean the same on other samples. The
trees lie in `evidence.json`, with the scenes by which they were trained: tests/bench/train_evidence.py.

A symmetric tree asks the same questions on every path: its leaf is the number whose bits are the answers. A question
speaks against a pixel by as much as the other answer would raise the sum.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import LEAST_IN_SHORT_STACKS, LEAST_PROBABILITY
from wafer_viewer.numerics.filters.regions import component_sizes
from wafer_viewer.numerics.filters.sliding_filters import mean, repeated
from wafer_viewer.numerics.jit import Bools, Float32s, Int, Int32s, Real, UInt8s, lean_kernel, lean_part
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, on_threads
from wafer_viewer.reconstruct.frame_blocks import row_parts
from wafer_viewer.reconstruct.gates.edge_sides import cell_means, cell_medians
from wafer_viewer.reconstruct.gates.evidence_scores import CELL_SCORES, FAR_CELLS, PIXEL_SCORES, Scores, compare_cells
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES

LEAST_FAR, LEAST_AROUND = 0.2, 0.1
"""Share of pixels with a probable height in `FAR_CELLS`, and in a square of four windows, below which none counts.

Where hardly anything is probable, what is may be the same error of a whole scene: tests/bench/train_evidence.py. On
bare ground a few heights that are wrong together are the only ones far and wide.
"""
_ROWS = 32
"""Rows of pixels that are weighed together; a multiple of `COARSE_PX`."""


class Evidence(NamedTuple):
    """Probability that a height is right, float32, and code of `Origin`, uint8: measured, or what speaks against it."""

    probability: NDArray[np.float32]
    origin: NDArray[np.uint8]


class Trees(NamedTuple):
    """Symmetric trees: scores and limits [tree, question], leaves [tree, leaf], and their sum before any of them."""

    scores: UInt8s
    limits: Float32s
    leaves: Float32s
    bias: float


@lru_cache(maxsize=1)
def trained_trees() -> Trees:
    """Return the trees of the package."""
    found = json.loads(Path(__file__).with_name("evidence.json").read_text())
    return trees_of(found)


def auto_least_probability(n_frames: int) -> float:
    """Return the least probability of a height that counts in a stack of so many frames."""
    return LEAST_PROBABILITY if n_frames >= LEAST_FRAMES else LEAST_IN_SHORT_STACKS


def trees_of(found: dict[str, list[list[float]]]) -> Trees:
    """Return the trees of a record, whose questions name the scores."""
    number = {name: n for n, name in enumerate((*PIXEL_SCORES, *CELL_SCORES))}
    scores = np.array([[number[str(name)] for name in tree] for tree in found["scores"]], np.uint8)
    limits, leaves = (np.array(found[name], np.float32) for name in ("limits", "leaves"))
    return Trees(scores, limits, leaves, float(np.asarray(found["bias"]).item()))


def weigh(
    scores: Scores,
    least_probability: float,
    trees: Trees,
    origin: NDArray[np.uint8],
    forbidden: NDArray[np.bool_],
    threads: int | None = None,
    untested: tuple[Origin, ...] = (),
) -> Evidence:
    """Return the probability of each pixel, and its origin: measured from the least probability on.

    origin: by the gates; a less probable pixel that passed them gets the reason that speaks most against it, an
    ambiguous peak in place of an `untested` one. A forbidden pixel has probability 0 and remains as it is.
    """
    shape, n_cells = origin.shape, scores.cells.shape[2]
    found = Evidence(np.zeros(shape, np.float32), origin.copy())
    reasons = (*PIXEL_SCORES.values(), *CELL_SCORES.values())
    of_score = np.array([Origin.AMBIGUOUS if one in untested else one for one in reasons], np.uint8)
    asks_pixels = (trees.scores < len(PIXEL_SCORES)).any(axis=1)
    order = np.argsort(asks_pixels, kind="stable")
    sums = (trees.scores[order], trees.limits[order], trees.leaves[order])
    n_coarse = int(np.count_nonzero(~asks_pixels))
    limits = np.array([trees.bias, least_probability], np.float32)

    def weigh_rows(todo: Iterator[slice]) -> None:
        of_cells = (
            np.empty(n_cells, np.int32),
            np.empty((len(scores.cells), n_cells), np.float32),
            np.empty(n_cells, np.int32),
            np.empty(n_cells, np.float32),
            np.empty((len(order) - n_coarse, n_cells), np.uint8),
            np.empty((n_cells, max(Origin) + 1), np.float32),
            np.empty(n_cells, np.bool_),
        )
        n = COARSE_PX * n_cells
        of_pixels = (
            np.empty((len(PIXEL_SCORES), n), np.float32),
            np.empty(n, np.int32),
            np.empty(n, np.float32),
            np.empty(max(Origin) + 1, np.float32),
        )
        for rows in todo:
            cells = scores.cells[:, rows.start // COARSE_PX : -(-rows.stop // COARSE_PX)]
            out = found.probability[rows], found.origin[rows]
            pixels = scores.of_pixels(rows)
            _weigh_rows(pixels, cells, forbidden[rows], sums, n_coarse, limits, of_score, of_cells, of_pixels, out)

    on_threads(weigh_rows, row_parts(shape[0], _ROWS), threads)
    return found


@lean_kernel
def _weigh_rows(
    pixels: Float32s,
    cells: Float32s,
    forbidden: Bools,
    trees: tuple[UInt8s, Float32s, Float32s],
    n_coarse: Int,
    limits: Float32s,
    of_score: UInt8s,
    of_cells: tuple[Int32s, Float32s, Int32s, Float32s, UInt8s, Float32s, Bools],
    of_pixels: tuple[Float32s, Int32s, Float32s, Float32s],
    out: tuple[Float32s, UInt8s],
) -> None:
    """Write the probability of some rows of pixels, and their origin by it, where they are not forbidden.

    The first `n_coarse` trees ask of cells only and are added once for each; the others look up what their questions
    about cells are answered. limits: the sum before any tree, and the least probability. Work memory, of the cells with
    a pixel that is not forbidden: their columns, scores, leaves, sums, answers, evidence against them, and whether that
    is known; of the pixels of these cells: scores, leaves, sums, and evidence against one of them.
    """
    asked, at, leaves = trees
    col, here, cell_leaf, cell_total, answers, against_cells, is_known = of_cells
    score, leaf, total, against = of_pixels
    probability, reason = out
    n, n_rows, n_cols = pixels.shape
    bias, least = limits[0], limits[1]
    for i in range(cells.shape[1]):
        top, stop = COARSE_PX * i, min(COARSE_PX * (i + 1), n_rows)
        count = _open_cells(forbidden[top:stop], col)
        for k in range(cells.shape[0]):
            _pick_cells(cells[k, i], col, here[k, :count])
        cell_total[:] = bias
        is_known[:] = False
        for t in range(asked.shape[0]):
            cell_leaf[:] = 0
            for bit in range(asked.shape[1]):
                if asked[t, bit] >= n:
                    _add_answers(here[asked[t, bit] - n, :count], at[t, bit], np.int32(1 << bit), cell_leaf)
            if t < n_coarse:
                _add_leaves(leaves[t], cell_leaf, cell_total[:count])
            else:
                _copy(cell_leaf[:count], answers[t - n_coarse])
        for y in range(top, stop):
            for k in range(n):
                _pick_pixels(pixels[k, y], col[:count], score[k])
            _spread(cell_total[:count], total)
            for t in range(n_coarse, asked.shape[0]):
                _spread(answers[t - n_coarse, :count], leaf)
                for bit in range(asked.shape[1]):
                    if asked[t, bit] < n:
                        _add_answers(score[asked[t, bit], : COARSE_PX * count], at[t, bit], np.int32(1 << bit), leaf)
                _add_leaves(leaves[t], leaf, total[: COARSE_PX * count])
            for k in range(COARSE_PX * count):
                j = k // COARSE_PX
                x = COARSE_PX * col[j] + k % COARSE_PX
                if x < n_cols and not forbidden[y, x]:
                    probable = np.float32(1) / (np.float32(1) + np.exp(-total[k]))
                    probability[y, x] = probable
                    if probable >= least:
                        reason[y, x] = Origin.MEASURED
                    elif reason[y, x] == Origin.MEASURED:
                        if not is_known[j]:
                            is_known[j] = True
                            against_cells[j] = 0
                            _speak_against(here, j, score, k, 0, n_coarse, trees, of_score, against_cells[j])
                        against[:] = -np.inf
                        for s in range(of_score.size):
                            against[of_score[s]] = against_cells[j, of_score[s]]
                        _speak_against(here, j, score, k, n_coarse, asked.shape[0], trees, of_score, against)
                        reason[y, x] = against.argmax()


@lean_part
def _open_cells(forbidden: Bools, col: Int32s) -> Int:
    """Write the columns of the cells with a pixel that is not forbidden, and return how many there are."""
    count = 0
    for j in range(col.size):
        is_open = False
        for y in range(forbidden.shape[0]):
            for x in range(COARSE_PX * j, min(COARSE_PX * (j + 1), forbidden.shape[1])):
                is_open |= not forbidden[y, x]
        if is_open:
            col[count] = j
            count += 1
    return count


@lean_part
def _pick_cells(cells: Float32s, col: Int32s, out: Float32s) -> None:
    for j in range(out.size):
        out[j] = cells[col[j]]


@lean_part
def _pick_pixels(pixels: Float32s, col: Int32s, out: Float32s) -> None:
    """Take the pixels of cells; beyond the frame the last one repeats."""
    last = pixels.size - 1
    for j in range(col.size):
        for r in range(COARSE_PX):
            out[COARSE_PX * j + r] = pixels[min(COARSE_PX * col[j] + r, last)]


@lean_part
def _copy(values: Any, out: Any) -> None:
    for x in range(values.size):
        out[x] = values[x]


@lean_part
def _spread(cells: Any, out: Any) -> None:
    for j in range(cells.size):
        for r in range(COARSE_PX):
            out[COARSE_PX * j + r] = cells[j]


@lean_part
def _add_answers(score: Float32s, limit: Real, power: Int, leaf: Int32s) -> None:
    for x in range(score.size):
        leaf[x] += power if score[x] > limit else np.int32(0)


@lean_part
def _add_leaves(leaves: Float32s, leaf: Int32s, out: Float32s) -> None:
    for x in range(out.size):
        out[x] += leaves[leaf[x]]


@lean_part
def _speak_against(
    cells: Float32s,
    j: Int,
    pixels: Float32s,
    x: Int,
    first: Int,
    stop: Int,
    trees: tuple[UInt8s, Float32s, Float32s],
    of_score: UInt8s,
    against: Float32s,
) -> None:
    """Add what other answers would raise the sum by to the reasons of their scores, of some trees."""
    asked, at, leaves = trees
    n = pixels.shape[0]
    for t in range(first, stop):
        leaf = 0
        for bit in range(asked.shape[1]):
            k = asked[t, bit]
            leaf += (1 << bit) if (pixels[k, x] if k < n else cells[k - n, j]) > at[t, bit] else 0
        for bit in range(asked.shape[1]):
            against[of_score[asked[t, bit]]] += leaves[t, leaf ^ (1 << bit)] - leaves[t, leaf]


def alone(probable: NDArray[np.bool_], window: int) -> NDArray[np.bool_]:
    """Return a mask of the pixels with too few probable heights around them, within four windows or far.

    At the border of the frame these squares lie inside, so that as many heights are asked for as elsewhere. Those that
    are refused support no others.
    """
    shape = probable.shape
    share = cell_means(probable.view(np.uint8), (-(-shape[0] // COARSE_PX), -(-shape[1] // COARSE_PX)))
    while True:
        few = (_mean_inside(share, window | 1) < LEAST_AROUND) | (_mean_inside(share, FAR_CELLS) < LEAST_FAR)
        few &= share > 0
        if not few.any():
            return repeated(share == 0, COARSE_PX, shape)
        share[few] = 0


def _mean_inside(cells: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """Return the sliding mean of size x size cells, that of the nearest square within the frame at its border."""
    reach = (min(size, *cells.shape) - 1) // 2
    if reach <= 0:
        return cells
    inside = mean(cells, 2 * reach + 1)[reach:-reach, reach:-reach]
    return np.pad(inside, reach, mode="edge")


def warm_up() -> None:
    """Compile the kernels, or load the cached compilation, on a few pixels."""
    cells = np.zeros((2, 2), np.float32)
    component_sizes(cells, np.float32(1))
    cell_medians(np.zeros((8, 8), np.float32), np.ones((8, 8), np.bool_), np.ones((2, 2), np.bool_))
    compare_cells(
        cells, cells, cells, (1, 1, 1), 1.0, 1.0, 1.0, cells.repeat(3, axis=0), np.zeros((5, 2, 2), np.float32)
    )
    scores = Scores(
        lambda _: np.zeros((len(PIXEL_SCORES), 8, 8), np.float32), np.zeros((len(CELL_SCORES), 2, 2), np.float32)
    )
    weigh(scores, 0.5, trained_trees(), np.zeros((8, 8), np.uint8), np.zeros((8, 8), np.bool_), threads=1)
