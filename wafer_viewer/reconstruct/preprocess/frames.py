"""Selection of the frames of a field in order of z, and of the corrections that their pixels need."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import ImageShading
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.plan import MIN_FRAMES
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.frame_blocks import Frames, StackWindow, StoredImages, read_part
from wafer_viewer.reconstruct.preprocess.drift import TileMotions, drift_note, drift_of, measure_displacements
from wafer_viewer.reconstruct.preprocess.exposure_fusion import fusion_of, z_taps
from wafer_viewer.reconstruct.preprocess.flicker import (
    Flicker,
    FlickerCells,
    FlickerGains,
    fineness,
    flicker_cells,
    measure_flicker,
)
from wafer_viewer.reconstruct.preprocess.sensor_faults import FaultStats, fault_stats, faulty_frames, find_flaws
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
    frames = dataclasses.replace(
        Frames.of(stack.images, slots, np.asarray(stack.z_um, np.float64)[slots], clipped),
        pixel_um=stack.pixel_um,
        depth_of_field_um=stack.optical_depth_um,
        shading=stack.shading,
        notes=(*_missing(stack, len(present)), *faults),
    )
    flickers = [
        measure_flicker([of_frames.cells(int(slot), one.images[slot]) for slot in slots], white)
        for one, of_frames in zip(stack.exposures, of_exposures, strict=True)
    ]
    flaws = find_flaws([e.images for e in stack.exposures], slots, white)
    frames = dataclasses.replace(frames, corrections=() if flaws is None else (flaws,))
    if recipe.flicker == "none":
        frames = dataclasses.replace(frames, flicker_rest=max(max(f.spread, f.rest) for f in flickers))
        flickers = []
    frames = _fused(stack, frames, white, flickers)
    frames = _without_flicker(stack, frames, flickers, white)
    if recipe.drift == "none":
        return frames
    return _with_drift_correction(frames, of_exposures[0].motions if frames.as_stored else None)


def clipped_from(white_counts: int) -> int:
    """Return the grey value from which a pixel counts as clipped."""
    return int(CLIPPED_SHARE_OF_WHITE * white_counts) + (white_counts == 255)


def _fused(stack: FieldStack, frames: Frames, white_counts: int, flickers: list[Flicker]) -> Frames:
    """Return frames that fuse all exposures, if there are several."""
    if not stack.brackets:
        return frames
    images, slots = [one.images for one in stack.exposures], frames.stored[0].slots
    times_us = tuple(one.exposure_us for one in stack.exposures)
    taps = [z_taps(own_um[slots], frames.z_um) for own_um in stack.exposure_z_um or (stack.z_um,) * len(images)]
    fusion = fusion_of(images, slots, times_us, white_counts, frames.clipped_counts, taps)
    if any(f.spread > 0 for f in flickers):
        fusion = fusion.with_flicker([f.gains for f in flickers])
    ratios = ", ".join(f"x{gain:.3g}" for gain in fusion.gains[1:])
    note = f"{len(images)} exposures were fused, the longer ones {ratios} as bright as the shortest."
    between = [(slots,) if of_one is None else (slots[of_one.lower], slots[of_one.upper]) for of_one in taps]
    shading = frames.shading
    return dataclasses.replace(
        frames,
        stored=tuple(StoredImages(images[n], of_layer) for n in fusion.order for of_layer in between[n]),
        corrections=(*frames.corrections, fusion),
        dtype=np.dtype(np.uint16),
        clipped_counts=fusion.fused_clipped_counts,
        shading=shading and ImageShading(shading.sensitivity, fusion.fused_counts(shading.dark_counts)),
        notes=(*frames.notes, note),
    )


def _without_flicker(stack: FieldStack, frames: Frames, flickers: list[Flicker], white_counts: int) -> Frames:
    """Return frames that are divided by their gains, where these differ significantly; fused ones are already."""
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
    if stack.brackets:
        return frames
    scale = fineness(flickers[0].gains, white_counts)
    return dataclasses.replace(
        frames,
        corrections=(*frames.corrections, FlickerGains((scale / flickers[0].gains).astype(np.float32))),
        dtype=np.dtype(np.uint16),
        scale=scale,
        clipped_counts=round(scale * frames.clipped_counts),
    )


def _with_drift_correction(frames: Frames, motions: TileMotions | None) -> Frames:
    """Return frames with drift correction, if there is drift; motions: those of frames as they are stored."""
    sightings = measure_displacements(
        lambda rows, cols: read_part(frames, StackWindow(rows, cols)), frames.shape, frames.stored[0].slots, motions
    )
    drift = drift_of(sightings, frames.n_frames, frames.shape)
    if drift is None:
        return frames
    return dataclasses.replace(
        frames,
        corrections=(*frames.corrections, drift),
        covered_by_all=(drift.covered(0), drift.covered(1)),
        notes=(*frames.notes, drift_note(drift, frames.pixel_um)),
    )


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


def _white_counts(stack: FieldStack, slots: NDArray[np.intp]) -> int:
    """Return the highest grey of the camera; 16-bit files often hold 10, 12 or 14 bits."""
    if stack.images.dtype.itemsize == 1:
        return 255
    step = max(1, stack.images.shape[1] // _SAMPLED_ROWS)
    most = max(int(one.images[slot, ::step].max()) for one in stack.exposures for slot in slots)
    bits = max(8, most.bit_length())
    return 2 ** (bits + bits % 2) - 1
