"""All-in-focus image: each pixel read at its height, between the frames.

A measured pixel is read at its cleaned height, by a parabola fitted to the frames around it: no seams where the
sharpest frame changes, and less noise than a single frame has. The depth of measured pixels is continued as a membrane
across the others, because on ground without texture the sharpest frame is arbitrary, and the image would break into
patches.

An unmeasured pixel with texture is read at its own peak. Beside walls it belongs either to the surface that the
membrane continues or to the one on which it seems sharpest. Out of focus a surface loses light to its surroundings; in
focus it keeps all of its own and receives that of others in addition. The brighter of the two readings is therefore
right.

Heights do not change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.sliding_filters import mean
from wafer_viewer.numerics.jit import (
    Bools,
    Float32s,
    Float64s,
    Greys,
    Real,
    UInt64s,
    inline_kernel,
    lean_kernel,
)
from wafer_viewer.reconstruct.focus.focus_volume import on_threads
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.frame_blocks import Frames, StackSource, StackWindow, developed, stripes

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PictureParameters:
    """Fit across frames, continued depth, and choice beside walls: tests/bench/bench_all_in_focus.py.

    Parameters
    ----------
    least_steps : float
        Least half-width of the fit, which is the focus width, in steps: fewer than three frames are no parabola.
    most_steps : float
        Largest half-width of the fit, in steps: a wider fit blurs where the focus width is overestimated.
    relaxations : int
        Averages with the four neighbours at each resolution of the membrane.
    over_noise : float
        Contrast of a focus curve above that of noise, in powers of two, from which an unmeasured pixel has a depth of
        its own.
    full_over_noise : float
        The same, from which that depth counts fully: the image would show the contour of a single limit.
    side_px : int
        Side of the squares over which that weight, and the grey that clipped pixels are compared with, are averaged.
    clipped_frames_fraction : float
        Fraction of frames in which an unmeasured pixel must be too bright to count as clipped.
    dim_share_of_white : float
        Grey below which the reading of a clipped pixel is wrong, as a fraction of white. Light of an overexposed
        surface has no peak, so that it is read out of focus, where it is dim.
    """

    least_steps: float = 1.75
    most_steps: float = 3.0
    relaxations: int = 4
    over_noise: float = 1.0
    full_over_noise: float = 3.0
    side_px: int = 9
    clipped_frames_fraction: float = 0.02
    dim_share_of_white: float = 0.5


PICTURE = PictureParameters()
_ROWS = 64
"""Rows of the image that are read together."""
_PLACES = 32
"""Places between two frames for which the weights of the fit are tabulated."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """Reading of pixels between the frames of a field, by local parabolas about `steps` frames to each side.

    threads: all cores if None.
    """

    frames: Frames
    steps: float
    threads: int | None = None

    @classmethod
    def of(cls, frames: Frames, focus_width_um: float, threads: int | None = None) -> FrameFit:
        """Return the fit for focus curves of a full width at half maximum."""
        steps = focus_width_um / frames.step_um
        return cls(frames, float(np.clip(steps, PICTURE.least_steps, PICTURE.most_steps)), threads)

    def read(self, z_um: Floats, wanted: NDArray[np.bool_], out: NDArray[Any]) -> None:
        """Write the grey of the `wanted` pixels at z_um to `out`, all arrays [row, col]."""
        weights, white = _fit_weights(self.steps), np.float32(np.iinfo(self.frames.dtype).max)

        def read_parts(todo: Iterator[StackWindow]) -> None:
            starts = np.empty(self.frames.n_frames + weights.shape[1], np.uint64)
            for (rows, *_), block in developed(self.frames, todo, 0):
                _read(block, z_um[rows], wanted[rows], self.frames.z_um, weights, white, starts, out[rows])

        parts = [part for part in stripes(self.frames.shape, _ROWS) if wanted[part.rows].any()]
        on_threads(read_parts, parts, self.threads)


def all_in_focus(
    peaks: Peaks,
    z_um: Floats,
    measured: NDArray[np.bool_],
    walls: bool,
    min_contrast: float,
    fit: FrameFit,
) -> Image:
    """Return the all-in-focus image, uint8 or uint16 [row, col], in the counts that frames are read in.

    Parameters
    ----------
    peaks : Peaks
        Peaks of the field.
    z_um : ndarray, [row, col], um
        Cleaned heights, NaN where there is none.
    measured : ndarray of bool, [row, col]
        Pixels whose peak counts, or that were filled.
    walls : bool
        Whether walls were found, over which light bleeds.
    min_contrast : float
        Contrast of focus curves of pure noise, in powers of two.
    fit : FrameFit
        Frames of the field, and how they are read.

    References
    ----------
    .. [1] A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data, Anal. Chem. 36 (1964) 1627.
    .. [2] S. J. Gortler et al., The Lumigraph, SIGGRAPH 1996, section 3.4 (pull-push).
    """
    if not np.isfinite(z_um).any():
        return peaks.all_in_focus
    picture = np.empty(z_um.shape, fit.frames.dtype)
    fit.read(membrane(z_um), np.ones(z_um.shape, np.bool_), picture)
    if not measured.all():
        weight = _own_depth_weight(peaks, measured, min_contrast)
        _read_own_depths(picture, peaks, weight, walls, fit)
        _whiten(picture, peaks, ~measured, fit.frames)
    return picture


def _own_depth_weight(peaks: Peaks, measured: NDArray[np.bool_], min_contrast: float) -> Floats:
    """Return how far unmeasured pixels have a depth of their own, 0 ... 1."""
    usable = ~measured & ~peaks.at_end & np.isfinite(peaks.z_um)
    octaves = PICTURE.full_over_noise - PICTURE.over_noise
    weight = ((peaks.contrast - np.float32(min_contrast + PICTURE.over_noise)) / np.float32(octaves)).clip(0, 1)
    return mean(weight * usable, PICTURE.side_px) * usable


def _read_own_depths(picture: Image, peaks: Peaks, weight: Floats, walls: bool, fit: FrameFit) -> None:
    """Replace greys by those at the peaks; only by brighter ones beside walls, and where clipped light has no peak."""
    wanted = weight > 0
    at_peak = picture.copy()
    fit.read(peaks.z_um, wanted, at_peak)
    more = at_peak[wanted].astype(np.float32) - picture[wanted]
    np.copyto(more, 0, where=(more < 0) & (walls | (peaks.clipped[wanted] > 0)))
    picture[wanted] = np.rint(picture[wanted] + weight[wanted] * more).astype(picture.dtype)


def _whiten(picture: Image, peaks: Peaks, unmeasured: NDArray[np.bool_], frames: Frames) -> None:
    """Make clipped pixels white whose surroundings are dim."""
    clipped = unmeasured & (peaks.clipped > PICTURE.clipped_frames_fraction * frames.n_frames)
    if clipped.any():
        dim = mean(picture, PICTURE.side_px) < PICTURE.dim_share_of_white * frames.clipped_counts
        picture[clipped & dim] = max(frames.clipped_counts, int(picture.max()))


@lru_cache(maxsize=16)
def _fit_weights(half_width_steps: float) -> Floats:
    """Return the weights of frames in the value of a local least-squares parabola, float32 [place, frame].

    Place p lies p / `_PLACES` steps after the former of the two frames in the middle, the last one at the latter.
    """
    reach = int(np.ceil(half_width_steps)) - 1  # the weight is 0 at the half-width
    frames = np.arange(-reach, reach + 2)
    weights = np.zeros((_PLACES + 1, len(frames)), np.float32)
    for place in range(_PLACES + 1):
        t = frames - place / _PLACES
        root = np.sqrt(np.clip(1 - (t / half_width_steps) ** 2, 0, None))
        weights[place] = np.linalg.pinv(root[:, None] * np.vander(t, 3))[2] * root
    return weights


@lean_kernel
def _read(
    source: StackSource,
    z_um: Float32s,
    wanted: Bools,
    frame_um: Float64s,
    weights: Float32s,
    white: Real,
    starts: UInt64s,
    out: Greys,
) -> None:
    """Fill the wanted pixels of some rows; starts: work space, one place for each frame and tap."""
    images, slots, last = source.images, source.slots, frame_um.size - 1
    n_rows, n_cols = images.shape[1:]
    pixels, n_taps, first = images.reshape(-1), weights.shape[1], 1 - weights.shape[1] // 2
    per_um = (last - 1) / (frame_um[last] - frame_um[0])
    for y in range(out.shape[0]):
        for n in range(starts.size):  # where the row begins in each frame; beyond the sweep the last frames repeat
            k = min(max(n + first, 0), last)
            starts[n] = (slots[k] * n_rows + source.top + y) * n_cols + source.left
        for x in range(out.shape[1]):
            if wanted[y, x]:
                low = _frame_below(z_um[y, x], frame_um, per_um)
                share = (z_um[y, x] - frame_um[low]) / (frame_um[low + 1] - frame_um[low])
                fit = weights[int(_PLACES * min(max(share, 0.0), 1.0) + 0.5)]
                grey = np.float32(0.5)
                for n in range(n_taps):
                    grey += fit[n] * np.float32(pixels[starts[low + n] + np.uint64(x)])
                out[y, x] = np.int64(min(max(grey, np.float32(0)), white))


@inline_kernel
def _frame_below(z_um: Real, frame_um: Float64s, per_um: Real) -> int:
    """Return the last frame below z that has another one above it; per_um: mean number of frames."""
    last = frame_um.size - 2
    k = int(min(max((z_um - frame_um[0]) * per_um, 0.0), np.float64(last)))
    while k > 0 and z_um < frame_um[k]:
        k -= 1
    while k < last and z_um >= frame_um[k + 1]:
        k += 1
    return k


def membrane(values: Floats) -> Floats:
    """Return values [row, col] with NaN replaced by a smooth continuation, from coarse to fine."""
    known = np.isfinite(values)
    if known.all():
        return values
    if min(values.shape) == 1:
        return np.where(known, values, np.nanmean(values) if known.any() else np.float32(0))
    found, coarse = values.copy(), membrane(_halved(values))
    rows = np.empty((2, found.shape[1]), np.float32)
    _fill_finer(coarse, known, rows[0], found)
    for _ in range(PICTURE.relaxations):
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


def _halved(values: Floats) -> Floats:
    """Return the means of 2 x 2 values, NaN where all four are unknown."""
    out = np.empty((-(-values.shape[0] // 2), -(-values.shape[1] // 2)), np.float32)
    _write_means(np.ascontiguousarray(values), out)
    return out


@lean_kernel
def _write_means(values: Float32s, out: Float32s) -> None:
    n_rows, n_cols = values.shape
    for r in range(out.shape[0]):
        for x in range(out.shape[1]):
            total, weight = np.float32(0), np.float32(0)
            for right in range(2):
                for down in range(2):
                    if 2 * r + down < n_rows and 2 * x + right < n_cols:
                        v = values[2 * r + down, 2 * x + right]
                        total += v if abs(v) < np.inf else np.float32(0)
                        weight += np.float32(abs(v) < np.inf)
            out[r, x] = total / weight if weight > 0 else np.float32(np.nan)


@lean_kernel
def _fill_finer(coarse: Float32s, known: Bools, line: Float32s, found: Float32s) -> None:
    """Fill unknown values from those at half the resolution, interpolated linearly between cell centres, rows first.

    line: a row of work space.
    """
    near, far = np.float32(0.75), np.float32(0.25)
    last_row, last_col = coarse.shape[0] - 1, coarse.shape[1] - 1
    for r in range(found.shape[0]):
        i = r // 2
        beside = min(max(i + 2 * (r % 2) - 1, 0), last_row)
        for j in range(coarse.shape[1]):
            line[j] = near * coarse[i, j] + far * coarse[beside, j]
        for x in range(found.shape[1]):
            if not known[r, x]:
                j = x // 2
                found[r, x] = near * line[j] + far * line[min(max(j + 2 * (x % 2) - 1, 0), last_col)]
