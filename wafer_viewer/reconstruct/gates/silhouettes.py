"""Silhouettes of walls: contrasts of neighbouring pixels that persist through many frames.

With b = ln(mean of 6 x 6 pixels + a dark grey), D is the largest change of b over 6 pixels along a row or a column. A
pattern in one plane has such a contrast only within the depth of focus about that plane; the outline of a die next to a
bright trench has it in all frames from the foot of its wall to the top. A long silhouette that persists through many
frames is therefore a wall, and can be detected before depth is known; coarse texture persists too, in patches. Maps
have half the resolution: pixel (i, j) stands for the 2 x 2 pixels from (2 i, 2 j).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from wafer_viewer.numerics.jit import Float32s, Greys, Int, Int32s, Real, UInt16s, lean_kernel, lean_part, quick_log2
from wafer_viewer.reconstruct.focus.focus_volume import on_threads, take_grey
from wafer_viewer.reconstruct.frame_blocks import Frames, StackSource, StackWindow, developed, stripes

SILHOUETTE_MARGIN_PX = 6
"""Reach of the map beyond its pixels."""

DARK_SHARE_OF_WHITE = 6 / 255
"""Offset added to the grey, as a fraction of white; differences below it are noise."""

STANDING_CONTRAST = 0.47
"""Minimum D of a silhouette: bright is 1.6 times dark."""

_STRIPE_ROWS = 64
"""Rows of a field that one task processes."""
_SILHOUETTE_REACH = 2
"""Reach of the contrast beyond a pixel, in pixels of half resolution."""
_PIXELS = 36
"""Number of pixels of the mean, 6 x 6."""
_LN_2 = np.float32(math.log(2))
"""Natural logarithm of 2."""


class SilhouetteRows(NamedTuple):
    """Half-resolution work rows of the kernel, one set for each thread."""

    grey: Greys
    pairs: Int32s
    bins: Int32s
    columns: Int32s
    log: Float32s
    change: Float32s

    @classmethod
    def make(cls, cols: int, dtype: np.dtype[Any]) -> SilhouetteRows:
        """Allocate rows for blocks `cols` wide."""
        half = half_size(cols) + 2 * _SILHOUETTE_REACH
        return cls(
            grey=np.zeros((2, 2 * half + 4), dtype),
            pairs=np.zeros(2 * half + 4, np.int32),
            bins=np.zeros((3, half + 2), np.int32),
            columns=np.zeros(half + 2, np.int32),
            log=np.zeros((5, half), np.float32),
            change=np.zeros(half_size(cols), np.float32),
        )


class Silhouette(NamedTuple):
    """Silhouettes of a field or of a part of it, all [row / 2, col / 2].

    contrast: the largest D of all frames, natural logarithm; frame: index of that frame; standing: number of frames in
    which D reaches the minimum of a silhouette.
    """

    contrast: Float32s
    frame: UInt16s
    standing: UInt16s

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Silhouette:
        """Return an empty silhouette map for a field of `shape` pixels."""
        half = half_size(shape[0]), half_size(shape[1])
        return cls(np.zeros(half, np.float32), np.zeros(half, np.uint16), np.zeros(half, np.uint16))

    def rows(self, part: slice) -> Silhouette:
        """Return the part for a range of field rows, as views; the first row must be even."""
        half = slice(part.start // 2, half_size(part.stop))
        return Silhouette(self.contrast[half], self.frame[half], self.standing[half])


def half_size(pixels: int) -> int:
    """Return the size of the silhouette map for a number of rows or columns."""
    return (pixels + 1) // 2


def silhouette_of(frames: Frames, threads: int | None = None) -> Silhouette:
    """Return the silhouettes of an entire field; threads: all cores if omitted."""
    found = Silhouette.empty(frames.shape)
    dark_counts = DARK_SHARE_OF_WHITE * frames.clipped_counts

    def add_parts(todo: Iterator[StackWindow]) -> None:
        rows = SilhouetteRows.make(frames.shape[1], frames.dtype)
        for part, block in developed(frames, todo, SILHOUETTE_MARGIN_PX):
            silhouette_block(block, 0, 1, dark_counts, rows, found.rows(part.rows))

    on_threads(add_parts, stripes(frames.shape, _STRIPE_ROWS), threads)
    return found


@lean_kernel
def silhouette_block(
    source: StackSource, first: Int, every: Int, dark_counts: Real, rows: SilhouetteRows, out: Silhouette
) -> None:
    """Accumulate the silhouettes of a block in `out`, which is empty initially; every: 1 for all frames, 2 for half.

    first: index in the stack of the first frame of the source. Other frames may be added by another call, in any order:
    of two equal contrasts that of the lower frame counts.

    The block must begin at an even row and column of the field, so that the maps of blocks fit together.
    """
    margin, cols = SILHOUETTE_MARGIN_PX, 2 * out.contrast.shape[1]
    for k in range(0, source.slots.size, every):
        for r in range(out.contrast.shape[0] + margin):
            for n in range(2):
                take_grey(source, k, 2 * r - margin + n, margin, cols, rows.grey[n])
            _bin(rows.grey[0], rows.grey[1], rows.pairs, rows.bins[r % 3])
            if r >= 2:
                _log_row(rows.bins, np.float32(dark_counts), rows.columns, rows.log[r % 5])
            if r >= 6:
                y = r - 6
                _contrast_row(rows.log, r, rows.change)
                _note(rows.change, first + k, every, out.contrast[y], out.frame[y], out.standing[y])


@lean_part
def _bin(upper: Greys, lower: Greys, pairs: Int32s, bins: Int32s) -> None:
    """Sum 2 x 2 pixels of two rows."""
    i = np.int32
    for x in range(pairs.size):
        pairs[x] = i(i(upper[x]) + i(lower[x]))
    for x in range(bins.size):
        bins[x] = i(pairs[2 * x] + pairs[2 * x + 1])


@lean_part
def _log_row(bins: Int32s, dark_counts: Real, columns: Int32s, log: Float32s) -> None:
    """Compute ln(mean of 6 x 6 pixels + dark)."""
    i = np.int32
    above, centre, below = bins[0], bins[1], bins[2]
    for x in range(columns.size):
        columns[x] = i(i(above[x] + centre[x]) + below[x])
    part, one, two = np.float32(1 / _PIXELS), columns[1:], columns[2:]
    for x in range(log.size):
        total = i(i(columns[x] + one[x]) + two[x])
        log[x] = _LN_2 * quick_log2(np.float32(total) * part + dark_counts)


@lean_part
def _contrast_row(log: Float32s, r: Int, change: Float32s) -> None:
    """Compute the largest change of the logarithm over three half-resolution pixels around one, along x and y."""
    a, b, centre, c, d = (
        log[(r - 4) % 5, 2:],
        log[(r - 3) % 5, 2:],
        log[(r - 2) % 5],
        log[(r - 1) % 5, 2:],
        log[r % 5, 2:],
    )
    left_2, left, right, right_2 = centre, centre[1:], centre[3:], centre[4:]
    for x in range(change.size):
        along = max(abs(right_2[x] - left[x]), abs(right[x] - left_2[x]))
        down = max(abs(d[x] - b[x]), abs(c[x] - a[x]))
        change[x] = max(along, down)


@lean_part
def _note(change: Float32s, k: Int, every: Int, contrast: Float32s, frame: UInt16s, standing: UInt16s) -> None:
    u, least = np.uint16, np.float32(STANDING_CONTRAST)
    centre, step = u(k), u(every)
    for x in range(change.size):
        d, most, at = change[x], contrast[x], frame[x]
        higher = (d > most) | ((d == most) & (centre < at))
        contrast[x] = d if higher else most
        frame[x] = centre if higher else at
        standing[x] = u(standing[x] + (step if d >= least else u(0)))
