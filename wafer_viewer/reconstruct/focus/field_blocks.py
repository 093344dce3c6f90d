"""Parts of a field: sources for the kernels, and parallel processing."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.reconstruct.focus.focus_volume import StackSource
from wafer_viewer.reconstruct.preprocess.frames import Frames, read_block

Part = TypeVar("Part")


def cores() -> int:
    """Return the number of cores available to this process; the total number where affinity is unavailable."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_threads(work: Callable[[Part], None], parts: Iterable[Part], threads: int | None) -> None:
    """Process all parts on `threads` threads (default: all cores)."""
    threads = threads or cores()
    if threads == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, parts))


def row_parts(n_rows: int, rows: int) -> list[slice]:
    """Split rows into parts of `rows`; the last part may be shorter."""
    return [slice(top, min(top + rows, n_rows)) for top in range(0, n_rows, rows)]


def source_of(frames: Frames, rows: slice, cols: slice, margin: int, block: Image | None = None) -> StackSource:
    """Return a part of a field for kernels that read `margin` pixels beyond it.

    Pixels are read in place where possible, otherwise copied and corrected. block: [k, rows + 2 margin, cols + 2
    margin] to copy to; allocated on demand if omitted.
    """
    if frames.ready(rows, margin):
        return StackSource.of(frames.images, frames.slots, rows.start, cols.start, frames.clipped_counts)
    if block is None:
        block = read_part(frames, slice(0, frames.n_frames), rows, cols, margin)
    else:
        read_block(frames, rows, cols, margin, block)
    return StackSource.of(block, np.arange(frames.n_frames), margin, margin, frames.clipped_counts)


def source_of_rows(frames: Frames, rows: slice, margin: int) -> StackSource:
    """Return full rows of a field, for kernels that read `margin` pixels beyond them."""
    return source_of(frames, rows, slice(0, frames.shape[1]), margin)


def read_part(frames: Frames, some: slice, rows: slice, cols: slice, margin: int) -> Image:
    """Read a range of frames of a part of a field, with a margin; beyond the field its border repeats."""
    alone = frames.drift is None  # the drift of a frame is known by its place among all of them
    chosen = dataclasses.replace(frames, index=frames.slots[some]) if alone else frames
    n_frames = some.stop - some.start if alone else frames.n_frames
    block = np.empty((n_frames, rows.stop - rows.start + 2 * margin, cols.stop - cols.start + 2 * margin), frames.dtype)
    read_block(chosen, rows, cols, margin, block)
    return block if alone else block[some]
