"""Faults of sensor and light: hot and dead pixels, flashes and dead frames.

The optics spread every point over more than a pixel, and defocus spreads it further. A pixel that is brighter (or
darker) than its neighbours two pixels away on both sides, in every frame from one end of the sweep to the other, is
therefore a sensor defect. Left uncorrected, a hot column is sharpest where its neighbours are darkest: a false ridge.

Defocus only spreads light, so the mean grey of a frame changes slowly along z, and lamp flicker scatters all frames
alike. A frame is excluded when it differs from both sides and far exceeds that scatter. A step of the light, a
gradient, or a peak of brightness with the focus is not a fault.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.row_sums import cell_sums, native_copy, slope_energies
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.frame_blocks import Correction, FramePixels

LEAST_FRAMES = 6
"""In fewer frames a sharp detail of the sample may look the same in all of them."""


@dataclass(frozen=True, slots=True)
class FlawParameters:
    """Sample of a stack and limits of a defective pixel.

    Parameters
    ----------
    frames : int
        Largest number of frames in which a defect must show.
    most_flawed : float
        Maximum fraction of defects; with more, the detections are features of the sample.
    least_share_of_white : float
        Minimum difference between a defect and its neighbours, as a fraction of white: 4 of 255.
    least_noise : float
        Minimum difference between a defect and its neighbours, in standard deviations of the noise.
    sampled_rows : int
        Approximate number of rows on which the noise is measured.
    apart_px : int, px
        Distance between a pixel and the neighbours that it is compared with.
    reach_px : int, px
        Largest distance of the sound neighbours that replace a defect.
    """

    frames: int = 14
    most_flawed: float = 0.02
    least_share_of_white: float = 0.016
    least_noise: float = 6.0
    sampled_rows: int = 16
    apart_px: int = 2
    reach_px: int = 4


FLAW = FlawParameters()
Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Flaws(Correction):
    """Defective pixels sorted by row, with two sound neighbours each: [flaw, (row, col)] arrays."""

    at: Places
    one: Places
    other: Places

    def __len__(self) -> int:
        return len(self.at)

    def changes(self, rows: slice) -> bool:
        """Return whether any defect lies in these rows."""
        first, last = self._within(rows)
        return first < last

    def applied(self, pixels: FramePixels) -> FramePixels:
        """Replace each defect by the mean of its sound neighbours, which are read as stored: they may lie beyond."""
        rows, cols = pixels.window
        first, last = self._within(rows)
        inside = (self.at[first:last, 1] >= cols.start) & (self.at[first:last, 1] < cols.stop)
        if not inside.any():
            return pixels
        at, one, other = (of_all[first:last][inside].T for of_all in (self.at, self.one, self.other))
        mended = [layer.copy() for layer in pixels.layers]
        for layer, stored in zip(mended, pixels.stored, strict=True):
            k, images = stored.slots[pixels.frames][:, None], np.asarray(stored.images)
            sum_of_two = images[k, one[0], one[1]].astype(np.int32) + images[k, other[0], other[1]]
            layer[:, at[0] - rows.start, at[1] - cols.start] = (sum_of_two + 1) // 2
        return pixels._replace(layers=tuple(mended))

    def _within(self, rows: slice) -> tuple[int, int]:
        """Return the index of the first defect in these rows, and one past the last."""
        first, last = np.searchsorted(self.at[:, 0], (rows.start, rows.stop))
        return int(first), int(last)


def find_flaws(exposures: Iterable[Image], slots: NDArray[np.intp], white_counts: int) -> Flaws | None:
    """Return the defective pixels found in the frames `slots` of all exposures; None if there are none."""
    if len(slots) < LEAST_FRAMES:
        return None
    picked: NDArray[np.intp] = slots[np.unique(np.linspace(0, len(slots) - 1, FLAW.frames).astype(int))]
    found = [_flawed(images, picked, white_counts) for images in exposures]
    shape = found[0].shape
    flawed = _complete_lines(np.logical_or.reduce(found))
    if not flawed.any() or flawed.mean() > FLAW.most_flawed or min(shape) <= 2 * FLAW.reach_px:
        return None
    return _with_neighbours(flawed)


def _complete_lines(flawed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Complete rows and columns of which half is defective, because texture hides weak defects in places."""
    lines = [flawed.mean(axis=axis, keepdims=True) >= 0.5 for axis in (0, 1)]
    return flawed | lines[0] | lines[1]


def _flawed(images: Image, slots: NDArray[np.intp], white_counts: int) -> NDArray[np.bool_]:
    """Return a mask of pixels that stand out in all frames, up or down, along the row or the column."""
    first = images[slots[0]]
    least = _least_difference(first, white_counts)
    flawed = np.zeros(first.shape, bool)
    if min(first.shape) <= 2 * FLAW.reach_px or least > white_counts // 2:
        return flawed
    for brighter in (True, False):
        for axis in (0, 1):
            suspect = _stands_out(first, axis, brighter, least)
            at = np.stack(np.divmod(np.flatnonzero(suspect), suspect.shape[1]), axis=1)
            for slot in slots[:0:-1]:
                at = at[_stand_out_at(images[slot], at, axis, brighter, least)]
            flawed[tuple(at.T)] = True
    return flawed


def _least_difference(frame: Image, white_counts: int) -> int:
    rows = frame[:: max(1, len(frame) // FLAW.sampled_rows)].astype(np.float32)
    noise = MAD_TO_SIGMA * float(np.median(np.abs(np.diff(rows, axis=1)))) / np.sqrt(2) if rows.shape[1] > 1 else 0.0
    return int(np.ceil(max(FLAW.least_share_of_white * white_counts, FLAW.least_noise * noise)))


def _stands_out(frame: Image, axis: int, brighter: bool, least: int) -> NDArray[np.bool_]:
    """Return a mask of pixels beyond both neighbours two pixels away along the axis by more than `least`."""
    apart = FLAW.apart_px
    before, at, after = slice(None, -2 * apart), slice(apart, -apart), slice(2 * apart, None)
    behind, pixel, ahead = (frame[:, part] if axis else frame[part] for part in (before, at, after))
    out = np.zeros(frame.shape, bool)
    inner = out[:, at] if axis else out[at]
    if brighter:
        top = np.iinfo(frame.dtype).max - least
        np.greater(pixel, np.minimum(np.maximum(ahead, behind), top) + frame.dtype.type(least), out=inner)
    else:
        np.less(pixel, np.maximum(np.minimum(ahead, behind), least) - frame.dtype.type(least), out=inner)
    return out


def _stand_out_at(frame: Image, at: Places, axis: int, brighter: bool, least: int) -> NDArray[np.bool_]:
    """Apply the test of `_stands_out` to selected pixels."""
    step = np.array([0, FLAW.apart_px] if axis else [FLAW.apart_px, 0])
    pixel, ahead, behind = (frame[tuple(p.T)].astype(np.int32) for p in (at, at + step, at - step))
    return pixel > np.maximum(ahead, behind) + least if brighter else pixel < np.minimum(ahead, behind) - least


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
    for n in range(FLAW.reach_px, 0, -1):
        target = at + n * step
        inside = ((target >= 0) & (target < flawed.shape)).all(axis=1)
        good = np.zeros(len(at), bool)
        good[inside] = ~flawed[tuple(target[inside].T)]
        out[good] = target[good]
    return out


@dataclass(frozen=True, slots=True)
class FaultParameters:
    """Limits of a flash and of a dead frame.

    Parameters
    ----------
    least_ratio : float
        Minimum grey ratio between a flash or dead frame and both sides.
    least_ratio_at_end : float
        Minimum grey ratio for the first and the last frame, which have one side only.
    least_sigmas : float
        Minimum difference in standard deviations of the frames' own scatter, in logarithms.
    least_clipped : float
        Minimum fraction of pixels that a flash clips in addition to the frames on both sides.
    dead_share : float
        A blank frame has less than this fraction of the lowest coarse energy of the other lit frames, or of the lower
        coarse contrast of both neighbours.
    coarse_px : int, px
        Pixels of a row that are averaged for the coarse energy: defocus and noise leave little of a finer pattern.
    least_jump : float
        Minimum ratio of the change into and out of a flash to the change before and after.
    sharper : float
        A frame with this much more contrast than both sides is in focus, however bright.
    most_faulty : float
        Maximum fraction of faulty frames; beyond it the light is unsteady and no frame can serve as reference.
    side : int
        Number of frames on each side whose median a frame is compared with.
    rows : int
        Approximate number of rows on which a frame is measured.
    dark_share_of_white : float
        Offset added to the mean grey before its logarithm, as a fraction of white.
    least_energy : float, counts^2
        Offset added to the focus energy before its logarithm; no frame counts as blank where the second lowest energy
        is not larger.
    """

    least_ratio: float = 1.4
    least_ratio_at_end: float = 4.0
    least_sigmas: float = 8.0
    least_clipped: float = 0.5
    dead_share: float = 0.25
    coarse_px: int = 8
    least_jump: float = 2.0
    sharper: float = 1.3
    most_faulty: float = 0.2
    side: int = 3
    rows: int = 10
    dark_share_of_white: float = 6 / 255
    least_energy: float = 0.1


FAULT = FaultParameters()
Stats = NDArray[np.float64]


class FaultStats(NamedTuple):
    """Mean grey, clipped fraction, focus energy and coarse energy of a frame."""

    grey: float
    clipped: float
    energy: float
    coarse: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameStats:
    """Statistics of each frame, [k]: mean grey, clipped fraction, and focus energy (mean squared gradient).

    coarse: the same energy of the means of several pixels of a row.
    """

    grey: Stats
    clipped: Stats
    energy: Stats
    coarse: Stats

    @classmethod
    def of(cls, found: Sequence[FaultStats]) -> FrameStats:
        """Join the statistics of all frames."""
        return cls(*np.array(found, np.float64).T)


def fault_stats(frame: Image, clipped_counts: int) -> FaultStats:
    """Measure a frame on a few rows."""
    rows, wide = native_copy(frame[:: max(1, len(frame) // FAULT.rows)]), FAULT.coarse_px
    grey, clipped = cell_sums(rows, (1, rows.shape[1]), clipped_counts)
    cells, _ = cell_sums(rows, (1, wide), clipped_counts)
    fine, coarse = int(slope_energies(rows, 1).sum()), float(np.sum(np.diff(cells / wide, axis=1) ** 2))
    slopes, coarse_slopes = (len(rows) * max(0, n - 1) for n in (rows.shape[1], cells.shape[1]))
    return FaultStats(
        float(grey.sum()) / rows.size,
        float(clipped.sum()) / rows.size,
        fine / max(1, slopes),
        coarse / max(1, coarse_slopes),
    )


def faulty_frames(
    exposures: Sequence[Sequence[FaultStats]], slots: NDArray[np.intp], white_counts: int
) -> dict[int, str]:
    """Find the flashes and dead frames of a stack.

    Parameters
    ----------
    exposures : Sequence[Sequence[FaultStats]]
        Statistics of the slots in all exposures; a slot is faulty when it is in one of them.
    slots : ndarray of int, [k]
        The slots in the order of z.
    white_counts : int
        White of the camera.

    Returns
    -------
    dict[int, str]
        What is wrong with a slot, by slot; empty where more than a fifth of the frames would be.
    """
    if len(slots) < LEAST_FRAMES:
        return {}
    found: dict[int, str] = {}
    for one in exposures:
        found |= {int(slots[k]): why for k, why in _faults(FrameStats.of(one), white_counts)}
    return found if len(found) <= FAULT.most_faulty * len(slots) else {}


def _faults(stats: FrameStats, white_counts: int) -> Iterator[tuple[int, str]]:
    """Yield the index along z and a description of each faulty frame."""
    dark = FAULT.dark_share_of_white * white_counts
    log = np.log(stats.grey + dark)
    below, above = _sides(log)
    off = _nearer(log - below, log - above)
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(off[1:-1])))
    limit = np.full(len(log), max(np.log(FAULT.least_ratio), FAULT.least_sigmas * scatter))
    limit[[0, -1]] = np.maximum(limit[[0, -1]], np.log(FAULT.least_ratio_at_end))
    contrast = np.log(stats.energy + FAULT.least_energy) - 2 * log
    sharper = _nearer(*(contrast - side for side in _sides(contrast))) > np.log(FAULT.sharper)
    flash = (off > limit) & ~sharper
    clips = _nearer(*(stats.clipped - side for side in _sides(stats.clipped))) > FAULT.least_clipped
    black = (off < -limit) & (log < np.percentile(log, 10) - np.log(FAULT.least_ratio))
    lit = _abrupt(flash | clips | black, log)
    blank, fine = (_is_blank(np.where(lit, np.inf, energy)) for energy in (stats.coarse, stats.energy))
    blank[[0, -1]] &= fine[[0, -1]]  # the frames furthest from focus
    blank |= _dips(np.where(lit, np.inf, (stats.coarse + FAULT.least_energy) / np.exp(2 * log)))
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
    remaining = flagged.copy()
    for run in np.split(np.flatnonzero(flagged), np.flatnonzero(np.diff(np.flatnonzero(flagged)) > 1) + 1):
        if not run.size:
            continue
        first, last = run[0], run[-1]
        begins = first < 2 or step[first - 1] > FAULT.least_jump * step[first - 2]
        ends = last > len(log) - 3 or step[last] > FAULT.least_jump * step[last + 1]
        remaining[run] = begins and ends
    return remaining


def _sides(values: Stats) -> tuple[Stats, Stats]:
    """Return the medians of the frames before and after each; at an end both are those of the one side."""
    windows = sliding_window_view(np.pad(values, FAULT.side, mode="edge"), FAULT.side)
    medians = np.median(windows, axis=1)
    before, after = medians[: len(values)].copy(), medians[FAULT.side + 1 :].copy()
    before[0], after[-1] = after[0], before[-1]
    return before, after


def _nearer(one: Stats, other: Stats) -> Stats:
    """Return the smaller of two differences where they have the same sign, else 0."""
    least = np.where(np.abs(one) < np.abs(other), one, other)
    return np.where(one * other > 0, least, 0.0)


def _dips(contrast: Stats) -> NDArray[np.bool_]:
    """Return a mask of the frames with far less coarse contrast than both neighbours, which a focus cannot have."""
    dips = np.zeros(len(contrast), np.bool_)
    least = np.minimum(contrast[:-2], contrast[2:])
    dips[1:-1] = (contrast[1:-1] < FAULT.dead_share * least) & np.isfinite(least)
    return dips


def _is_blank(energy: Stats) -> NDArray[np.bool_]:
    """Return a mask of a frame with far less energy than any other, even out of focus."""
    least, next_least = np.partition(energy, 1)[:2]
    if least >= FAULT.dead_share * next_least or next_least <= FAULT.least_energy:
        return np.zeros(len(energy), np.bool_)
    return energy == least
