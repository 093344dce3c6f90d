"""The frames of a stack that a reconstruction uses, in the order of z, and the blocks that the kernels read.

The only place where pixels are touched before a focus measure sees them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.plan import MIN_FRAMES
from wafer_viewer.model.stack import FieldStack, Image

CLIPPED_SHARE_OF_WHITE = 0.98
"""From 98 % of white on a pixel counts as clipped: 250 of 255."""

_SAMPLED_ROWS = 24


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The frames in use: images[index] lie at z_um, which rises; from white_counts on a pixel is clipped."""

    images: Image
    index: slice | NDArray[np.intp]
    z_um: NDArray[np.float64]
    clipped_counts: int

    @property
    def n_frames(self) -> int:
        """Frames in use."""
        return len(self.z_um)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        return self.images.shape[1], self.images.shape[2]

    @property
    def dtype(self) -> np.dtype[Any]:
        """What `read_block` gives, in the byte order of this machine."""
        return self.images.dtype.newbyteorder("=")

    @property
    def as_stored(self) -> bool:
        """Whether the kernels can read the images where they lie: whole rows, with nothing to be done to the pixels."""
        return self.images.flags.c_contiguous and self.images.dtype.isnative

    @property
    def step_um(self) -> float:
        """The usual distance between neighbouring frames."""
        return float(np.median(np.diff(self.z_um)))


def prepare(stack: FieldStack) -> Frames:
    """Skip the absent slots and put the others in the order of rising z.

    Raises ComputeError for pixels that are neither uint8 nor uint16, for a z that is no number, for frames that share
    a z, and for fewer than three frames.
    """
    if stack.images.dtype.kind != "u" or stack.images.dtype.itemsize > 2:
        raise ComputeError(
            f"The images of field {stack.field.number} are {stack.images.dtype}: give 8- or 16-bit grey, unsigned."
        )
    present = np.flatnonzero(stack.present)
    z_um = np.asarray(stack.z_um, np.float64)[present]
    order = np.argsort(z_um, kind="stable")
    _check(stack, z_um[order])
    index = _as_slice(present[order])
    return Frames(stack.images, index, z_um[order], _clipped_counts(stack.images[index]))


def read_block(frames: Frames, rows: slice, cols: slice, margin: int, block: Image) -> None:
    """Copy a part of every frame into `block` [k, rows + 2 margin, cols + 2 margin].

    Beyond the frame its border pixels repeat, so that the kernels know no borders.
    """
    n_rows, n_cols = frames.shape
    top, bottom = max(0, rows.start - margin), min(n_rows, rows.stop + margin)
    left, right = max(0, cols.start - margin), min(n_cols, cols.stop + margin)
    r, c = top - rows.start + margin, left - cols.start + margin
    r_end, c_end = r + bottom - top, c + right - left
    block[:, r:r_end, c:c_end] = frames.images[frames.index, top:bottom, left:right]
    block[:, r:r_end, :c] = block[:, r:r_end, c : c + 1]
    block[:, r:r_end, c_end:] = block[:, r:r_end, c_end - 1 : c_end]
    block[:, :r] = block[:, r : r + 1]
    block[:, r_end:] = block[:, r_end - 1 : r_end]


def _check(stack: FieldStack, z_um: NDArray[np.float64]) -> None:
    if len(z_um) < MIN_FRAMES:
        raise ComputeError(f"Field {stack.field.number} has {len(z_um)} frames: at least {MIN_FRAMES} are needed.")
    if not np.isfinite(z_um).all():
        raise ComputeError(f"Field {stack.field.number} has frames without a z position: give every frame its z.")
    same = np.flatnonzero(np.diff(z_um) <= 0)
    if same.size:
        raise ComputeError(
            f"Field {stack.field.number} has two frames at z = {z_um[same[0]]:.3f} um: "
            "give every frame a z of its own, or a z step over 0."
        )


def _as_slice(index: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Evenly spaced indices as a slice: it reads a memory-mapped stack without a copy of its own."""
    steps = np.unique(np.diff(index))
    if len(steps) != 1:
        return index
    step = int(steps[0])
    stop = int(index[-1]) + (1 if step > 0 else -1)
    return slice(int(index[0]), stop if stop >= 0 else None, step)


def _clipped_counts(images: Image) -> int:
    """The grey value from which a pixel counts as clipped; 16-bit files often hold 10, 12 or 14 bits."""
    if images.dtype.itemsize == 1:
        return int(CLIPPED_SHARE_OF_WHITE * 255) + 1
    step = max(1, images.shape[1] // _SAMPLED_ROWS)
    bits = max(8, int(images[:, ::step].max()).bit_length())
    return int(CLIPPED_SHARE_OF_WHITE * (2 ** (bits + bits % 2) - 1))
