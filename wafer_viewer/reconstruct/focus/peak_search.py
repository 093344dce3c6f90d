"""Blockwise peak search: each block has all its frames, so that its focus volume stays in cache."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.progress import Progress
from wafer_viewer.reconstruct.focus.field_blocks import cores, source_of
from wafer_viewer.reconstruct.focus.focus_measures import FOCUS_MEASURES, USUAL_CAMERA, Focusing
from wafer_viewer.reconstruct.focus.focus_volume import StackSource, Volume
from wafer_viewer.reconstruct.focus.peak import FocusCurves, Peaks, describe
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS, InterpolationScratch, PeakInterpolation
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise
from wafer_viewer.reconstruct.preprocess.frames import Frames

STRIPE_ROWS = 32
"""A multiple of `COARSE_PX`; the focus volumes of two threads then fit the L3 cache of most processors."""


@dataclass(frozen=True, slots=True)
class Search:
    """Parameters of the peak search: measure and estimator by name, and the window.

    gap: minimum distance of a rival maximum from the peak, in frames; reach: frames from the peak to the two
    interpolation points, half a width of the focus curve, because neighbours in a finer sweep differ by noise alone;
    blend: averaging distance along z before interpolation, no average where it is 0; floored: True if the lowest level
    is the noise floor. camera, lag: camera noise and high-pass along z, for the measures that use them.
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

    @property
    def margin_px(self) -> int:
        """Reach of the focus measure beyond a pixel, in pixels."""
        return FOCUS_MEASURES[self.measure].margin_px(self.window)

    @property
    def placing(self) -> PeakInterpolation:
        """Interpolation parameters for the kernels."""
        how = PEAKS[self.estimator]
        blend = self.blend if how.blended else 0
        return PeakInterpolation(
            how.code, FOCUS_MEASURES[self.measure].power, self.gap, self.reach, blend, self.floored
        )


@dataclass(frozen=True, slots=True, eq=False)
class ThreadScratch:
    """Buffers of one thread: a block for pixels that cannot be read in place, its focus curves, and rows."""

    block: Image
    curves: FocusCurves
    rows: Any
    spots: InterpolationScratch

    @classmethod
    def make(cls, n_frames: int, shape: tuple[int, int], search: Search, dtype: np.dtype[Any]) -> ThreadScratch:
        """Allocate buffers for blocks of `shape` pixels; the block uses no memory until pixels are copied to it."""
        native, margin = np.dtype(dtype).newbyteorder("="), search.margin_px
        block = np.empty((n_frames, shape[0] + 2 * margin, shape[1] + 2 * margin), native)
        measure = FOCUS_MEASURES[search.measure]
        rows = measure.make_rows(shape[1], search.window, native)
        spots = InterpolationScratch.make(shape[1], measure.table(native))
        return cls(block, FocusCurves.make(n_frames, shape), rows, spots)

    def cut(self, n_rows: int) -> ThreadScratch:
        """Return the same buffers for a block of fewer rows: the last stripe of a field."""
        levels, best, peak = self.curves
        fewer = len(best) - n_rows
        if not fewer:
            return self
        block = _fewer_rows(self.block, self.block.shape[1] - fewer)
        return ThreadScratch(
            block, FocusCurves(_fewer_rows(levels, n_rows), best[:n_rows], peak[:n_rows]), self.rows, self.spots
        )


def search_field(frames: Frames, search: Search, threads: int | None = None, progress: Progress | None = None) -> Peaks:
    """Return the peaks of an entire field, searched stripe by stripe on `threads` threads (default: all cores).

    progress receives the finished fraction, on the calling thread; an exception raised by it ends the search.
    """
    peaks = Peaks.empty(frames.shape, frames.dtype, frames.n_frames)
    parts = stripes(frames.shape[0])
    threads = min(threads or cores(), len(parts))
    benches: queue.SimpleQueue[ThreadScratch] = queue.SimpleQueue()
    for _ in range(threads):
        benches.put(ThreadScratch.make(frames.n_frames, (parts[0].stop, frames.shape[1]), search, frames.dtype))

    def one(rows: slice) -> None:
        bench = benches.get()
        search_part(frames, rows, slice(0, frames.shape[1]), search, bench, peaks.rows(rows))
        benches.put(bench)

    for done, _ in enumerate(_each(one, parts, threads), 1):
        if progress is not None:
            progress(done / len(parts))
    return peaks


def search_part(frames: Frames, rows: slice, cols: slice, search: Search, bench: ThreadScratch, out: Peaks) -> None:
    """Search the peaks of the pixels [rows, cols] of a field and store them in `out`."""
    bench = bench.cut(rows.stop - rows.start)
    source = source_of(frames, rows, cols, search.margin_px, bench.block)
    search_block(source, frames.z_um, search, bench, out)


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
    FOCUS_MEASURES[search.measure].fill(source, focusing, rows, volume._replace(coarse=coarse))
    volume.coarse[:] = coarse


def find_peaks(
    source: StackSource,
    z_um: NDArray[np.float64],
    search: Search,
    curves: FocusCurves,
    spots: InterpolationScratch,
    out: Peaks,
) -> None:
    """Compute the peaks of measured frames and store them in `out`."""
    describe(curves, source, z_um, search.placing, spots, out.scores)
    out.at_end[:] = (curves.peak == 0) | (curves.peak == len(z_um) - 1)


def stripes(n_rows: int) -> list[slice]:
    """Return the rows of a field in parts whose focus volumes fit in cache."""
    return [slice(start, min(n_rows, start + STRIPE_ROWS)) for start in range(0, n_rows, STRIPE_ROWS)]


def _fewer_rows(volume: NDArray[Any], n_rows: int) -> NDArray[Any]:
    """Return a volume [k, row, col] of fewer rows that shares the memory of `volume`."""
    n_frames, _, cols = volume.shape
    return volume.reshape(-1)[: n_frames * n_rows * cols].reshape(n_frames, n_rows, cols)


def _each(work: Callable[[slice], None], parts: list[slice], threads: int) -> Iterator[None]:
    """Process the parts sequentially or on a thread pool; the kernels release the GIL."""
    if threads == 1:
        yield from map(work, parts)
        return
    pool = ThreadPoolExecutor(threads)
    try:
        yield from pool.map(work, parts)
    finally:
        pool.shutdown(cancel_futures=True)
