"""Detection and replacement of defective sensor pixels: hot and dead pixels, columns and rows.

The optics spread every point over more than a pixel, and defocus spreads it further. A pixel that is brighter (or
darker) than its neighbours two pixels away on both sides, in every frame from one end of the sweep to the other, is
therefore a sensor defect. Left uncorrected, a hot column is sharpest where its neighbours are darkest: a false ridge.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

LEAST_FRAMES = 6
"""In fewer frames a sharp detail of the sample may look the same in all of them."""
MOST_FLAWED = 0.02
"""Maximum fraction of defects; with more, the detections are features of the sample."""
LEAST_SHARE_OF_WHITE = 0.016
"""Minimum difference between a defect and its neighbours, as a fraction of white: 4 of 255."""
LEAST_NOISE = 6.0
"""Minimum difference between a defect and its neighbours, in standard deviations of the noise."""

_FRAMES = 14
_APART = 2
_REACH = 4
_SAMPLED_ROWS = 16

Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Flaws:
    """Defective pixels sorted by row, with two sound neighbours each: [flaw, (row, col)] arrays."""

    at: Places
    one: Places
    other: Places

    def __len__(self) -> int:
        return len(self.at)

    def part(self, rows: slice, cols: slice) -> Flaws:
        """Return the defects in the pixels [rows, cols] with both neighbours inside, relative to that origin."""
        begin, end = np.array([rows.start, cols.start]), np.array([rows.stop, cols.stop])
        inside = np.all([((p >= begin) & (p < end)).all(axis=1) for p in (self.at, self.one, self.other)], axis=0)
        return Flaws(self.at[inside] - begin, self.one[inside] - begin, self.other[inside] - begin)

    def touch(self, rows: slice) -> bool:
        """Return whether any defect lies in these rows."""
        first, last = self._within(rows)
        return first < last

    def mend(self, part: Image, images: Image, slots: Places, rows: slice, cols: slice) -> None:
        """Replace the defects in `part` [k, row, col], which holds the pixels [rows, cols] of the images `slots`.

        Each becomes the mean of its sound neighbours, which are read from the images because a part may end at a
        defect.
        """
        first, last = self._within(rows)
        inside = (self.at[first:last, 1] >= cols.start) & (self.at[first:last, 1] < cols.stop)
        if not inside.any():
            return
        at, one, other = (of_all[first:last][inside].T for of_all in (self.at, self.one, self.other))
        k, pixels = slots[:, None], np.asarray(images)
        sum_of_two = pixels[k, one[0], one[1]].astype(np.int32) + pixels[k, other[0], other[1]]
        part[:, at[0] - rows.start, at[1] - cols.start] = (sum_of_two + 1) // 2

    def _within(self, rows: slice) -> tuple[int, int]:
        """Return the index of the first defect in these rows, and one past the last."""
        first, last = np.searchsorted(self.at[:, 0], (rows.start, rows.stop))
        return int(first), int(last)


def find_flaws(exposures: Iterable[Image], slots: NDArray[np.intp], white_counts: int) -> Flaws | None:
    """Return the defective pixels found in the frames `slots` of all exposures; None if there are none."""
    if len(slots) < LEAST_FRAMES:
        return None
    picked: NDArray[np.intp] = slots[np.unique(np.linspace(0, len(slots) - 1, _FRAMES).astype(int))]
    found = [_flawed(images, picked, white_counts) for images in exposures]
    shape = found[0].shape
    flawed = _whole_lines(np.logical_or.reduce(found))
    if not flawed.any() or flawed.mean() > MOST_FLAWED or min(shape) <= 2 * _REACH:
        return None
    return _with_neighbours(flawed)


def _whole_lines(flawed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Complete rows and columns of which half is defective, because texture hides weak defects in places."""
    lines = [flawed.mean(axis=axis, keepdims=True) >= 0.5 for axis in (0, 1)]
    return flawed | lines[0] | lines[1]


def _flawed(images: Image, slots: NDArray[np.intp], white_counts: int) -> NDArray[np.bool_]:
    """Return a mask of pixels that stand out in all frames, up or down, along the row or the column."""
    first, last = images[slots[0]], images[slots[-1]]
    least = _least_difference(first, white_counts)
    flawed = np.zeros(first.shape, bool)
    if min(first.shape) <= 2 * _REACH or least > white_counts // 2:
        return flawed
    for brighter in (True, False):
        for axis in (0, 1):
            at = np.argwhere(_stands_out(first, axis, brighter, least) & _stands_out(last, axis, brighter, least))
            for slot in slots[1:-1]:
                at = at[_stand_out_at(images[slot], at, axis, brighter, least)]
            flawed[tuple(at.T)] = True
    return flawed


def _least_difference(frame: Image, white_counts: int) -> int:
    rows = frame[:: max(1, len(frame) // _SAMPLED_ROWS)].astype(np.float32)
    noise = 1.4826 * float(np.median(np.abs(np.diff(rows, axis=1)))) / np.sqrt(2) if rows.shape[1] > 1 else 0.0
    return int(np.ceil(max(LEAST_SHARE_OF_WHITE * white_counts, LEAST_NOISE * noise)))


def _stands_out(frame: Image, axis: int, brighter: bool, least: int) -> NDArray[np.bool_]:
    """Return a mask of pixels beyond both neighbours two pixels away along the axis by more than `least`."""
    turned = frame if axis else frame.T
    ahead = turned[:, 2 * _APART :]
    behind, here = turned[:, : -2 * _APART], turned[:, _APART:-_APART]
    out = np.zeros(turned.shape, bool)
    inner = out[:, _APART:-_APART]
    if brighter:
        top = np.iinfo(frame.dtype).max - least
        np.greater(here, np.minimum(np.maximum(ahead, behind), top) + frame.dtype.type(least), out=inner)
    else:
        np.less(here, np.maximum(np.minimum(ahead, behind), least) - frame.dtype.type(least), out=inner)
    return out if axis else out.T


def _stand_out_at(frame: Image, at: Places, axis: int, brighter: bool, least: int) -> NDArray[np.bool_]:
    """Apply the test of `_stands_out` to selected pixels."""
    step = np.array([0, _APART] if axis else [_APART, 0])
    here, ahead, behind = (frame[tuple(p.T)].astype(np.int32) for p in (at, at + step, at - step))
    return here > np.maximum(ahead, behind) + least if brighter else here < np.minimum(ahead, behind) - least


def _with_neighbours(flawed: NDArray[np.bool_]) -> Flaws | None:
    """Return the defects with sound pixels on both sides within reach, along the row or else the column."""
    at = np.argwhere(flawed)
    one, other = at.copy(), at.copy()
    sound = np.zeros(len(at), bool)
    for step in ((0, 1), (1, 0)):
        for out, sign in ((one, -1), (other, 1)):
            todo = ~sound
            out[todo] = _nearest_sound(flawed, at[todo], sign * np.array(step))
        sound = ~flawed[tuple(one.T)] & ~flawed[tuple(other.T)]
    return Flaws(at[sound], one[sound], other[sound]) if sound.any() else None


def _nearest_sound(flawed: NDArray[np.bool_], at: Places, step: NDArray[np.intp]) -> Places:
    """Return the first sound pixel from each in steps, or the pixel itself if there is none within reach."""
    out = at.copy()
    for n in range(_REACH, 0, -1):
        there = at + n * step
        inside = ((there >= 0) & (there < flawed.shape)).all(axis=1)
        good = np.zeros(len(at), bool)
        good[inside] = ~flawed[tuple(there[inside].T)]
        out[good] = there[good]
    return out
