"""The search for peaks: a block of a field at a time with all its frames, so that its focus volume stays in cache."""

from __future__ import annotations

import os
import queue
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.stack import Image
from wafer_viewer.reconstruct.focus import FOCUS_MEASURES, Rows, focus_block, mantissa_bits, margin_px
from wafer_viewer.reconstruct.peak import PEAKS, Curves, Peaks, Placing, describe, find_rivals, log2_table
from wafer_viewer.reconstruct.prepare import Frames, read_block

STRIPE_ROWS = 48

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Search:
    """How peaks are looked for: measure and estimator by name, and the window.

    gap: frames from a peak to where another maximum is a rival; reach: frames from the peak to the two points that
    place it, a half width of the focus curve, for neighbours on a finer sweep differ by noise alone.
    """

    measure: str
    window: int
    estimator: str
    gap: int
    reach: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """What one thread works with: the block it reads, the focus volume of the block, and its small change."""

    block: Image
    curves: Curves
    best: NDArray[np.uint16]
    rows: Rows
    table: NDArray[np.float32]

    @classmethod
    def make(cls, n_frames: int, shape: tuple[int, int], window: int, dtype: np.dtype[Any]) -> Bench:
        """A bench for blocks of up to `shape` pixels."""
        margin = margin_px(window)
        native = np.dtype(dtype).newbyteorder("=")
        block = np.zeros((n_frames, shape[0] + 2 * margin, shape[1] + 2 * margin), native)
        best, peak, rival, least = (np.empty(shape, np.uint16) for _ in range(4))
        curves = Curves(np.empty((n_frames, *shape), np.uint16), peak, rival, least)
        return cls(block, curves, best, Rows.make(shape[1], window, native), log2_table(mantissa_bits(native)))

    def cut(self, n_rows: int, margin: int) -> Bench:
        """The same bench for a block of fewer rows: the last stripe of a field."""
        if n_rows == len(self.best):
            return self
        levels, *small = self.curves
        curves = Curves(levels[:, :n_rows].copy(), *(a[:n_rows] for a in small))
        return Bench(self.block[:, : n_rows + 2 * margin].copy(), curves, self.best[:n_rows], self.rows, self.table)


def search_field(frames: Frames, search: Search, threads: int | None = None, progress: Progress | None = None) -> Peaks:
    """The peaks of a whole field, stripe by stripe, on some threads (all cores without a number).

    progress is told the finished share, from the calling thread; what it raises ends the search.
    """
    peaks = Peaks.empty(frames.shape, frames.dtype)
    stripes = list(_stripes(frames.shape[0]))
    threads = min(threads or _cores(), len(stripes))
    benches: queue.SimpleQueue[Bench] = queue.SimpleQueue()
    for _ in range(threads):
        benches.put(Bench.make(frames.n_frames, (stripes[0].stop, frames.shape[1]), search.window, frames.dtype))

    def one(rows: slice) -> None:
        bench = benches.get()
        search_part(frames, rows, slice(0, frames.shape[1]), search, bench, peaks.rows(rows))
        benches.put(bench)

    for done, _ in enumerate(_each(one, stripes, threads), 1):
        if progress is not None:
            progress(done / len(stripes))
    return peaks


def search_part(frames: Frames, rows: slice, cols: slice, search: Search, bench: Bench, out: Peaks) -> None:
    """The peaks of the pixels [rows, cols] of a field, into `out`."""
    bench = bench.cut(rows.stop - rows.start, margin_px(search.window))
    read_block(frames, rows, cols, margin_px(search.window), bench.block)
    search_block(frames.z_um, frames.clipped_counts, search, bench, out)


def search_block(z_um: NDArray[np.float64], clipped_counts: int, search: Search, bench: Bench, out: Peaks) -> None:
    """The peaks of the block on a bench, into `out`."""
    measure, block, curves = FOCUS_MEASURES[search.measure], bench.block, bench.curves
    placing = Placing(PEAKS[search.estimator].code, measure.power, search.gap, search.reach)
    focus_block(
        block,
        measure.code,
        search.window,
        clipped_counts,
        bench.rows,
        curves.levels,
        bench.best,
        curves.peak,
        out.clipped,
    )
    find_rivals(curves, search.gap)
    describe(curves, block, margin_px(search.window), z_um, placing, bench.table, out.scores)
    out.at_end[:] = (curves.peak == 0) | (curves.peak == len(z_um) - 1)


def _cores() -> int:
    """The cores that this process may use; not every system tells which."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _stripes(n_rows: int) -> Iterator[slice]:
    for start in range(0, n_rows, STRIPE_ROWS):
        yield slice(start, min(n_rows, start + STRIPE_ROWS))


def _each(work: Callable[[slice], None], stripes: list[slice], threads: int) -> Iterator[None]:
    """Do the stripes one after the other, or on a pool of threads: the kernels run without the interpreter's lock."""
    if threads == 1:
        yield from map(work, stripes)
        return
    pool = ThreadPoolExecutor(threads)
    try:
        yield from pool.map(work, stripes)
    finally:
        pool.shutdown(cancel_futures=True)
