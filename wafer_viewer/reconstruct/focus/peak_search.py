"""Blockwise peak search, with its checks: peaks of pure noise, the z sampling, and a wider window.

A gate that requires more than noise reaches in 1 % of the pixels has a known false positive rate, for any number of
frames, window and measure. The scores are ratios, so they do not depend on the strength of the noise, except for a
measure that uses the camera noise: it is given the noise of the simulation.

Where light bleeds from a bright neighbour, or texture runs out, the height depends on the window size; where both
windows agree the height is that of the surface. The wide window is cheap: it averages the levels of the coarse focus
volume, 4 x 4 pixels each, which the search computes anyway.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress, silent
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.numerics.filters.sliding_filters import repeated
from wafer_viewer.numerics.jit import (
    Int,
    Int32s,
    Ints,
    UInt16s,
    aligned,
    inlined_part,
    lean_kernel,
    lean_part,
)
from wafer_viewer.reconstruct.focus.focus_measures import focus_kernels
from wafer_viewer.reconstruct.focus.focus_volume import (
    COARSE_PX,
    USUAL_CAMERA,
    FocusCurves,
    Focusing,
    Volume,
    cores,
    note,
    on_threads,
    rows_in,
)
from wafer_viewer.reconstruct.focus.log_laplacian import log_margin_px
from wafer_viewer.reconstruct.focus.peak import (
    LevelNoise,
    Peaks,
    PeakScratch,
    describe_centred,
    describe_interpolated,
    level_noise,
)
from wafer_viewer.reconstruct.focus.peak_centring import LEAST_SIGMA, CentringWindow
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS, PeakInterpolation
from wafer_viewer.reconstruct.frame_blocks import Frames, StackSource, StackWindow, developed, row_parts, stripes
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

STRIPE_ROWS, _LEAST_STRIPE_ROWS = 96, 32
"""Limits of the rows of a stripe, multiples of `COARSE_PX`: each measures the rows of its margins once more."""


def largest_gap(n_frames: int) -> int:
    """Return the largest distance of a rival from the peak, in frames: a quarter of the stack."""
    return max(1, (n_frames - 1) // 4)


@dataclass(frozen=True, slots=True)
class Search:
    """Parameters of the peak search: measure and estimator by name, and the window.

    gap: minimum distance of a rival maximum from the peak, in frames; reach: frames from the peak to the two
    interpolation points, half a width of the focus curve, because neighbours in a finer sweep differ by noise alone;
    blend: averaging distance along z before interpolation, no average where it is 0; floored: True if the lowest level
    is the noise floor; sigma: standard deviation of the window of a centred peak, in steps. camera, lag: camera noise
    and high-pass along z, for the measures that use them.
    """

    measure: str
    window: int
    estimator: str
    gap: int
    reach: int = 1
    blend: int = 0
    floored: bool = False
    camera: CameraNoise = USUAL_CAMERA
    lag: int = 0
    sigma: float = LEAST_SIGMA

    @property
    def margin_px(self) -> int:
        """Reach of the focus measure beyond a pixel, in pixels."""
        return focus_measures()[self.measure].margin_px(self.window)

    @property
    def placing(self) -> PeakInterpolation:
        """Interpolation parameters for the kernels."""
        how = PEAKS[self.estimator]
        blend = self.blend if how.blended else 0
        power = float(focus_measures()[self.measure].power)
        return PeakInterpolation(how.code, power, self.gap, self.reach, blend, self.floored)

    def centring(self, z_um: NDArray[np.float64]) -> CentringWindow | None:
        """Return the window of a centred peak for frames at z_um, None for other peaks."""
        return CentringWindow.of(z_um, self.sigma) if PEAKS[self.estimator].centred else None

    def noise(self, dtype: np.dtype[Any]) -> LevelNoise:
        """Return the noise of the levels in frames of a dtype."""
        return level_noise(self.measure, self.window, self.camera, dtype)


@dataclass(frozen=True, slots=True, eq=False)
class ThreadScratch:
    """Buffers of one thread: the focus curves of a block, and rows."""

    curves: FocusCurves
    rows: Any
    spots: PeakScratch

    @classmethod
    def make(cls, n_frames: int, shape: tuple[int, int], search: Search, dtype: np.dtype[Any]) -> ThreadScratch:
        """Allocate buffers for blocks of `shape` pixels."""
        kernels = focus_kernels(search.measure)
        rows = kernels.make_rows(shape[1], search.window, dtype)
        spots = PeakScratch.make(shape[1], kernels.table(dtype))
        return cls(FocusCurves.make(n_frames, shape), rows, spots)

    def cut(self, n_rows: int) -> ThreadScratch:
        """Return the same buffers for a block of fewer rows: the last stripe of a field."""
        return self if n_rows == len(self.curves.best) else replace(self, curves=self.curves.cut(n_rows))


def search_field(frames: Frames, search: Search, threads: int | None = None, progress: Progress = silent) -> Peaks:
    """Return the peaks of an entire field, searched stripe by stripe on `threads` threads (default: all cores).

    progress receives the finished fraction, on the calling thread; an exception raised by it ends the search.
    """
    peaks = Peaks.empty(frames.shape, frames.dtype, frames.n_frames)
    parts = stripes(frames.shape, _stripe_rows(frames.shape[0], threads or cores()))

    def search_parts(todo: Iterator[StackWindow]) -> None:
        bench = ThreadScratch.make(frames.n_frames, (parts[0].rows.stop, frames.shape[1]), search, frames.dtype)
        for part, block in developed(frames, todo, search.margin_px):
            search_block(block, frames.z_um, search, bench.cut(rows_in(part.rows)), peaks.rows(part.rows))

    on_threads(search_parts, parts, threads, progress)
    return peaks


def _stripe_rows(n_rows: int, threads: int) -> int:
    """Return the rows of a stripe: two stripes a thread, so that none waits for long, within the limits."""
    share = COARSE_PX * -(-n_rows // (2 * COARSE_PX * threads))
    return min(STRIPE_ROWS, max(_LEAST_STRIPE_ROWS, share))


def search_block(
    source: StackSource, z_um: NDArray[np.float64], search: Search, bench: ThreadScratch, out: Peaks
) -> None:
    """Search the peaks of the pixels of a source and store them in `out`."""
    fill_volume(source, search, bench.rows, Volume(*bench.curves, out.clipped, out.coarse))
    find_peaks(source, z_um, search, bench.curves, bench.spots, out)


def fill_volume(source: StackSource, search: Search, rows: Any, volume: Volume) -> None:
    """Measure the frames of a source; `rows` are the work rows made by the measure.

    The coarse levels of a stripe are strided in those of a large field and contiguous in those of a small one. These
    are two array types, and the kernels would be compiled for each. The levels are therefore written to a contiguous
    array and then copied.
    """
    focusing = Focusing(search.window, search.camera, search.lag)
    coarse = np.empty(volume.coarse.shape, np.uint16)
    focus_kernels(search.measure).fill(source, focusing, rows, volume._replace(coarse=coarse))
    volume.coarse[:] = coarse


def find_peaks(
    source: StackSource,
    z_um: NDArray[np.float64],
    search: Search,
    curves: FocusCurves,
    spots: PeakScratch,
    out: Peaks,
) -> None:
    """Compute the peaks of measured frames and store them in `out`.

    Either kind of peak has its own kernel, so that a user waits for the compiler of one only.
    """
    window = search.centring(z_um)
    if window is None:
        describe_interpolated(curves, source, z_um, search.placing, spots, out.scores)
    else:
        noise = search.noise(out.all_in_focus.dtype)
        describe_centred(curves, source, z_um, search.gap, window, noise, spots, out.scores)
    out.at_end[:] = (curves.peak == 0) | (curves.peak == len(z_um) - 1)


_SIDE_PX = 224
"""Noise peaks are correlated over the window, so a large patch is needed to estimate the 99th percentile."""

_MARGIN_PX = log_margin_px(25)
"""Margin around the patch, for the largest window."""
_DEVIATION_COUNTS = 12.0
"""Standard deviation of the simulated noise."""
_CAMERA = CameraNoise(gain_counts=1e-2, floor_counts2=_DEVIATION_COUNTS**2)
"""Camera noise of the simulation, for the measures that use it."""
_PERCENTILE = 99.0
"""Percentile of the scores on noise: 1 % of the pixels exceed it."""
_SEED = 20240229
"""Seed of the simulated noise."""


@dataclass(frozen=True, slots=True)
class NoiseScores:
    """99th percentiles of the peak scores on pure noise, in powers of two."""

    lead: float
    fall: float
    contrast: float


def noise_scores(search: Search, n_frames: int) -> NoiseScores:
    """Return the scores on a fixed patch of white noise of `n_frames` frames; they do not depend on the estimator.

    Heights are placed all the same, by the kernel that is compiled for the search anyway.
    """
    scored = Search(search.measure, search.window, search.estimator, search.gap, camera=_CAMERA, lag=search.lag)
    return _noise_scores(scored, n_frames)


@lru_cache(maxsize=64)
def _noise_scores(search: Search, n_frames: int) -> NoiseScores:
    grey, shape = _noise(n_frames), (_SIDE_PX, _SIDE_PX)
    source = StackSource.of(grey, np.arange(n_frames), _MARGIN_PX, _MARGIN_PX, 256)
    peaks = Peaks.empty(shape, grey.dtype)
    bench = ThreadScratch.make(n_frames, shape, search, grey.dtype)
    search_block(source, np.arange(n_frames, dtype=np.float64), search, bench, peaks)
    inside = ~peaks.at_end
    lead, fall, contrast = (
        float(np.percentile(score[inside] if inside.any() else score, _PERCENTILE))
        for score in (peaks.lead, peaks.fall, peaks.contrast)
    )
    return NoiseScores(lead, fall, contrast)


@lru_cache(maxsize=1)
def _noise(n_frames: int) -> NDArray[np.uint8]:
    """Return white noise [k, row, col] with a margin for the largest window."""
    side = _SIDE_PX + 2 * _MARGIN_PX
    noise = np.random.default_rng(_SEED).standard_normal((n_frames, side, side), dtype=np.float32)
    noise *= np.float32(_DEVIATION_COUNTS)
    noise += np.float32(128.5)
    return np.clip(noise, 0, 255, out=noise).astype(np.uint8)


NARROWEST_STEPS = 1.2
"""Focus curves no wider than this at half maximum, in steps, have a single frame at their peak."""


FOCUS_WIDTH_DEPTHS = 1.2
"""Full width at half maximum of a focus curve in depths of field, where the depth of field is unknown."""


def coarse_step(step_um: float, depth_of_field_um: float, focus_width_um: float) -> tuple[str, ...]:
    """Return a note when the step is too coarse for the depth of field or, if that is 0 (unknown), the focus width."""
    half_um = depth_of_field_um / 2
    if half_um > 0 and step_um > half_um:
        return (
            f"The step of {step_um:.3g} um is over half the depth of field, {half_um:.2g} um: heights scatter more "
            "than they need to; scan with a finer step.",
        )
    if half_um == 0 and focus_width_um <= NARROWEST_STEPS * step_um:
        return (
            f"Focus curves are hardly wider than a step, {focus_width_um:.3g} um of {step_um:.3g} um: heights scatter "
            "more than they need to; take frames closer to each other.",
        )
    return ()


_WIDE_ROWS = 32
"""Rows of coarse levels that are averaged together; their focus volume fits the L3 cache of most processors."""


def wide_cells(window: int) -> int:
    """Return the number of coarse levels per axis to average for about twice a window.

    The result is 3 for a window of 9, equivalent to a window of 17 to 20.
    """
    return 2 * ((window - 1) // (2 * COARSE_PX)) + 1


class WideLevels:
    """Averages of coarse levels over `cells` x `cells`, and their best frames, from frames in any order.

    coarse: uint16 [k, row, col], the coarse volume of the field, filled before `take`.
    """

    def __init__(self, coarse: NDArray[np.uint16], cells: int) -> None:
        n_frames, n_rows, cols = coarse.shape
        self._coarse, self._cells, self._lines = coarse, cells, aligned((2, cols + cells - 1), np.int32)
        self.curves = [FocusCurves.make(n_frames, (rows_in(rows), cols)) for rows in row_parts(n_rows, _WIDE_ROWS)]
        self._new, self._none = FocusCurves.make(0, self.curves[0].best.shape), np.zeros_like(self.curves[0].best)

    def take(self, first: int, stop: int) -> None:
        """Add the frames first ... stop - 1, each once."""
        for n, curves in enumerate(self.curves):
            n_rows = len(curves.best)
            levels, (_, best, peak) = curves.levels[first:stop], self._new
            new, none = FocusCurves(levels, best[:n_rows], peak[:n_rows]), self._none[:n_rows]
            _average_levels(self._coarse[first:stop], self._cells, n * _WIDE_ROWS, self._lines, new)
            include_frames(new.best, new.peak, none, first, curves.best, curves.peak, none)


@lean_kernel
def include_frames(
    best: UInt16s,
    peak: UInt16s,
    clipped: UInt16s,
    first: Int,
    best_of_all: UInt16s,
    peak_of_all: UInt16s,
    clipped_of_all: UInt16s,
) -> None:
    """Update best level, peak frame and clipped frame count of a block by those of frames from `first` on.

    Of two equally sharp frames the lower one wins, in any arrival order.
    """
    u = np.uint16
    for y in range(best.shape[0]):
        for x in range(best.shape[1]):
            q, old, k, at = best[y, x], best_of_all[y, x], u(peak[y, x] + u(first)), peak_of_all[y, x]
            better = (q > old) | ((q == old) & (k < at))
            best_of_all[y, x] = q if better else old
            peak_of_all[y, x] = k if better else at
            clipped_of_all[y, x] = u(clipped_of_all[y, x] + clipped[y, x])


def wide_heights(
    peaks: Peaks,
    z_um: NDArray[np.float64],
    search: Search,
    cells: int | None = None,
    known: WideLevels | None = None,
) -> NDArray[np.float32]:
    """Return z in um [row, col] of a field's peaks from coarse levels averaged over `cells` x `cells`.

    All pixels of a 4 x 4 cell share a height. The window in pixels is that of the search plus 4 `cells` - 1; beyond the
    border the border levels repeat. `peaks` must have its coarse volume; known: its averages, where they are made.
    """
    n_frames, n_rows, cols = peaks.coarse.shape
    cells, z_um = cells or wide_cells(search.window), np.asarray(z_um, np.float64)
    wide = replace(search, floored=False)
    spots = PeakScratch.make(cols, focus_kernels(search.measure).table(peaks.all_in_focus.dtype))
    lines = aligned((2, cols + cells - 1), np.int32)
    found = Peaks.empty((n_rows, cols), peaks.all_in_focus.dtype)
    room = FocusCurves.make(0 if known else n_frames, (min(n_rows, _WIDE_ROWS), cols))
    for n, rows in enumerate(row_parts(n_rows, _WIDE_ROWS)):
        part = found.rows(rows)
        curves = known.curves[n] if known else room.cut(rows_in(rows))
        if known is None:
            _average_levels(peaks.coarse, cells, rows.start, lines, curves)
        find_peaks(_no_grey(n_frames, part), z_um, wide, curves, spots, part)
    return repeated(found.z_um, COARSE_PX, peaks.z_um.shape)


def _no_grey(n_frames: int, part: Peaks) -> StackSource:
    """Return black frames for peaks whose heights alone are wanted."""
    black = np.zeros((1, *part.z_um.shape), part.all_in_focus.dtype)
    return StackSource.of(black, np.zeros(n_frames, np.intp), 0, 0, 256)


@lean_kernel
def _average_levels(coarse: UInt16s, cells: Int, first: Int, lines: Int32s, curves: FocusCurves) -> None:
    """Fill curves with the averages of coarse levels, from row `first` on."""
    curves.best[:] = 0
    curves.peak[:] = 0
    for k in range(coarse.shape[0]):
        for y in range(curves.best.shape[0]):
            _average(coarse, k, first + y, cells, lines, curves.levels[k, y])
            note(curves.levels[k, y], np.uint16(k), curves.best[y], curves.peak[y])


@inlined_part
def _average(coarse: UInt16s, k: Int, y: Int, cells: Int, lines: Int32s, level: UInt16s) -> None:
    """Compute a row of means over cells x cells levels: column sums with repeated borders, then along the row."""
    half, last, line, sums = cells // 2, coarse.shape[1] - 1, lines[0], lines[1, : level.size]
    columns = line[half : half + level.size]
    columns[:] = 0
    for d in range(cells):
        _add(coarse[k, min(max(y + d - half, 0), last)], columns)
    for x in range(half):
        line[x] = columns[0]
        line[half + level.size + x] = columns[level.size - 1]
    sums[:] = 0
    for d in range(cells):
        _add(line[d:], sums)
    _mean(sums, cells, level)


@lean_part
def _add(values: Ints, sums: Int32s) -> None:
    for x in range(sums.size):
        sums[x] = np.int32(sums[x] + np.int32(values[x]))


@lean_part
def _mean(sums: Int32s, cells: Int, level: UInt16s) -> None:
    per_cell, half = np.float32(1 / cells**2), np.float32(0.5)
    for x in range(level.size):
        level[x] = np.int32(np.float32(sums[x]) * per_cell + half)
