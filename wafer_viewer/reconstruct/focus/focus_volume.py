"""Common kernels of the focus measures: reading grey rows, and accumulating rows of levels.

A block of a stack is processed frame by frame and row by row. A measure makes a row of levels of each frame, log2 of
the focus as 16 bits; the levels of the block are its focus volume (eq. 5). The best frame of each pixel (eq. 6), the
clipped frames and the coarse focus volume of the field are updated while the row is in the L1 cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.array_types import Greys, Int64s, UInt16s, Whole
from wafer_viewer.numerics.jit import inlined_part, lean_part
from wafer_viewer.numerics.prefetch import prefetch

COARSE_PX = 4
"""The coarse focus volume has one level for 4 x 4 pixels."""


class StackSource(NamedTuple):
    """Pixels of a block: images[slots[k]] is frame k, and the block begins at row top, column left.

    images: [n, row, col], contiguous and read-only, so that all stacks have the same type in the kernels.
    clipped_counts: grey from which a pixel is clipped.
    """

    images: Greys
    slots: Int64s
    top: int
    left: int
    clipped_counts: int

    @classmethod
    def of(cls, images: Greys, slots: Int64s, top: int, left: int, clipped_counts: int) -> StackSource:
        """Return a source of contiguous images."""
        view = np.asarray(images).view()
        view.flags.writeable = False
        return cls(view, slots, top, left, clipped_counts)


class Volume(NamedTuple):
    """Focus volume of a block: levels [k, row, col]; best level, its frame, clipped frame count [row, col].

    coarse: [k, row / 4, col / 4], levels averaged over 4 x 4 pixels, or empty where they are not requested.
    """

    levels: UInt16s
    best: UInt16s
    peak: UInt16s
    clipped: UInt16s
    coarse: UInt16s


@inlined_part
def empty(volume: Volume) -> None:
    """Initialise a volume for the first frame."""
    volume.best[:] = 0
    volume.peak[:] = 0
    volume.clipped[:] = 0


@inlined_part
def take_grey(source: StackSource, k: Whole, y: Whole, margin: Whole, cols: Whole, grey: Greys) -> None:
    """Read row y of the block in frame k, extended by `margin` pixels at both ends; image borders repeat."""
    images = source.images
    at = min(max(source.top + y, 0), images.shape[1] - 1)
    row = images[source.slots[k], at]
    prefetch(images[source.slots[min(k + 1, source.slots.size - 1)], at])
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
def count_clipped(grey: Greys, clipped_counts: Whole, clipped: UInt16s) -> None:
    """Count the clipped pixels of a grey row."""
    limit = np.uint16(min(clipped_counts, 65535))
    for x in range(clipped.size):
        clipped[x] = np.uint16(clipped[x] + np.uint16(np.uint16(grey[x]) >= limit))


@inlined_part
def accumulate_row(volume: Volume, k: Whole, y: Whole) -> None:
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


@lean_part
def note(level: UInt16s, k: Whole, best: UInt16s, peak: UInt16s) -> None:
    """Update the best level of a row and its frame."""
    for x in range(level.size):
        q, old, at = level[x], best[x], peak[x]
        best[x] = q if q > old else old
        peak[x] = k if q > old else at


@lean_part
def _coarsen(a: UInt16s, b: UInt16s, c: UInt16s, d: UInt16s, coarse: UInt16s) -> None:
    """Average 4 x 4 levels, rounded; where the row ends early its last level repeats."""
    i = np.int32
    whole = a.size // COARSE_PX
    for x in range(whole):
        total = i(8)
        for j in range(COARSE_PX):
            at = COARSE_PX * x + j
            total = i(total + i(i(i(a[at]) + i(b[at])) + i(i(c[at]) + i(d[at]))))
        coarse[x] = total >> 4
    if whole < coarse.size:
        total = i(8)
        for j in range(COARSE_PX):
            at = min(COARSE_PX * whole + j, a.size - 1)
            total = i(total + i(i(i(a[at]) + i(b[at])) + i(i(c[at]) + i(d[at]))))
        coarse[whole] = total >> 4
