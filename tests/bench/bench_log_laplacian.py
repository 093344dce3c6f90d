"""What the log-Laplacian's own kernels cost on a full-size field, one thread, without the search for peaks around them.

    python tests/bench/bench_log_laplacian.py

The least processor time of many runs over one stripe, as milliseconds a frame of 1080 x 1440.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from wafer_viewer.reconstruct.camera_noise import CameraNoise, estimate_camera_noise
from wafer_viewer.reconstruct.log_laplacian import LogRows, Stabiliser, log_laplacian_block
from wafer_viewer.reconstruct.prepare import Frames
from wafer_viewer.reconstruct.silhouette import Silhouette, SilhouetteRows, silhouette_block
from wafer_viewer.reconstruct.volume import Source, Volume

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
    for every in (1, 3):
        print(f"silhouette of every {every}. frame:   {silhouette_ms(48, every):.2f} ms a frame")
    print(f"camera's noise:                {camera_noise_ms():.1f} ms a field")


def measure_ms(window: int, stripe: int, lag: int, dtype: type, runs: int = RUNS) -> float:
    source = a_stripe(dtype)
    levels, coarse = np.empty((FRAMES, stripe, COLS), np.uint16), np.empty((FRAMES, stripe // 4, COLS // 4), np.uint16)
    best, peak, clipped = (np.empty((stripe, COLS), np.uint16) for _ in range(3))
    volume = Volume(levels, best, peak, clipped, coarse)
    rows, stabiliser = LogRows.make(COLS, window, np.dtype(dtype)), Stabiliser.of(CAMERA)
    once = partial(log_laplacian_block, source, window, stabiliser, lag, rows, volume)
    return least_s(once, runs) * 1000 / FRAMES * ROWS / stripe


def silhouette_ms(stripe: int, every: int) -> float:
    rows = SilhouetteRows.make(COLS, np.dtype(np.uint8))
    once = partial(silhouette_block, a_stripe(np.uint8), 0, every, 6.0, rows, Silhouette.empty((stripe, COLS)))
    return least_s(once, RUNS) * 1000 / FRAMES * ROWS / stripe


def a_stripe(dtype: type) -> Source:
    images = np.random.default_rng(1).integers(0, 256, (FRAMES, 200, COLS)).astype(dtype)
    return Source.of(images, np.arange(FRAMES), 40, 0, 250)


def camera_noise_ms() -> float:
    images = np.random.default_rng(1).normal(100, 3, (FRAMES, ROWS, COLS)).astype(np.uint8)
    frames = Frames(images, slice(0, FRAMES, 1), np.arange(FRAMES, dtype=np.float64), 250)
    return least_s(lambda: estimate_camera_noise(frames), RUNS) * 1000


def least_s(work: Callable[[], object], runs: int) -> float:
    """The least processor time of some runs: what else the machine does only adds."""
    times: list[float] = []
    for _ in range(runs):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times)


if __name__ == "__main__":
    main()
