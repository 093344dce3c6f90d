"""Frames of a field in use, and blocks of them: stored pixels, corrected in one order.

``for part, block in developed(frames, parts, margin)`` reads one part after the other and applies the corrections:
defective pixels are replaced, exposures fused or flicker divided out, and drifting frames resampled. No stack is ever
completely in memory. A part that no correction changes is not copied at all, the kernels read it where it is stored:
nearly every camera has a defective pixel, which must not slow down the rest of the field.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import ImageShading
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.jit import Greys, Int64s

Window = tuple[slice, slice]
"""Rows and columns of a field."""

UNEVEN = 0.05
"""Largest deviation of frames that lie evenly, in steps, rms."""
_TOGETHER_PX = 1 << 18
"""Pixels of neighbouring frames that are corrected together: they fit the L2 cache."""


class StackWindow(NamedTuple):
    """Rows and columns of a field, or of a part of it, in a range of its frames."""

    rows: slice
    cols: slice
    frames: slice = slice(None)


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


class StoredImages(NamedTuple):
    """Stored images [slot, row, col] with the slot of each frame in use, [k]."""

    images: Image
    slots: NDArray[np.intp]

    def read(self, frames: slice, window: Window) -> Image:
        """Return the pixels of a range of frames, as a view where the slots are evenly spaced."""
        in_place: Any = np.asarray(self.images)  # arithmetic on a memmap is slower
        return in_place[(as_slice(self.slots[frames]), *window)]


class FramePixels(NamedTuple):
    """Pixels of a few frames on their way through the corrections.

    layers: [n, row, col] of each of the stored stacks, a single one from the fusion on; window: rows and columns of the
    field that they show; wanted: those of the block; frames: range of the frames in use.
    """

    layers: tuple[Image, ...]
    stored: tuple[StoredImages, ...]
    frames: slice
    window: Window
    wanted: Window


class Correction(ABC):
    """Step from stored to corrected pixels."""

    __slots__ = ()

    def changes(self, rows: slice) -> bool:
        """Return whether the correction changes any pixel of these rows."""
        return True

    def window(self, frames: slice, wanted: Window) -> Window:
        """Return the pixels that the wanted ones are made of, in a range of frames."""
        return wanted

    @abstractmethod
    def applied(self, pixels: FramePixels) -> FramePixels:
        """Return the corrected pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames in use, in order of z, and the corrections that make them of the stored ones.

    stored: a stack for each exposure, two for one that is interpolated along z; z_um: rises; clipped_counts: grey from
    which a corrected pixel is clipped; shape: (rows, cols); dtype: of corrected pixels, in native byte order;
    pixel_um: on the sample; depth_of_field_um: of the objective, 0 if unknown; corrections: in the order in which they
    are applied; scale: corrected counts per count of the camera, 1 where exposures are fused; covered_by_all: the
    pixels that every frame shows; shading: of the all-in-focus image, in corrected counts; flicker_rest: standard
    deviation of what is left of the flicker, as a fraction; notes: findings, a sentence each; corner: first pixel of a
    part of a field.
    """

    stored: tuple[StoredImages, ...]
    z_um: NDArray[np.float64]
    clipped_counts: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    pixel_um: float = 1.0
    depth_of_field_um: float = 0.0
    corrections: tuple[Correction, ...] = ()
    scale: float = 1.0
    covered_by_all: Window = slice(None), slice(None)
    shading: ImageShading | None = None
    flicker_rest: float = 0.0
    notes: tuple[str, ...] = ()
    corner: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, images: Image, slots: NDArray[np.intp], z_um: NDArray[np.float64], clipped_counts: int) -> Frames:
        """Return frames without corrections, in these slots of the images."""
        shape, dtype = (images.shape[1], images.shape[2]), images.dtype.newbyteorder("=")
        return cls((StoredImages(images, slots),), z_um, clipped_counts, shape, dtype)

    @property
    def n_frames(self) -> int:
        """Number of frames in use."""
        return len(self.z_um)

    @property
    def step_um(self) -> float:
        """Median distance between neighbouring frames."""
        return float(np.median(np.diff(self.z_um)))

    @property
    def even_step_um(self) -> float:
        """Distance between frames, exact over the whole sweep; 0 where they do not lie evenly."""
        number = np.round((self.z_um - self.z_um[0]) / self.step_um)
        step_um, first_um = np.polyfit(number, self.z_um, 1)
        off_um = float(np.std(self.z_um - first_um - step_um * number))
        return float(step_um) if off_um <= UNEVEN * step_um else 0.0

    @property
    def as_stored(self) -> bool:
        """True if the kernels can read all images in place: complete rows without corrections."""
        return self.in_place(slice(0, self.shape[0])) and not self.corrections

    def in_place(self, rows: slice) -> bool:
        """Return whether the kernels can read these rows of the stored images."""
        images = self.stored[0].images
        in_complete_rows = images.flags.c_contiguous and images.dtype.isnative
        return in_complete_rows and not any(correction.changes(rows) for correction in self.corrections)

    def as_stored_counts(self, grey: Image) -> Image:
        """Return corrected greys in the counts and the type of the images, or of the fused exposures."""
        if self.scale == 1.0:
            return grey
        kind: Any = self.stored[0].images.dtype.newbyteorder("=")
        counts: Any = np.rint(grey / np.float32(self.scale))
        return np.minimum(counts, np.iinfo(kind).max).astype(kind)

    def covered(self, margin: int) -> NDArray[np.bool_]:
        """Return a mask of the pixels whose window of `margin` per side is covered by every frame, bool [row, col]."""
        mask = np.zeros(self.shape, np.bool_)
        mask[tuple(self._covered(axis, margin) for axis in (0, 1))] = True
        return mask

    def _covered(self, axis: int, margin: int) -> slice:
        """Return the covered rows or columns; the margin counts where they do not end with the frame."""
        length, whole = self.shape[axis], self.stored[0].images.shape[axis + 1]
        first, stop, _ = self.covered_by_all[axis].indices(whole)
        first, stop = (int(np.clip(n - self.corner[axis], 0, length)) for n in (first, stop))
        first += margin if first > 0 else 0
        return slice(first, max(first, stop - (margin if stop < length else 0)))

    def part(self, rows: slice, cols: slice) -> Frames:
        """Return the pixels [rows, cols], corrected as in the entire field."""
        (top, bottom, _), (left, right, _) = (part.indices(n) for part, n in zip((rows, cols), self.shape, strict=True))
        shading = None if self.shading is None else self.shading.part(rows, cols)
        return dataclasses.replace(self, shape=(bottom - top, right - left), corner=(top, left), shading=shading)


def developed(frames: Frames, parts: Iterable[StackWindow], margin: int) -> Iterator[tuple[StackWindow, StackSource]]:
    """Yield parts of a field as blocks for kernels that read `margin` pixels beyond them.

    The memory of a block is used again for the next one. Threads may share an iterator of parts, each with a loop of
    its own.
    """
    memory = np.empty(0, frames.dtype)
    for part in parts:
        rows, cols = _in_field(frames, part)
        if frames.in_place(slice(rows.start - margin, rows.stop + margin)):
            images, slots = frames.stored[0]
            yield part, StackSource.of(images, slots[part.frames], rows.start, cols.start, frames.clipped_counts)
            continue
        shape = _shape(frames, part, margin)
        if memory.size < math.prod(shape):
            memory = np.empty(math.prod(shape), frames.dtype)
        block = _filled(memory[: math.prod(shape)].reshape(shape), frames, part, margin)
        yield part, StackSource.of(block, np.arange(len(block)), margin, margin, frames.clipped_counts)


def read_part(frames: Frames, part: StackWindow, margin: int = 0) -> Image:
    """Return the corrected pixels [k, row, col] of a part and a margin; beyond the field its border repeats.

    Without a margin they are a view where the stored pixels need no correction.
    """
    rows, cols = _in_field(frames, part)
    if not margin and frames.in_place(rows):
        return frames.stored[0].read(part.frames, (rows, cols))
    return _filled(np.empty(_shape(frames, part, margin), frames.dtype), frames, part, margin)


def stripes(shape: tuple[int, int], rows: int) -> list[StackWindow]:
    """Split a field into parts of `rows` complete rows; the last part may be smaller."""
    return [StackWindow(part, slice(0, shape[1])) for part in row_parts(shape[0], rows)]


def row_parts(n_rows: int, rows: int) -> list[slice]:
    """Split rows into parts of `rows`; the last part may be shorter."""
    return [slice(top, min(top + rows, n_rows)) for top in range(0, n_rows, rows)]


def as_slice(index: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Convert evenly spaced indices to a slice, which reads a memory-mapped stack without a copy."""
    steps = np.unique(np.diff(index))
    if len(steps) != 1 or steps[0] == 0:
        return index
    step = int(steps[0])
    stop = int(index[-1]) + (1 if step > 0 else -1)
    return slice(int(index[0]), stop if stop >= 0 else None, step)


def _in_field(frames: Frames, part: StackWindow) -> Window:
    """Return the rows and columns of the field; those of a part of it begin at its corner."""
    return _moved(part.rows, frames.corner[0]), _moved(part.cols, frames.corner[1])


def _moved(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)


def _shape(frames: Frames, part: StackWindow, margin: int) -> tuple[int, int, int]:
    n_rows, n_cols = (n.stop - n.start + 2 * margin for n in (part.rows, part.cols))
    return len(range(frames.n_frames)[part.frames]), n_rows, n_cols


def _filled(block: Image, frames: Frames, part: StackWindow, margin: int) -> Image:
    """Fill a block with the corrected pixels of a part and a margin.

    Beyond the field its border pixels repeat, so that the kernels need no border handling.
    """
    (rows, cols), (n_rows, n_cols) = _in_field(frames, part), frames.stored[0].images.shape[1:]
    top, bottom = max(0, rows.start - margin), min(n_rows, rows.stop + margin)
    left, right = max(0, cols.start - margin), min(n_cols, cols.stop + margin)
    r, c = top - rows.start + margin, left - cols.start + margin
    r_end, c_end = r + bottom - top, c + right - left
    wanted, first = (slice(top, bottom), slice(left, right)), part.frames.start or 0
    for together in row_parts(len(block), math.ceil(_TOGETHER_PX / block[0].size)):
        block[together, r:r_end, c:c_end] = _corrected(frames, _moved(together, first), wanted)
    block[:, r:r_end, :c] = block[:, r:r_end, c : c + 1]
    block[:, r:r_end, c_end:] = block[:, r:r_end, c_end - 1 : c_end]
    block[:, :r] = block[:, r : r + 1]
    block[:, r_end:] = block[:, r_end - 1 : r_end]
    return block


def _corrected(frames: Frames, together: slice, wanted: Window) -> Image:
    """Return the wanted pixels of a few frames, with every correction applied in its order."""
    window = wanted
    for correction in reversed(frames.corrections):
        window = correction.window(together, window)
    layers = tuple(stored.read(together, window) for stored in frames.stored)
    pixels = FramePixels(layers, frames.stored, together, window, wanted)
    for correction in frames.corrections:
        pixels = correction.applied(pixels)
    return pixels.layers[0]
