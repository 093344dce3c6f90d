"""Exposure flicker: the part of the brightness of the frames that changes from frame to frame.

Defocus only spreads light, so that the mean grey of a sound stack follows a smooth curve along z: level, or bent by
vignetting, a fading lamp or light that leaves the frame. The curve is smoothed with the strength that predicts the
frames best (generalised cross validation), and only the deviation from it is flicker. It counts when two halves of the
field, a checkerboard of cells, agree on it: noise and texture at the border of the cells differ between them.

A gain of 1 % that varies from frame to frame moves a peak by 0.003 depths of field, because the focus measure of every
pixel rises and falls with it. Frames are divided by their gains in more than 8 bits, before the camera noise is
estimated; a shift of the levels afterwards would leave half of the error, because the noise floor does not flicker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.row_sums import cell_sums, native_copy
from wafer_viewer.numerics.jit import Greys, Real, UInt16s, kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.frame_blocks import Correction, FramePixels

Gains = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlickerParameters:
    """Sample of a stack and limits of flicker.

    Parameters
    ----------
    cells : int
        Cells along each side of a field.
    sampled_px : int, px
        Approximate number of sampled pixels of a frame, in complete rows.
    most_clipped : float
        Largest clipped fraction of a cell that is used, in any frame.
    least_share_of_white : float
        Smallest mean grey of a frame, as a fraction of white.
    least_cells : int
        Smallest number of usable cells.
    least_frames : int
        Smallest number of frames.
    least : float
        Smallest standard deviation of the gains that is corrected. It moves peaks by 0.0015 depths of field.
    agreement : float
        Smallest correlation between the gains of both halves of the field.
    most : float
        Largest factor between a gain and 1; brighter and darker frames are no flicker.
    penalties : tuple[float, float]
        Limits of the smoothness penalty of the mean grey along z; the lower one follows changes over three frames.
    as_good : float
        Largest prediction error, relative to the smallest one, of the curve that flicker is divided by; the smoothest
        such curve is taken.
    side : int
        Number of frames on each side whose median an outlier is compared with.
    outlier_sigmas : float
        Deviation from that median, in standard deviations, above which a frame does not bend the smooth curve.
    """

    cells: int = 8
    sampled_px: int = 1 << 18
    most_clipped: float = 0.002
    least_share_of_white: float = 0.02
    least_cells: int = 8
    least_frames: int = 8
    least: float = 0.005
    agreement: float = 0.8
    most: float = 2.5
    penalties: tuple[float, float] = (0.1, 1e8)
    as_good: float = 1.3
    side: int = 1
    outlier_sigmas: float = 8.0


FLICKER = FlickerParameters()
FINENESS = 100.0
"""Largest number of corrected counts per count of the camera; 8-bit frames are then finer than their noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Flicker:
    """Gains of the frames relative to their median, [k], and their scatter as fractions.

    spread: standard deviation of the gains, 0 where it is not significant; rest: what the gains themselves are unsure
    by, or the flicker that is left where it is too weak for a correction.
    """

    gains: Gains
    spread: float
    rest: float


@dataclass(frozen=True, slots=True, eq=False)
class FlickerGains(Correction):
    """Factors that divide the frames by their gains, float32 [k]."""

    factors: NDArray[np.float32]

    def applied(self, pixels: FramePixels) -> FramePixels:
        """Return the pixels in corrected counts."""
        out = np.empty(pixels.layers[0].shape, np.uint16)
        for part, factor, of_part in zip(pixels.layers[0], self.factors[pixels.frames], out, strict=True):
            divide_by_gain(part, factor, of_part)
        return pixels._replace(layers=(out,))


FlickerCells = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Mean grey and clipped fraction of each cell of a frame, [row, col]."""


def measure_flicker(cells: Sequence[FlickerCells], white_counts: int) -> Flicker:
    """Measure the flicker of frames in the order of z from their cells.

    References
    ----------
    .. [1] P. H. C. Eilers, A perfect smoother, Anal. Chem. 75 (2003) 3631.
    """
    none = Flicker(np.ones(len(cells)), 0.0, 0.0)
    if len(cells) < FLICKER.least_frames or not cells[0][0].size:
        return none
    sums, clipped = (np.stack(of_all) for of_all in zip(*cells, strict=True))
    usable = clipped.max(axis=0) <= FLICKER.most_clipped
    odd = np.indices(usable.shape).sum(axis=0) % 2 == 1
    halves = [sums[:, usable & half].sum(axis=1) for half in (odd, ~odd)]
    dark = FLICKER.least_share_of_white * white_counts
    enough = min(np.count_nonzero(usable & half) for half in (odd, ~odd)) >= FLICKER.least_cells // 2
    if not enough or sums[:, usable].mean(axis=1).min() < dark:
        return none
    mean = np.log(np.sum(halves, axis=0))
    rough, rougher = _roughness(mean, 1.0), _roughness(mean, FLICKER.as_good)
    first, second = (rough(np.log(half)) for half in halves)
    scatter, apart = float(np.std(rough(mean))), float(np.std(first - second)) / 2
    if float(np.mean(first * second)) < FLICKER.agreement * float(np.std(first) * np.std(second)) or scatter == 0:
        return none
    deviation = rougher(mean)
    gains = np.exp(deviation - np.median(deviation))
    if scatter < FLICKER.least or max(gains.max(), 1 / gains.min()) > FLICKER.most:
        return Flicker(none.gains, 0.0, scatter)
    return Flicker(gains, float(np.std(deviation)), apart)


def fineness(gains: Gains, white_counts: int) -> float:
    """Return the corrected counts per count of the camera, so that the brightest corrected pixel fits 16 bits."""
    return min(FINENESS, float(65535 * gains.min() / white_counts))


@kernel
def divide_by_gain(part: Greys, factor: Real, out: UInt16s) -> None:
    """Multiply a part of a frame by a factor, rounded, at most 65535."""
    half, full, scale = np.float32(0.5), np.float32(65535), np.float32(factor)
    for r in range(part.shape[0]):
        row, of_row = part[r], out[r]
        for x in range(row.size):
            of_row[x] = np.uint16(np.int32(min(full, np.float32(row[x]) * scale + half)))


def flicker_cells(frame: Image, clipped_counts: int) -> FlickerCells:
    """Return the cells of a frame, none where it is smaller than they are."""
    n = FLICKER.cells
    if min(frame.shape) < n:
        return np.zeros((0, 0)), np.zeros((0, 0))
    every = max(1, min(frame.size // FLICKER.sampled_px, len(frame) // n))
    rows = native_copy(frame[::every])
    high, wide = len(rows) // n, rows.shape[1] // n
    sums, clipped = cell_sums(rows[: high * n], (high, wide), clipped_counts)
    return sums[:, :n] / (high * wide), clipped[:, :n] / (high * wide)


def _roughness(log: Gains, as_good: float) -> Callable[[Gains], Gains]:
    """Return the function that removes the smooth part of a curve, as smooth as predicts `log` best.

    as_good: largest prediction error relative to the smallest one; of such curves the smoothest is taken.
    Single frames that differ far more than the others do not bend the curve.
    """
    stiffness, modes = _bending_modes(len(log))

    def removed(penalty: float) -> Gains:
        weight = penalty * np.maximum(stiffness, 0.0)
        return weight / (1 + weight)

    penalties, of_log = np.geomspace(*FLICKER.penalties, 37), modes.T @ _without_outliers(log)
    errors = np.array([np.mean((removed(p) * of_log) ** 2) / np.mean(removed(p)) ** 2 for p in penalties])
    smoothest = np.flatnonzero(errors <= as_good * errors.min())[-1]
    kept = 1 - removed(float(penalties[smoothest]))
    return lambda values: values - modes @ (kept * (modes.T @ _without_outliers(values)))


@lru_cache(maxsize=8)
def _bending_modes(n: int) -> tuple[Gains, Gains]:
    """Return the stiffness of the bending modes of n frames, and the modes in columns.

    Kept, because threads of LAPACK that wait for a busy processor take half a second for a hundred frames.
    """
    bends = np.diff(np.eye(n), 2, axis=0)
    stiffness, modes = np.linalg.eigh(bends.T @ bends)
    return stiffness, modes


def _without_outliers(log: Gains) -> Gains:
    """Return a curve with single frames that differ far more than the others replaced by the median around them."""
    around = median_filter(log, 2 * FLICKER.side + 1, mode="nearest")
    off = np.abs(log - around)
    return np.where(off > FLICKER.outlier_sigmas * MAD_TO_SIGMA * np.median(off), around, log)
