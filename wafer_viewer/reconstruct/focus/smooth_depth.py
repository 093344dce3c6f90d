"""All-in-focus image across ground without texture: read at a smooth depth, not at the peaks of noise.

Where nothing is in focus the sharpest frame is arbitrary, and the image breaks into patches of different frames. There
the depth of the measured pixels around is continued as a membrane, and the grey is interpolated between the two frames
beside it. Heights do not change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.jit import Bools, Float32s, lean_kernel
from wafer_viewer.reconstruct.focus.focus_volume import row_parts
from wafer_viewer.reconstruct.preprocess.frames import Frames, read_block

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SmoothDepthParameters:
    """Extent and smoothness of the continued depth.

    Parameters
    ----------
    over_noise : float
        Contrast of a focus curve above that of noise, in powers of two, below which an unmeasured pixel has no depth of
        its own. Fine details in front of a far ground have more: they stay at their sharpest frame.
    relaxations : int
        Averages with the four neighbours at each resolution.
    """

    over_noise: float = 2.0
    relaxations: int = 4


SMOOTH_DEPTH = SmoothDepthParameters()
_ROWS = 64
"""Rows of the image that are read together."""


def at_smooth_depth(picture: Image, z_um: Floats, without: NDArray[np.bool_], frames: Frames) -> Image:
    """Return the all-in-focus image with the pixels `without` a depth of their own read at a continued depth.

    Parameters
    ----------
    picture : ndarray of uint8 or uint16, [row, col]
        Grey of the sharpest frame, as frames are read.
    z_um : ndarray, [row, col], um
        Heights, NaN where there is none.
    without : ndarray of bool, [row, col]
        Pixels to replace.
    frames : Frames
        Frames of the field.

    References
    ----------
    .. [1] S. J. Gortler et al., The Lumigraph, SIGGRAPH 1996, section 3.4 (pull-push).
    """
    if not without.any() or not np.isfinite(z_um).any():
        return picture
    depth_um, out = membrane(z_um), picture.copy()
    for rows in row_parts(len(picture), _ROWS):
        at = np.nonzero(without[rows])
        if not at[0].size:
            continue
        place = np.interp(depth_um[rows][at], frames.z_um, np.arange(frames.n_frames))
        low = np.minimum(place.astype(np.intp), frames.n_frames - 2)
        below, above = _greys(frames, rows, at, low, low + 1)
        out[rows][at] = np.rint(below + (place - low) * (above - below)).astype(out.dtype)
    return out


def membrane(values: Floats) -> Floats:
    """Return values [row, col] with NaN replaced by a smooth continuation, from coarse to fine."""
    known = np.isfinite(values)
    if known.all():
        return values
    if min(values.shape) == 1:
        return np.where(known, values, np.nanmean(values) if known.any() else np.float32(0))
    found = np.where(known, values, _finer(membrane(_halved(values, known)), values.shape))
    rows = np.empty((2, found.shape[1]), np.float32)
    for _ in range(SMOOTH_DEPTH.relaxations):
        _relax(found, known, rows)
    return found


@lean_kernel
def _relax(found: Float32s, known: Bools, rows: Float32s) -> None:
    """Replace unknown values by the mean of their four neighbours before any is replaced; the border repeats.

    rows: two rows of work space for unreplaced values.
    """
    n_rows, last = found.shape[0], found.shape[1] - 1
    quarter = np.float32(0.25)
    for x in range(last + 1):
        rows[1, x] = found[0, x]
    for r in range(n_rows):
        above, row, below = rows[(r + 1) % 2], rows[r % 2], found[min(r + 1, n_rows - 1)]
        for x in range(last + 1):
            row[x] = found[r, x]
        for x in range(1, last):
            mean = quarter * (above[x] + below[x] + row[x - 1] + row[x + 1])
            found[r, x] = row[x] if known[r, x] else mean
        for x in (0, last):
            if not known[r, x]:
                both = above[x] + (below[x] if r < n_rows - 1 else row[x])
                found[r, x] = quarter * (both + row[max(x - 1, 0)] + row[min(x + 1, last)])


def _halved(values: Floats, known: NDArray[np.bool_]) -> Floats:
    """Return the means of 2 x 2 values, NaN where all four are unknown."""
    odd = [(0, n % 2) for n in values.shape]
    total = np.pad(np.where(known, values, np.float32(0)), odd)
    weight = np.pad(known.astype(np.float32), odd)
    total, weight = (a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2] for a in (total, weight))
    return np.divide(total, weight, out=np.full(total.shape, np.nan, np.float32), where=weight > 0)


def _finer(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Return values at twice the resolution, interpolated linearly between cell centres."""
    for axis in (0, 1):
        turned = np.moveaxis(values, axis, 0)
        padded = np.concatenate([turned[:1], turned, turned[-1:]])
        fine = np.empty((2 * len(turned), turned.shape[1]), np.float32)
        fine[::2] = np.float32(0.75) * turned + np.float32(0.25) * padded[:-2]
        fine[1::2] = np.float32(0.75) * turned + np.float32(0.25) * padded[2:]
        values = np.moveaxis(fine[: shape[axis]], 0, axis)
    return values


def _greys(frames: Frames, rows: slice, at: tuple[NDArray[np.intp], ...], *which: NDArray[np.intp]) -> Iterator[Floats]:
    """Yield the greys of the pixels `at` of some rows, in the frames that are given for each pixel."""
    if frames.ready(rows, 0):
        yield from (frames.images[frames.slots[k], rows.start + at[0], at[1]].astype(np.float32) for k in which)
        return
    block = np.empty((frames.n_frames, rows.stop - rows.start, frames.shape[1]), frames.dtype)
    read_block(frames, rows, slice(0, frames.shape[1]), 0, block)
    yield from (block[k, at[0], at[1]].astype(np.float32) for k in which)
