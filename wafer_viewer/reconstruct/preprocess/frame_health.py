"""Detection of flashes and dead frames, which differ from their neighbours as no change of focus does.

Defocus only spreads light, so the mean grey of a frame changes slowly along z, and lamp flicker scatters all frames
alike. A frame is excluded when it differs from both sides and far exceeds that scatter. A step of the light, a
gradient, or a peak of brightness with the focus is not a fault.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Bracket, Image

LEAST_FRAMES = 6
"""Minimum number of frames to estimate the usual brightness variation."""
LEAST_RATIO = 1.4
"""Minimum grey ratio between a flash or dead frame and both sides."""
LEAST_SIGMAS = 8.0
"""Minimum difference in standard deviations of the frames' own scatter, in logarithms."""
LEAST_RATIO_AT_END = 4.0
"""Minimum grey ratio for the first and the last frame, which have one side only."""
LEAST_CLIPPED = 0.5
"""Minimum fraction of pixels that a flash clips in addition to the frames on both sides."""
DEAD_SHARE = 0.25
"""A blank frame has less than this fraction of the lowest focus energy of the others."""
LEAST_JUMP = 2.0
"""Minimum ratio of the change into and out of a flash to the change before and after."""
SHARPER = 1.3
"""A frame with this much more contrast than both sides is in focus, however bright."""
MOST_FAULTY = 0.2
"""Maximum fraction of faulty frames; beyond it the light is unsteady and no frame can serve as reference."""

_SIDE = 3
_ROWS = 10
_DARK_SHARE_OF_WHITE = 6 / 255
_LEAST_VARIANCE = 0.1

Stats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FrameStats:
    """Statistics of each frame, [k]: mean grey, clipped fraction, and focus energy (mean squared gradient)."""

    grey: Stats
    clipped: Stats
    energy: Stats

    @classmethod
    def of(cls, images: Image, slots: NDArray[np.intp], clipped_counts: int) -> FrameStats:
        """Measure the frames `slots` on a few rows each."""
        rows = slice(None, None, max(1, images.shape[1] // _ROWS))
        found = [_stats(images[slot, rows], clipped_counts) for slot in slots]
        return cls(*np.array(found, np.float64).T)


def faulty_frames(
    exposures: Sequence[Bracket], slots: NDArray[np.intp], white_counts: int, clipped_counts: int
) -> dict[int, str]:
    """Find the flashes and dead frames of a stack.

    Parameters
    ----------
    exposures : Sequence[Bracket]
        All exposures of the slots; a slot is faulty when it is in one of them.
    slots : ndarray of int, [k]
        The slots in the order of z.
    white_counts, clipped_counts : int
        White of the camera, and the grey from which a pixel is clipped.

    Returns
    -------
    dict[int, str]
        What is wrong with a slot, by slot; empty where more than a fifth of the frames would be.
    """
    if len(slots) < LEAST_FRAMES:
        return {}
    found: dict[int, str] = {}
    for one in exposures:
        stats = FrameStats.of(one.images, slots, clipped_counts)
        found |= {int(slots[k]): why for k, why in _faults(stats, white_counts)}
    return found if len(found) <= MOST_FAULTY * len(slots) else {}


def _stats(rows: Image, clipped_counts: int) -> tuple[float, float, float]:
    slope = np.diff(rows.astype(np.float32), axis=1)
    return float(rows.mean()), float(np.mean(rows >= clipped_counts)), float(np.vdot(slope, slope)) / max(1, slope.size)


def _faults(stats: FrameStats, white_counts: int) -> Iterator[tuple[int, str]]:
    """Yield the index along z and a description of each faulty frame."""
    dark = _DARK_SHARE_OF_WHITE * white_counts
    log = np.log(stats.grey + dark)
    below, above = _sides(log)
    off = _nearer(log - below, log - above)
    scatter = 1.4826 * float(np.median(np.abs(off[1:-1])))
    limit = np.full(len(log), max(np.log(LEAST_RATIO), LEAST_SIGMAS * scatter))
    limit[[0, -1]] = np.maximum(limit[[0, -1]], np.log(LEAST_RATIO_AT_END))
    contrast = np.log(stats.energy + _LEAST_VARIANCE) - 2 * log
    sharper = _nearer(*(contrast - side for side in _sides(contrast))) > np.log(SHARPER)
    flash = (off > limit) & ~sharper
    clips = _nearer(*(stats.clipped - side for side in _sides(stats.clipped))) > LEAST_CLIPPED
    black = (off < -limit) & (log < np.percentile(log, 10) - np.log(LEAST_RATIO))
    lit = _abrupt(flash | clips | black, log)
    blank = _is_blank(stats.energy)
    sides = np.exp((below + above) / 2) - dark
    for k in np.flatnonzero(lit | blank).tolist():
        greys = f"mean grey {stats.grey[k]:.3g} against {sides[k]:.3g} of {white_counts}"
        if not lit[k]:
            yield k, "shows nothing, unlike the frames beside it"
        elif black[k]:
            yield k, f"is far darker than the frames beside it ({greys})"
        else:
            yield k, f"is far brighter than the frames beside it ({greys}, {stats.clipped[k]:.0%} clipped)"


def _abrupt(flagged: NDArray[np.bool_], log: Stats) -> NDArray[np.bool_]:
    """Select the runs of flagged frames that begin and end with a jump, unlike the top of a smooth curve."""
    step = np.abs(np.diff(log))
    kept = flagged.copy()
    for run in np.split(np.flatnonzero(flagged), np.flatnonzero(np.diff(np.flatnonzero(flagged)) > 1) + 1):
        if not run.size:
            continue
        first, last = run[0], run[-1]
        begins = first < 2 or step[first - 1] > LEAST_JUMP * step[first - 2]
        ends = last > len(log) - 3 or step[last] > LEAST_JUMP * step[last + 1]
        kept[run] = begins and ends
    return kept


def _sides(values: Stats) -> tuple[Stats, Stats]:
    """Return the medians of the frames before and after each; at an end both are those of the one side."""
    windows = sliding_window_view(np.pad(values, _SIDE, mode="edge"), _SIDE)
    medians = np.median(windows, axis=1)
    before, after = medians[: len(values)].copy(), medians[_SIDE + 1 :].copy()
    before[0], after[-1] = after[0], before[-1]
    return before, after


def _nearer(one: Stats, other: Stats) -> Stats:
    """Return the smaller of two differences where they have the same sign, else 0."""
    least = np.where(np.abs(one) < np.abs(other), one, other)
    return np.where(one * other > 0, least, 0.0)


def _is_blank(energy: Stats) -> NDArray[np.bool_]:
    """Return a mask of a frame with far less focus energy than any other, even out of focus."""
    least, next_least = np.partition(energy, 1)[:2]
    if least >= DEAD_SHARE * next_least or next_least <= _LEAST_VARIANCE:
        return np.zeros(len(energy), np.bool_)
    return energy == least
