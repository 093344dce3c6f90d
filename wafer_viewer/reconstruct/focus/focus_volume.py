"""Focus volume of a block, and the rows of focus that its kernels accumulate.

A block of a stack is processed frame by frame and row by row. A measure makes a row of levels of each frame, log2 of
the focus as 16 bits; the levels of the block are its focus volume (eq. 5). The best frame of each pixel (eq. 6), the
clipped frames and the coarse focus volume of the field are updated while the row is in the L1 cache.
"""

from __future__ import annotations

import operator
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress, silent
from wafer_viewer.numerics.jit import (
    Float32s,
    Greys,
    Int,
    Real,
    UInt16s,
    aligned,
    inline_kernel,
    inlined_part,
    lean_kernel,
    lean_part,
    prefetch,
)
from wafer_viewer.reconstruct.frame_blocks import StackSource
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

COARSE_PX = 4
"""The coarse focus volume has one level for 4 x 4 pixels."""


class Volume(NamedTuple):
    """Focus volume of a block: levels [k, row, col]; best level, its frame, clipped frame count [row, col].

    coarse: [k, row / 4, col / 4], levels averaged over 4 x 4 pixels, or empty where they are not requested.
    """

    levels: UInt16s
    best: UInt16s
    peak: UInt16s
    clipped: UInt16s
    coarse: UInt16s


class FocusCurves(NamedTuple):
    """Focus volume of a block, levels [k, row, col], with the best level of each pixel and its frame."""

    levels: UInt16s
    best: UInt16s
    peak: UInt16s

    @classmethod
    def make(cls, n_frames: int, shape: tuple[int, int]) -> FocusCurves:
        """Allocate the curves of `shape` pixels."""
        return cls(*(aligned(s, np.uint16) for s in ((n_frames, *shape), shape, shape)))

    def cut(self, n_rows: int) -> FocusCurves:
        """Return the same memory for fewer rows."""
        return FocusCurves(fewer_rows(self.levels, n_rows), self.best[:n_rows], self.peak[:n_rows])


class LevelTable(NamedTuple):
    """Logarithms of the levels of a measure: a level has `bits` fraction bits, and they add fractions[bits] to log2."""

    bits: int
    fractions: Float32s

    @classmethod
    def of(cls, fractions: Float32s) -> LevelTable:
        """Return the table of levels whose lower bits `fractions` decodes."""
        return cls(fractions.size.bit_length() - 1, fractions)

    def logarithms(self, levels: UInt16s) -> Float32s:
        """Return log2 of the focus of an array of levels."""
        whole, fraction = np.divmod(levels, self.fractions.size)
        return whole + self.fractions[fraction]


@inline_kernel
def log2_of(level: Int, table: LevelTable) -> Real:
    """Return log2 of the focus of a level."""
    q = np.int64(level)
    return np.float32(q >> table.bits) + table.fractions[q & (table.fractions.size - 1)]


def fewer_rows(volume: NDArray[Any], n_rows: int) -> NDArray[Any]:
    """Return a volume [k, row, col] of fewer rows that shares the memory of `volume`."""
    n_frames, _, cols = volume.shape
    return volume.reshape(-1)[: n_frames * n_rows * cols].reshape(n_frames, n_rows, cols)


USUAL_CAMERA = CameraNoise(gain_counts=0.02, floor_counts2=0.2)
"""8 bits over 13 000 electrons, and noise of a third of a grey level."""


@dataclass(frozen=True, slots=True)
class Focusing:
    """Parameters of a focus measure: window and, where it uses them, camera noise and high-pass along z."""

    window: int
    camera: CameraNoise = USUAL_CAMERA
    lag: int = 0


@dataclass(frozen=True, slots=True)
class FocusKernels:
    """Implementation of a focus measure: the functions that the search needs.

    table: contribution of the lower bits of a level to log2, the other bits being the integer part. make_rows:
    allocates the work rows of the kernel, for a number of columns, a window and a dtype. fill: measures the frames of a
    source into a volume.
    """

    table: Callable[[np.dtype[Any]], Float32s]
    make_rows: Callable[[int, int, np.dtype[Any]], Any]
    fill: Callable[[StackSource, Focusing, Any, Volume], None]


def fraction_table(bits: int) -> Float32s:
    """Return the table of levels that are logarithms with `bits` fraction bits."""
    return (np.arange(2**bits) / 2**bits).astype(np.float32)


@inlined_part
def empty(volume: Volume) -> None:
    """Initialise a volume for the first frame."""
    volume.best[:] = 0
    volume.peak[:] = 0
    volume.clipped[:] = 0


@inlined_part
def take_grey(source: StackSource, k: Int, y: Int, margin: Int, cols: Int, grey: Greys) -> None:
    """Read row y of the block in frame k, extended by `margin` pixels at both ends; image borders repeat."""
    images = source.images
    source_row = min(max(source.top + y, 0), images.shape[1] - 1)
    row = images[source.slots[k], source_row]
    prefetch(images[source.slots[min(k + 1, source.slots.size - 1)], source_row])
    first = source.left - margin
    begin, end = max(0, -first), min(cols + 2 * margin, row.size - first)
    inner, ours = row[begin + first :], grey[begin:]
    for x in range(end - begin):
        ours[x] = inner[x]
    for x in range(begin):
        grey[x] = row[0]
    for x in range(end, cols + 2 * margin):
        grey[x] = row[row.size - 1]


@lean_part
def count_clipped(grey: Greys, clipped_counts: Int, clipped: UInt16s) -> None:
    """Count the clipped pixels of a grey row."""
    limit = np.uint16(min(clipped_counts, 65535))
    for x in range(clipped.size):
        clipped[x] = np.uint16(clipped[x] + np.uint16(np.uint16(grey[x]) >= limit))


@inlined_part
def accumulate_row(volume: Volume, k: Int, y: Int) -> None:
    """Update best level, peak frame and coarse volume from row y of frame k, whose levels are in the volume."""
    levels = volume.levels[k]
    last = levels.shape[0] - 1
    note(levels[y], np.uint16(k), volume.best[y], volume.peak[y])
    if volume.coarse.size and (y % COARSE_PX == COARSE_PX - 1 or y == last):
        top = y - y % COARSE_PX
        _coarsen(
            levels[top],
            levels[min(top + 1, last)],
            levels[min(top + 2, last)],
            levels[min(top + 3, last)],
            volume.coarse[k, y // COARSE_PX],
        )


@lean_kernel
def accumulate_levels(source: StackSource, volume: Volume) -> None:
    """Compute all of a volume from its levels and the greys of their frames."""
    empty(volume)
    n_rows, cols = volume.best.shape
    for k in range(volume.levels.shape[0]):
        image = source.images[source.slots[k]]
        for y in range(n_rows):
            grey = image[source.top + y, source.left : source.left + cols]
            count_clipped(grey, source.clipped_counts, volume.clipped[y])
            accumulate_row(volume, k, y)


@lean_part
def note(level: UInt16s, k: Int, best: UInt16s, peak: UInt16s) -> None:
    """Update the best level of a row and its frame."""
    for x in range(level.size):
        q, old, peak_now = level[x], best[x], peak[x]
        best[x] = q if q > old else old
        peak[x] = k if q > old else peak_now


@lean_part
def _coarsen(a: UInt16s, b: UInt16s, c: UInt16s, d: UInt16s, coarse: UInt16s) -> None:
    """Average 4 x 4 levels, rounded; where the row ends early its last level repeats."""
    i = np.int32
    n_full = a.size // COARSE_PX
    for x in range(n_full):
        total = i(8)
        for j in range(COARSE_PX):
            index = COARSE_PX * x + j
            total = i(total + i(i(i(a[index]) + i(b[index])) + i(i(c[index]) + i(d[index]))))
        coarse[x] = total >> 4
    if n_full < coarse.size:
        total = i(8)
        for j in range(COARSE_PX):
            index = min(COARSE_PX * n_full + j, a.size - 1)
            total = i(total + i(i(i(a[index]) + i(b[index])) + i(i(c[index]) + i(d[index]))))
        coarse[n_full] = total >> 4


Share = TypeVar("Share")


def cores() -> int:
    """Return the number of cores available to this process; the total number where affinity is unavailable."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_threads(
    work: Callable[[Iterator[Share]], None], parts: Iterable[Share], threads: int | None, progress: Progress = silent
) -> None:
    """Process all parts on `threads` threads (default: all cores), each of which takes the next part when it is free.

    progress receives the finished fraction, on the calling thread; an exception raised by it or by `work` ends all.
    """
    all_parts = list(parts)
    todo = iter(all_parts)
    n_others = min(threads or cores(), len(all_parts)) - 1
    with ThreadPoolExecutor(max(1, n_others)) as pool:
        others = [pool.submit(work, todo) for _ in range(n_others)]
        try:
            work(_told(todo, len(all_parts), progress))
        finally:
            deque(todo, maxlen=0)  # after an exception the others finish their part and find no more
    for other in others:
        other.result()


def _told(todo: Iterator[Share], n_parts: int, progress: Progress) -> Iterator[Share]:
    """Yield the parts to do, and report the share of those that are taken once each is done."""
    for part in todo:
        yield part
        progress(1 - operator.length_hint(todo) / n_parts)


def rows_in(part: slice) -> int:
    """Return the number of rows of a part."""
    return part.stop - part.start
