"""What the log-Laplacian's own kernels cost on a full-size field, one thread, without the search for peaks around them.

    python tests/bench/bench_log_laplacian.py

The least processor time of many runs over one stripe, as milliseconds a frame of 1080 x 1440.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from wafer_viewer.reconstruct.camera_noise import CameraNoise
from wafer_viewer.reconstruct.log_laplacian import LogRows, Stabiliser, log_laplacian_block, log_margin_px

ROWS, COLS, FRAMES, RUNS = 1080, 1440, 16, 12
CAMERA = CameraNoise(gain_counts=0.02, floor_counts2=0.2)


def main() -> None:
    started = time.process_time()
    measure_ms(9, 48, 0, np.uint8, runs=1)
    print(f"compiled or loaded in {time.process_time() - started:.2f} s")
    for window in (5, 9, 13, 17, 25):
        print(f"window {window:2d}, stripes of 48 rows: {measure_ms(window, 48, 0, np.uint8):.2f} ms a frame")
    print(f"window  9, stripes of 96 rows: {measure_ms(9, 96, 0, np.uint8):.2f} ms a frame")
    print(f"window  9, 16 bits:            {measure_ms(9, 48, 0, np.uint16):.2f} ms a frame")
    print(f"window  9, high-pass along z:  {measure_ms(9, 48, 3, np.uint8):.2f} ms a frame")


def measure_ms(window: int, stripe: int, lag: int, dtype: type, runs: int = RUNS) -> float:
    margin = log_margin_px(window)
    shape = stripe + 2 * margin, COLS + 2 * margin
    block = np.random.default_rng(1).integers(0, 256, (FRAMES, *shape)).astype(dtype)
    levels = np.empty((FRAMES, stripe, COLS), np.uint16)
    best, peak, clipped = (np.empty((stripe, COLS), np.uint16) for _ in range(3))
    rows, stabiliser = LogRows.make(COLS, window), Stabiliser.of(CAMERA)

    def once() -> None:
        log_laplacian_block(block, window, stabiliser, lag, 250, rows, levels, best, peak, clipped)

    return least_s(once, runs) * 1000 / FRAMES * ROWS / stripe


def least_s(work: Callable[[], None], runs: int) -> float:
    """The least processor time of some runs: what else the machine does only adds."""
    times: list[float] = []
    for _ in range(runs):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times)


if __name__ == "__main__":
    main()
