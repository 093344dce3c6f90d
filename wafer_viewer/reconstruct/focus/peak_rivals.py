"""Other tops of the focus curve of each pixel: rivals far from its peak, and dips between the peak and a top nearby.

Both are found in one pass along the frames, row by row, while the levels are in cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.intrinsics import prefetch
from wafer_viewer.numerics.jit import Float32s, Float64s, Int, UInt16s, aligned, inlined_part, lean_part
from wafer_viewer.reconstruct.focus.focus_volume import FocusCurves

_AHEAD = 4
"""Prefetch distance in frames."""
_LEAST_APART = 3
"""Smallest distance of two tops in frames: the peak between tops two frames apart is off by a frame at most."""
_MIDDLE_SHARE = np.float32(1 / 6)
"""Largest distance of a height from the middle of two tops, as a share of theirs, that is not on either of them."""


class Rivals(NamedTuple):
    """Levels of the focus curves of a row away from their peaks, uint16 [col].

    rival, least: highest other top and lowest level. dip_top, dip_low: both ends of the deepest dip between the peak
    and a top nearer than a rival, and dip_at, the frame of its top. turn, turn_at: highest or lowest level so far
    between the peak and a frame near it, and its frame.
    """

    rival: UInt16s
    least: UInt16s
    dip_top: UInt16s
    dip_low: UInt16s
    dip_at: UInt16s
    turn: UInt16s
    turn_at: UInt16s

    @classmethod
    def make(cls, cols: int) -> Rivals:
        """Allocate rows of `cols` pixels."""
        return cls(*(aligned((cols,), np.uint16) for _ in range(7)))


@inlined_part
def find_rivals(curves: FocusCurves, y: Int, gap: Int, octave: Int, found: Rivals) -> None:
    """Find the highest top of row y at least `gap` frames from its peaks, the lowest level, and dips nearer by.

    Without a rival the lowest level is used. octave: difference of two levels whose focus differs by a factor of two.
    """
    levels, best, peak = curves.levels, curves.best[y], curves.peak[y]
    last, rival, least = levels.shape[0] - 1, found.rival, found.least
    rival[:] = 0
    least[:] = 65535
    for row in (found.dip_top, found.dip_low, found.dip_at, found.turn, found.turn_at):
        row[:] = 0
    first, end = last + 1, -1
    for x in range(peak.size):
        first, end = min(first, np.int64(peak[x]) - gap), max(end, np.int64(peak[x]) + gap)
    for k in range(last + 1):
        prefetch(levels[min(k + _AHEAD, last), y])
        before, level, after = levels[max(k - 1, 0), y], levels[k, y], levels[min(k + 1, last), y]
        _rival_row(before, level, after, k, gap, peak, rival, least)
        if first < k < end:
            _dip_row(level, best, k, gap, octave, peak, found)
    for x in range(rival.size):
        a, b = rival[x], least[x]
        rival[x] = a if a > b else b


@lean_part
def _rival_row(
    before: UInt16s,
    level: UInt16s,
    after: UInt16s,
    k: Int,
    gap: Int,
    peak: UInt16s,
    rival: UInt16s,
    least: UInt16s,
) -> None:
    u = np.uint16
    first, width = u(k - gap + 1), u(2 * gap - 1)
    for x in range(level.size):
        q, old, low = level[x], rival[x], least[x]
        far = u(peak[x] - first) >= width
        higher = far & (q >= before[x]) & (q >= after[x]) & (q > old)
        rival[x] = q if higher else old
        least[x] = q if q < low else low


@lean_part
def _dip_row(level: UInt16s, best: UInt16s, k: Int, gap: Int, octave: Int, peak: UInt16s, found: Rivals) -> None:
    """Follow the curves nearer to their peaks than a rival: how far they fall again before, and rise again behind.

    What is not half as high as the peak is no top: it may be noise on a flank. Tops nearer to each other than half the
    gap, a focus width, or than `_LEAST_APART` frames misplace a height by no more than is usual.
    """
    turn, turn_at, dip_top, dip_low, dip_at = found.turn, found.turn_at, found.dip_top, found.dip_low, found.dip_at
    u = np.uint16
    first, width, here, half = u(k - gap + 1), u(2 * gap - 1), u(k), u(octave)
    apart = u(max(_LEAST_APART, (gap + 1) // 2))
    for x in range(level.size):
        q, old, top, low, at = level[x], turn[x], dip_top[x], dip_low[x], peak[x]
        near, behind = u(at - first) < width, at < here
        lower, higher = min(q, old), max(q, old)
        above, below = q if behind else higher, lower if behind else q
        is_apart = u(here - at if behind else at - here) >= apart
        counts = near & (is_apart | (not behind)) & (u(best[x] - above) < half)
        deeper = counts & (u(above - below) > u(top - low))
        kept = near & (is_apart | behind | (at == here))
        extreme = lower if behind else higher
        dip_top[x], dip_low[x] = above if deeper else top, below if deeper else low
        dip_at[x] = (here if behind else turn_at[x]) if deeper else dip_at[x]
        turn_at[x] = here if kept & (extreme == q) else turn_at[x]
        turn[x] = extreme if kept else old


@lean_part
def accept_middles(z_um: Float64s, peak: UInt16s, dip_at: UInt16s, found_um: Float32s, dip: Float32s) -> None:
    """Take the dip of a row of heights for none where a wide window found the middle of both tops."""
    for x in range(found_um.size):
        one_um, other_um = z_um[peak[x]], z_um[dip_at[x]]
        off_um = abs(found_um[x] - np.float32(0.5 * (one_um + other_um)))
        is_middle = off_um < _MIDDLE_SHARE * abs(np.float32(other_um - one_um))
        dip[x] = np.float32(0) if is_middle else dip[x]
