"""How fast and how right a reconstruction is, and what a stitch costs: --quick takes under a minute.

    python tests/bench/bench_reconstruct.py [--quick]

Speed is that of one full-size field (1440 x 1080) read from a memory-mapped file, by the clock and by the processor
time of all threads, which is what counts on a busy machine. Errors are against the truth of the virtual scenes; a
height more than 4 um off is false.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.plan import Field
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.stack import FieldStack
from wafer_viewer.model.surface import HeightMap, Provenance
from wafer_viewer.reconstruct.blend import stitch
from wafer_viewer.reconstruct.field import cleaned, gated, reconstruct, warm_up
from wafer_viewer.reconstruct.focus import FOCUS_MEASURES
from wafer_viewer.reconstruct.prepare import prepare
from wafer_viewer.reconstruct.search import Search, search_field
from wafer_viewer.reconstruct.tune import settle
from wafer_viewer.reconstruct.windows import wide_heights
from wafer_viewer.rigs.virtual.optics import Optics
from wafer_viewer.rigs.virtual.scene import SCENES
from wafer_viewer.rigs.virtual.sensor import FrameRenderer, Sensor

ROWS, COLS, PIXEL_UM, FALSE_UM = 1080, 1440, 0.46729, 4.0
ORIGIN_FIELD = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description="How fast and how right a reconstruction is.")
    parser.add_argument("--quick", action="store_true", help="a short field and three scenes, under a minute")
    quick = parser.parse_args().quick
    print(f"kernels compiled or loaded: {in_seconds(spent(warm_up))}")
    with tempfile.TemporaryDirectory() as folder:
        stack = field_on_disk(Path(folder), 30 if quick else 126)
        report_measures(stack)
        report_field(stack)
    report_stitch(2 if quick else 4)
    for name in ("wafer", "stair", "plane") if quick else SCENES:
        print(accuracy(name), flush=True)


def report_measures(stack: FieldStack) -> None:
    frames = prepare(stack)
    for measure in FOCUS_MEASURES:
        search = Search(measure, 9, "blur_law", 4)
        for threads in (1, 2):
            times = least(lambda s=search, t=threads: search_field(frames, s, t))
            print(f"search {measure:10s} {threads} thread(s): {ms_a_frame(times, stack)}", flush=True)
    search = Search("tenengrad", 9, "blur_law", 4)
    peaks = search_field(frames, search)
    print(f"second window: {in_seconds(least(lambda: wide_heights(peaks, frames.z_um, search)))} a field")


def report_field(stack: FieldStack) -> None:
    frames = prepare(stack)
    settled = settle(frames, Recipe())
    print(f"settling what is auto: {in_seconds(spent(lambda: settle(frames, Recipe())))} a field")
    peaks = search_field(frames, settled.search)
    origin = gated(peaks, settled, frames)
    print(f"cleaning: {in_seconds(spent(lambda: cleaned(stack, frames, settled, peaks, origin)))} a field")
    for threads in (1, 2):
        times, own_mb = with_peak_memory(lambda t=threads: reconstruct(stack, threads=t))
        print(f"whole field, {threads} thread(s): {ms_a_frame(times, stack)}, own memory {own_mb:.0f} MB at most")


def report_stitch(side: int) -> None:
    """Fields of random height, 10 % overlap; the blend alone, as when it is written shard by shard."""
    z = np.random.default_rng(1).normal(0, 1, (ROWS, COLS)).astype(np.float32)
    maps = [
        flat_map(z, col * 0.9 * COLS * PIXEL_UM, -row * 0.9 * ROWS * PIXEL_UM)
        for row in range(side)
        for col in range(side)
    ]
    mosaic = stitch(maps)
    times = min(spent(mosaic.window) for _ in range(2))
    pixels = mosaic.shape[0] * mosaic.shape[1]
    size = f"{side} x {side} fields, {pixels / 1e6:.1f} Mpx"
    print(f"stitch of {size}: {in_seconds(times)}, {times[1] / pixels * 1e9:.0f} ns of processor time a pixel")


def accuracy(name: str) -> str:
    """One field of a scene's tour, small camera, default recipe."""
    scene = SCENES[name]
    sensor = Sensor(540, 720)
    renderer = FrameRenderer(scene, Optics(), sensor)
    (x, y), step = scene.tour_center_um, scene.tour_z_step_um
    z_um = scene.tour_z_start_um + step * np.arange(scene.tour_frames)
    images = np.stack([renderer.frame(x, y, z, sensor.nominal_exposure_us, k + 1) for k, z in enumerate(z_um)])
    field = Field(number=1, row=0, col=0, x_um=x, y_um=y, z_start_um=float(z_um[0]))
    height = reconstruct(FieldStack(field, images, z_um, np.ones(len(z_um), bool), PIXEL_UM))
    error = (height.z_raw_um - scene.truth(height.x_um[None, :], height.y_um[:, None]))[height.measured]
    right = error[np.abs(error) <= FALSE_UM]
    false, rmse = 1 - right.size / max(1, error.size), np.sqrt(np.mean(right**2))
    return (
        f"{name:12s} {step:g} um, window {height.provenance.recipe.window}: {height.measured.mean():.1%} measured, "
        f"{false:.2%} of it false, RMSE {rmse:.3f} um, median error {np.median(right):+.3f} um"
    )


def field_on_disk(folder: Path, n_frames: int) -> FieldStack:
    """A full-size stack: one rendered small field of the wafer, tiled, memory-mapped from a file."""
    scene = SCENES["wafer"]
    renderer = FrameRenderer(scene, Optics(), Sensor(ROWS // 2, COLS // 2))
    x, y = scene.tour_center_um
    z_um = -40.0 + 4.0 * np.arange(n_frames)
    images = np.lib.format.open_memmap(folder / "field.npy", "w+", np.uint8, (n_frames, ROWS, COLS))
    for k, z in enumerate(z_um):
        images[k] = np.tile(renderer.frame(x, y, min(z, 120.0), 100.0, k + 1), (2, 2))
    images.flush()
    mapped = np.load(folder / "field.npy", mmap_mode="r")
    return FieldStack(ORIGIN_FIELD, mapped, z_um, np.ones(n_frames, bool), PIXEL_UM)


def flat_map(z: NDArray[np.float32], x0_um: float, y0_um: float) -> HeightMap:
    grey, measured = np.zeros(z.shape, np.uint8), np.zeros(z.shape, np.uint8)
    return HeightMap(z, z, np.ones_like(z), grey, measured, PIXEL_UM, x0_um, y0_um, Provenance(z_step_um=4.0))


def ms_a_frame(times: tuple[float, float], stack: FieldStack) -> str:
    wall, processor = (1000 * t / stack.n_frames for t in times)
    return f"{wall:.2f} ms a frame ({processor:.2f} ms of processor time)"


def in_seconds(times: tuple[float, float]) -> str:
    return f"{times[0]:.2f} s ({times[1]:.2f} s of processor time)"


def spent(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds by the clock, and of processor time over all threads."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - processor


def least(work: Callable[[], object], runs: int = 5) -> tuple[float, float]:
    """The least seconds of some runs, by the clock and of processor time: the rest is what else the machine did."""
    wall, processor = zip(*(spent(work) for _ in range(runs)), strict=True)
    return min(wall), min(processor)


def with_peak_memory(work: Callable[[], object]) -> tuple[tuple[float, float], float]:
    """The time spent, and the most anonymous memory of the process in MB while it ran (Linux; nan elsewhere)."""
    done, most = threading.Event(), [own_memory_mb()]

    def watch() -> None:
        while not done.wait(0.02):
            most[0] = max(most[0], own_memory_mb())

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    times = spent(work)
    done.set()
    watcher.join()
    return times, most[0]


def own_memory_mb() -> float:
    if not sys.platform.startswith("linux"):
        return float("nan")
    status = Path(f"/proc/{os.getpid()}/status").read_text()
    return int(status.split("RssAnon:")[1].split()[0]) / 1024


if __name__ == "__main__":
    main()
