"""Selection of the frames of a stack in order of z, and reading of corrected blocks for the kernels.

All corrections before the focus measure are applied here: defective pixels are replaced, exposures fused, and drifting
frames resampled, all while a block is read, so that no stack is ever completely in memory. Where no correction is
needed a block is a plain copy, and rows without a defect are not copied at all: nearly every camera has a defective
pixel, which must not slow down the rest of the field.

They need one or two frames alone, so that those of a live field are taken while its frames arrive.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.plan import MIN_FRAMES
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.grids.resampling import Taps, resampled
from wafer_viewer.reconstruct.preprocess.drift import Drift, TileMotions, drift_note, drift_of, measure_displacements
from wafer_viewer.reconstruct.preprocess.exposure_fusion import Fusion, fusion_of, z_taps
from wafer_viewer.reconstruct.preprocess.flicker import (
    Flicker,
    FlickerCells,
    divide_by_gain,
    fineness,
    flicker_cells,
    measure_flicker,
)
from wafer_viewer.reconstruct.preprocess.sensor_faults import FaultStats, Flaws, fault_stats, faulty_frames, find_flaws
from wafer_viewer.reconstruct.preprocess.torn_frames import SampledBands, relative_change, sampled_bands, torn_frames

# -------------------------------------------------------------------------------------------------------- frame samples


Key = TypeVar("Key")
Sample = TypeVar("Sample")


class FrameSamples:
    """Measurements of the frames of one exposure, by slot; made on demand and kept.

    clipped_counts: grey from which a pixel is clipped; motions: of frames without corrections.
    """

    def __init__(self, clipped_counts: int) -> None:
        self.clipped_counts = clipped_counts
        self._stats: dict[int, FaultStats] = {}
        self._bands: dict[int, SampledBands] = {}
        self._cells: dict[int, FlickerCells] = {}
        self._changes: dict[tuple[int, int], NDArray[np.float32]] = {}
        self.motions = TileMotions()

    def take(self, slot: int, frame: Image) -> None:
        """Make all measurements of a frame, and those of it and the frames near it that were taken before."""
        self.stats(slot, frame)
        self.cells(slot, frame)
        if self.bands(slot, frame).grey.size:
            for near in (slot - 2, slot - 1, slot + 1, slot + 2):
                if near in self._bands:
                    self.change(slot, near)

    def stats(self, slot: int, frame: Image) -> FaultStats:
        """Return grey, clipped fraction and focus energy of a frame."""
        return _kept(self._stats, slot, lambda: fault_stats(frame, self.clipped_counts))

    def bands(self, slot: int, frame: Image) -> SampledBands:
        """Return a sample of each band of rows of a frame."""
        return _kept(self._bands, slot, lambda: sampled_bands(frame))

    def change(self, one: int, other: int) -> NDArray[np.float32]:
        """Return how much each band differs between two frames whose bands are sampled, [band]."""
        pair = min(one, other), max(one, other)
        return _kept(self._changes, pair, lambda: relative_change(self._bands[pair[0]], self._bands[pair[1]]))

    def cells(self, slot: int, frame: Image) -> FlickerCells:
        """Return the cells of a frame."""
        return _kept(self._cells, slot, lambda: flicker_cells(frame, self.clipped_counts))


def _kept(known: dict[Key, Sample], key: Key, measure: Callable[[], Sample]) -> Sample:
    if key not in known:
        known[key] = measure()
    return known[key]


# --------------------------------------------------------------------------------------------------------------- frames


CLIPPED_SHARE_OF_WHITE = 0.98
"""Fraction of white from which a pixel counts as clipped: 250 of 255."""

_SAMPLED_ROWS = 24
"""Approximate number of rows of a frame in which its highest grey is searched for."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFactors:
    """Factors of the frames that remove flicker, by slot; scale: the corrected counts per count of the camera."""

    factors: NDArray[np.float32]
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames in use: images[index] are at z_um, which rises; pixels are clipped from clipped_counts on.

    pixel_um: on the sample; depth_of_field_um: of the objective, 0 if unknown; fusion, flaws, flicker and drift:
    corrections applied when pixels are read; flicker_rest: standard deviation of what is left of the flicker, as a
    fraction; notes: findings, a sentence each.
    """

    images: Image
    index: slice | NDArray[np.intp]
    z_um: NDArray[np.float64]
    clipped_counts: int
    pixel_um: float = 1.0
    depth_of_field_um: float = 0.0
    fusion: Fusion | None = None
    flaws: Flaws | None = None
    drift: Drift | None = None
    flicker: FrameFactors | None = None
    flicker_rest: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def n_frames(self) -> int:
        """Number of frames in use."""
        return len(self.z_um)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        return self.images.shape[1], self.images.shape[2]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of `read_block`, in native byte order."""
        rescaled = self.fusion is not None or self.flicker is not None
        return np.dtype(np.uint16) if rescaled else self.images.dtype.newbyteorder("=")

    @property
    def as_stored(self) -> bool:
        """True if the kernels can read the images in place: complete rows without corrections."""
        return self.steady and self.flaws is None and self._in_complete_rows

    @property
    def steady(self) -> bool:
        """True if each pixel is the same pixel of one image, or comes from its neighbours where it is defective."""
        return self.fusion is None and self.drift is None and self.flicker is None

    @property
    def scale(self) -> float:
        """Counts of `read_block` per count of the camera; 1 where exposures are fused."""
        return 1.0 if self.flicker is None else self.flicker.scale

    def as_stored_counts(self, grey: Image) -> Image:
        """Return greys of `read_block` in the counts and the type of the images, or of the fused exposures."""
        if self.flicker is None:
            return grey
        kind: Any = self.images.dtype.newbyteorder("=")
        counts: Any = np.rint(grey / np.float32(self.scale))
        return np.minimum(counts, np.iinfo(kind).max).astype(kind)

    @property
    def _in_complete_rows(self) -> bool:
        return self.images.flags.c_contiguous and self.images.dtype.isnative

    def ready(self, rows: slice, margin: int) -> bool:
        """Return whether the kernels can read these rows, and `margin` more on both sides, in place."""
        if not (self.steady and self._in_complete_rows):
            return False
        return self.flaws is None or not self.flaws.touch(slice(rows.start - margin, rows.stop + margin))

    @property
    def step_um(self) -> float:
        """Median distance between neighbouring frames."""
        return float(np.median(np.diff(self.z_um)))

    @property
    def slots(self) -> NDArray[np.intp]:
        """Slots of the stack that contain the frames."""
        return np.arange(len(self.images))[self.index]

    def covered(self, margin: int) -> NDArray[np.bool_]:
        """Return a mask of the pixels whose window of `margin` per side is covered by every frame, bool [row, col]."""
        if self.drift is None:
            return np.ones(self.shape, np.bool_)
        inside = [_shrunk(self.drift.covered(axis, length), margin, length) for axis, length in enumerate(self.shape)]
        mask = np.zeros(self.shape, np.bool_)
        mask[tuple(inside)] = True
        return mask

    def part(self, rows: slice, cols: slice) -> Frames:
        """Return the pixels [rows, cols] with the corrections found on the entire field; borders repeat beyond it."""
        at = rows.start, cols.start
        fusion, flaws, drift = self.fusion, self.flaws, self.drift
        if fusion is not None:
            fusion = dataclasses.replace(fusion, images=tuple(i[:, rows, cols] for i in fusion.images))
        if flaws is not None:
            flaws = flaws.part(rows, cols)
        if drift is not None:
            drift = dataclasses.replace(drift, corner=(drift.corner[0] + at[0], drift.corner[1] + at[1]))
        return dataclasses.replace(self, images=self.images[:, rows, cols], fusion=fusion, flaws=flaws, drift=drift)


def prepare(stack: FieldStack, recipe: Recipe = Recipe(), samples: FrameSamples | None = None) -> Frames:
    """Select valid frames in order of rising z and determine the pixel corrections.

    samples: measurements of frames of a single exposure that are known already. Absent slots, flashes, dead and torn
    frames are skipped. Raises ComputeError for pixels that are neither uint8 nor uint16, for a z that is not a number,
    for frames that share a z, for fewer than three frames, and for exposures that cannot be compared.
    """
    if stack.images.dtype.kind != "u" or stack.images.dtype.itemsize > 2:
        raise ComputeError(
            f"The images of field {stack.field.number} are {stack.images.dtype}: give 8- or 16-bit grey, unsigned."
        )
    present = np.flatnonzero(np.logical_and.reduce([one.present for one in stack.exposures]))
    z_um = np.asarray(stack.z_um, np.float64)[present]
    order = np.argsort(z_um, kind="stable")
    _check(stack, z_um[order])
    slots = present[order]
    white = _white_counts(stack, slots)
    clipped = clipped_from(white)
    of_exposures = [FrameSamples(clipped) for _ in stack.exposures]
    if samples is not None and samples.clipped_counts == clipped and not stack.brackets:
        of_exposures = [samples]
    slots, faults = _sound_slots(stack, slots, white, of_exposures)
    optics = stack.pixel_um, stack.optical_depth_um
    z_um, notes = np.asarray(stack.z_um, np.float64)[slots], (*_missing(stack, len(present)), *faults)
    frames = Frames(stack.images, as_slice(slots), z_um, clipped, *optics, notes=notes)
    flickers = [
        measure_flicker([of_frames.cells(int(slot), one.images[slot]) for slot in slots], white)
        for one, of_frames in zip(stack.exposures, of_exposures, strict=True)
    ]
    if recipe.flicker == "none":
        frames = dataclasses.replace(frames, flicker_rest=max(max(f.spread, f.rest) for f in flickers))
        flickers = []
    frames = _fused(stack, frames, white, flickers)
    frames = _without_flicker(frames, flickers, white)
    frames = dataclasses.replace(frames, flaws=find_flaws([e.images for e in stack.exposures], slots, white))
    if recipe.drift == "none":
        return frames
    return _with_drift_correction(stack, frames, of_exposures[0].motions if frames.as_stored else None)


def clipped_from(white_counts: int) -> int:
    """Return the grey value from which a pixel counts as clipped."""
    return int(CLIPPED_SHARE_OF_WHITE * white_counts) + (white_counts == 255)


def read_block(frames: Frames, rows: slice, cols: slice, margin: int, block: Image) -> None:
    """Copy a part of every frame into `block` [k, rows + 2 margin, cols + 2 margin].

    Beyond the frame its border pixels repeat, so that the kernels need no border handling.
    """
    n_rows, n_cols = frames.shape
    top, bottom = max(0, rows.start - margin), min(n_rows, rows.stop + margin)
    left, right = max(0, cols.start - margin), min(n_cols, cols.stop + margin)
    r, c = top - rows.start + margin, left - cols.start + margin
    r_end, c_end = r + bottom - top, c + right - left
    _develop(frames, slice(top, bottom), slice(left, right), block[:, r:r_end, c:c_end])
    block[:, r:r_end, :c] = block[:, r:r_end, c : c + 1]
    block[:, r:r_end, c_end:] = block[:, r:r_end, c_end - 1 : c_end]
    block[:, :r] = block[:, r : r + 1]
    block[:, r_end:] = block[:, r_end - 1 : r_end]


def _shrunk(covered: slice, margin: int, length: int) -> slice:
    """Shrink a range by a margin where it does not end with the frame."""
    first = covered.start + (margin if covered.start > 0 else 0)
    return slice(first, max(first, covered.stop - (margin if covered.stop < length else 0)))


def _develop(frames: Frames, rows: slice, cols: slice, out: Image) -> None:
    """Write the pixels [rows, cols] of every frame to `out`, with defects, exposures and drift corrected."""
    if frames.steady:
        out[:] = frames.images[frames.index, rows, cols]
        if frames.flaws is not None:
            frames.flaws.mend(out, frames.images, frames.slots, rows, cols)
        return
    for k, slot in enumerate(frames.slots):
        if frames.drift is None:
            out[k] = _pixels(frames, int(slot), rows, cols)
            continue
        down = Taps.at(frames.drift.places(k, 0, rows.start, rows.stop))
        across = Taps.at(frames.drift.places(k, 1, cols.start, cols.stop))
        window = [_within(taps.span, length) for taps, length in zip((down, across), frames.shape, strict=True)]
        part = _pixels(frames, int(slot), *window)
        out[k] = resampled(part, down.seen_from(window[0].start), across.seen_from(window[1].start))


def _within(span: tuple[int, int], length: int) -> slice:
    """Return the part of a span inside a frame, at least its border."""
    return slice(min(max(0, span[0]), length - 1), max(1, min(span[1], length)))


def _pixels(frames: Frames, slot: int, rows: slice, cols: slice) -> Image:
    """Return the pixels [rows, cols] of one slot, with defects replaced and exposures fused."""
    if frames.fusion is None:
        part = _sound(frames.flaws, frames.images, slot, rows, cols)
        return part if frames.flicker is None else _divided(part, frames.flicker.factors[slot])
    return frames.fusion.fused(slot, lambda images, at: _sound(frames.flaws, images, at, rows, cols))


def _sound(flaws: Flaws | None, images: Image, slot: int, rows: slice, cols: slice) -> Image:
    """Return the pixels [rows, cols] of one image, with defects replaced."""
    if flaws is None or not flaws.touch(rows):
        return images[slot, rows, cols]
    part = images[slot, rows, cols].copy()
    flaws.mend(part[None], images, np.array([slot]), rows, cols)
    return part


def _divided(part: Image, factor: np.float32) -> Image:
    out = np.empty(part.shape, np.uint16)
    divide_by_gain(part, factor, out)
    return out


def _without_flicker(frames: Frames, flickers: list[Flicker], white_counts: int) -> Frames:
    """Return frames that are divided by their gains when they are read, where these differ significantly."""
    if not flickers:
        return frames
    spread, rest = max(f.spread for f in flickers), max(f.rest for f in flickers)
    frames = dataclasses.replace(frames, flicker_rest=rest)
    if spread == 0:
        return frames
    note = (
        f"The light flickered by {spread:.1%} from frame to frame (standard deviation): it was divided out, to "
        f"{max(rest, 1e-4):.2%}. Let the lamp warm up, or trigger it with the camera."
    )
    frames = dataclasses.replace(frames, notes=(*frames.notes, note))
    if frames.fusion is not None:
        return frames
    scale, factors = fineness(flickers[0].gains, white_counts), np.ones(len(frames.images), np.float32)
    factors[frames.slots] = scale / flickers[0].gains
    clipped = round(scale * frames.clipped_counts)
    return dataclasses.replace(frames, flicker=FrameFactors(factors, scale), clipped_counts=clipped)


def _fused(stack: FieldStack, frames: Frames, white_counts: int, flickers: list[Flicker]) -> Frames:
    """Return frames that fuse all exposures, if there are several."""
    if not stack.brackets:
        return frames
    images = tuple(one.images for one in stack.exposures)
    times_us = tuple(one.exposure_us for one in stack.exposures)
    taps = [z_taps(own_um, stack.z_um, frames.slots) for own_um in stack.exposure_z_um or (stack.z_um,) * len(images)]
    fusion = fusion_of(images, frames.slots, times_us, white_counts, frames.clipped_counts, taps)
    if any(f.spread > 0 for f in flickers):
        fusion = fusion.with_flicker([f.gains for f in flickers], frames.slots)
    ratios = ", ".join(f"x{gain:.3g}" for gain in fusion.gains[1:])
    note = f"{len(images)} exposures were fused, the longer ones {ratios} as bright as the shortest."
    clipped = fusion.fused_clipped_counts
    return dataclasses.replace(frames, fusion=fusion, clipped_counts=clipped, notes=(*frames.notes, note))


def _with_drift_correction(stack: FieldStack, frames: Frames, motions: TileMotions | None) -> Frames:
    """Return frames with drift correction, if there is drift; motions: those of frames as they are stored."""

    def read(rows: slice, cols: slice) -> Image:
        if frames.ready(rows, 0):
            in_place: Any = np.asarray(frames.images)  # arithmetic on a memmap is slower
            return in_place[frames.index, rows, cols]
        block = np.empty((frames.n_frames, rows.stop - rows.start, cols.stop - cols.start), frames.dtype)
        read_block(frames, rows, cols, 0, block)
        return block

    sightings = measure_displacements(read, frames.shape, frames.slots, motions)
    drift = drift_of(sightings, frames.n_frames, frames.shape)
    if drift is None:
        return frames
    return dataclasses.replace(frames, drift=drift, notes=(*frames.notes, drift_note(drift, stack.pixel_um)))


def _missing(stack: FieldStack, n_frames: int) -> tuple[str, ...]:
    missing = stack.n_frames - n_frames
    return (f"{missing} of {stack.n_frames} frames of field {stack.field.number} are missing",) if missing else ()


def _sound_slots(
    stack: FieldStack, slots: NDArray[np.intp], white_counts: int, samples: Sequence[FrameSamples]
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Return the slots without flashes and dead frames, and a sentence for each of those."""
    exposures = list(zip(stack.exposures, samples, strict=True))
    stats = [[of_frames.stats(int(slot), one.images[slot]) for slot in slots] for one, of_frames in exposures]
    faults = faulty_frames(stats, slots, white_counts)
    for one, of_frames in exposures:
        tested = slots[~np.isin(slots, list(faults))]
        bands = [of_frames.bands(int(slot), one.images[slot]) for slot in tested]
        faults |= torn_frames(bands, tested, white_counts, of_frames.change)
    sound = slots[~np.isin(slots, list(faults))]
    if len(sound) < MIN_FRAMES:
        return slots, ()
    which = f"of {stack.n_frames} of field {stack.field.number}"
    return sound, tuple(f"Frame {slot + 1} {which} {faults[slot]}: left out." for slot in sorted(faults))


def _check(stack: FieldStack, z_um: NDArray[np.float64]) -> None:
    if len(z_um) < MIN_FRAMES:
        raise ComputeError(f"Field {stack.field.number} has {len(z_um)} frames: at least {MIN_FRAMES} are needed.")
    if not np.isfinite(z_um).all():
        raise ComputeError(f"Field {stack.field.number} has frames without a z position: give every frame its z.")
    repeated = np.flatnonzero(np.diff(z_um) <= 0)
    if repeated.size:
        raise ComputeError(
            f"Field {stack.field.number} has two frames at z = {z_um[repeated[0]]:.3f} um: "
            "give every frame a z of its own, or a z step over 0."
        )


def as_slice(index: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Convert evenly spaced indices to a slice, which reads a memory-mapped stack without a copy."""
    steps = np.unique(np.diff(index))
    if len(steps) != 1:
        return index
    step = int(steps[0])
    stop = int(index[-1]) + (1 if step > 0 else -1)
    return slice(int(index[0]), stop if stop >= 0 else None, step)


def _white_counts(stack: FieldStack, slots: NDArray[np.intp]) -> int:
    """Return the highest grey of the camera; 16-bit files often hold 10, 12 or 14 bits."""
    if stack.images.dtype.itemsize == 1:
        return 255
    step = max(1, stack.images.shape[1] // _SAMPLED_ROWS)
    most = max(int(one.images[slot, ::step].max()) for one in stack.exposures for slot in slots)
    bits = max(8, most.bit_length())
    return 2 ** (bits + bits % 2) - 1
