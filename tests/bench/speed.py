"""How fast a field becomes a surface, beside plain OpenCV and scikit-image in the same run.

    python tests/bench/speed.py [--quick]

A full-size field, 1080 x 1440, memory-mapped from a file: 126 frames, 12 with --quick.
Times on one thread are the least processor time of several runs, so that what else the machine does counts little;
times on two threads are by the clock.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import tempfile
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bench.harness import alone, highest, met, read_options, show, took
from tests.bench.peers import Sharpness, opencv_sharpness, skimage_sharpness
from tests.support.installation import run, sharpest_in_the_middle
from tests.support.paths import ROOT
from wafer_viewer.compute.dask_cluster import SETTINGS
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.auto_tuning import tune_recipe
from wafer_viewer.reconstruct.cleaning.clean import clean
from wafer_viewer.reconstruct.field_pipeline import reconstruct, warm_up
from wafer_viewer.reconstruct.focus.peak_search import search_field
from wafer_viewer.reconstruct.live_field import LiveField
from wafer_viewer.reconstruct.preprocess.frames import prepare
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
from wafer_viewer.rigs.virtual.optics.optics import Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES

ROWS, COLS, PIXEL_UM, WINDOW = 1080, 1440, 0.46729, 9
PLAIN_FRAMES = 4
DEFAULT_GOAL_MS, CLEANING_GOAL_S, MEMORY_GOAL_MB, THREADS_GOAL = 8.0, 0.5, 600.0, 1.7
FIRST_GOAL_S = 3.0
COPIES_GOAL = 40.0
LIVE_FRAMES, LIVE_GOAL_S = 3, 0.3


def main() -> None:
    quick = read_options(__doc__).quick
    show_first_call()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "field.npy"
        stack = field_on_disk(file, 12 if quick else 126)
        show_measures(stack, runs=1 if quick else 7)
        show_field(stack, runs=1 if quick else 5)
        show_live(file)
        show_memory(file)
    show_stitch(2 if quick else 4)


def show_first_call() -> None:
    """The first `wafer-viewer reconstruct` of a user."""
    rows: list[tuple[str | float, ...]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        images = sharpest_in_the_middle(folder / "stack.tif")
        here = (sys.executable, "-m", "wafer_viewer")
        for what in ("nothing compiled", "the same again"):
            rows.append(first_call(what, here, images, folder / "cache", PYTHONPATH=str(ROOT)))
    header = ("wafer-viewer reconstruct, 12 frames of 200 x 260, s", "clock", "processor time", "goal")
    show("First call", header, rows)


def first_call(
    what: str, command: tuple[object, ...], images: Path, cache: Path, **environment: str
) -> tuple[str | float, ...]:
    """Seconds of a reconstruction by command, from the start of its process to its end."""
    out = cache.with_suffix(".npz")
    words = (*command, "reconstruct", images, "--z-step-um", 4, "--pixel-um", 1, "-o", out)
    busy = children_s()
    called = took(lambda: run(*words, cwd=images.parent, WAFER_VIEWER_CACHE=str(cache), **environment))
    done, processor = called.result, children_s() - busy
    if done.returncode:
        raise SystemExit(done.stderr)
    out.unlink()
    return what, called.clock_s, processor, f"{FIRST_GOAL_S:g} {met(processor, FIRST_GOAL_S)}"


def children_s() -> float:
    """Processor time of the ended child processes."""
    times = os.times()
    return times.children_user + times.children_system


def show_measures(stack: FieldStack, runs: int) -> None:
    """The search with tent, confidence and all-in-focus image, all frames of a field, against plain libraries."""
    goal_ms = 1.7 if has_avx512() else 2.7
    rows: list[tuple[str | float | None, ...]] = []
    for measure in focus_measures():
        one, one_clock, two_clock = search_ms(stack, measure, runs)
        plain = [plain_ms(stack, measure, sharpness) for sharpness in (opencv_sharpness, skimage_sharpness)]
        ratios = [None if ms is None else f"{ms / one:.1f} x" for ms in plain]
        goal = goal_ms if measure in ("sml", "tenengrad", "glv") else DEFAULT_GOAL_MS
        faster = one_clock / two_clock
        rows.append((measure, one, f"{goal:g} {met(one, goal)}", two_clock, f"{faster:.2f} x", *plain, *ratios))
    header = ("measure", "1 thread", "goal", "2 threads", "faster", "OpenCV", "scikit-image", "ratio", "ratio")
    title = f"Search of a field, window {WINDOW}, tent, confidence and all-in-focus: ms a frame of 1.56 Mpx"
    show(title, header, rows)


def search_ms(stack: FieldStack, measure: str, runs: int) -> tuple[float, float, float]:
    """One thread by its processor time, one by the clock, two by the clock: the least of the runs."""
    frames = prepare(stack)
    search = tune_recipe(frames, Recipe(focus_measure=measure, window=WINDOW, peak="tent")).search
    search_field(frames, search, 1)
    clock, processor = least(lambda: search_field(frames, search, 1), runs)
    two_clock, _ = least(lambda: search_field(frames, search, 2), runs)
    return tuple(1e3 * seconds / stack.n_frames for seconds in (processor, clock, two_clock))


def plain_ms(stack: FieldStack, measure: str, sharpness_of: Callable[[str], Sharpness]) -> float | None:
    """A plain program's frame: the measure and keeping the best; None where there is no plain form or no library."""
    try:
        sharpness = sharpness_of(measure)
    except (ImportError, KeyError):
        return None
    best, frame, picture = (np.zeros((ROWS, COLS), t) for t in (np.float32, np.uint16, np.uint8))

    def one(k: int, image: NDArray[np.uint8]) -> None:
        sharp = sharpness(image)
        better = sharp > best
        np.copyto(best, sharp, where=better)
        np.copyto(frame, k, where=better)
        np.copyto(picture, image, where=better)

    images = [np.ascontiguousarray(image) for image in stack.images[:PLAIN_FRAMES]]
    return 1e3 * min(least(functools.partial(one, k, image), 2)[1] for k, image in enumerate(images))


def show_field(stack: FieldStack, runs: int) -> None:
    """The default recipe from frames to a clean surface, and its parts."""
    frames = prepare(stack)
    settling, _ = least(lambda: tune_recipe(frames, Recipe()), 1)
    settled = tune_recipe(frames, Recipe())
    height = reconstruct(stack, settled.recipe, threads=1)
    cleaning = least(lambda: clean(height.z_raw_um, PIXEL_UM, settled.recipe, settled.resolution_um), runs)[1]
    whole = least(lambda: reconstruct(stack, settled.recipe, threads=1), 2)[1]
    default, copy = in_turn(lambda: reconstruct(stack, threads=1), copy_of(stack.images), runs)
    two = least(lambda: reconstruct(stack, settled.recipe, threads=2), 2)[0]
    a_frame = 1e3 / stack.n_frames
    rows = [
        ("settling what is auto, s a field", settling, ""),
        ("cleaning, s a field", cleaning, f"{CLEANING_GOAL_S:g} {met(cleaning, CLEANING_GOAL_S)}"),
        ("all, 1 thread, in copies of the stack in memory", default / copy,
         f"{COPIES_GOAL:g} {met(default / copy, COPIES_GOAL)}"),
        ("all, settled recipe, 1 thread, ms a frame", whole * a_frame,
         f"{DEFAULT_GOAL_MS:g} {met(whole * a_frame, DEFAULT_GOAL_MS)}"),
        ("all, settled recipe, 2 threads, ms a frame", two * a_frame, ""),
    ]  # fmt: skip
    show(f"The default recipe on a field of {stack.n_frames} frames", ("", "measured", "goal"), rows)


def in_turn(work: Callable[[], object], other: Callable[[], object], runs: int) -> tuple[float, float]:
    """Least processor time of each of two works, in turn, so that a busy machine slows down both."""
    pairs = [(least(work, 1)[1], least(other, 3)[1]) for _ in range(runs)]
    return min(one for one, _ in pairs), min(two for _, two in pairs)


def copy_of(images: Image) -> Callable[[], object]:
    """Copy a stack from memory to memory, both of them touched before."""
    here = np.array(images)
    there = np.zeros_like(here)
    return lambda: np.copyto(there, here)


def show_live(file: Path) -> None:
    """A field whose frames come a few at a time: what is left to do when the last of them is there."""
    with in_a_worker() as worker:
        a_frame_s, clock, processor = worker.submit(live_s, file).result()
    rows = [
        ("while frames come, ms a frame", 1e3 * a_frame_s, "16.7, the camera's"),
        ("the map after the last frame, s of processor", processor, f"{LIVE_GOAL_S:g} {met(processor, LIVE_GOAL_S)}"),
        ("the same by the clock, all cores", clock, ""),
    ]
    show("A live field, settled recipe", ("", "measured", "goal"), rows)


@contextlib.contextmanager
def in_a_worker() -> Generator[ProcessPoolExecutor]:
    """A process with the environment of a session's workers, which keep freed memory for the next map."""
    own, given = dict(os.environ), SETTINGS["distributed.nanny.pre-spawn-environ"]
    os.environ.update({name: str(value) for name, value in given.items()})
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as worker:
            yield worker
    finally:
        os.environ.clear()
        os.environ.update(own)


def live_s(file: Path) -> tuple[float, float, float]:
    """Processor time a frame while the frames of a field come; from its last frames to its map by the clock, and that
    of the processor."""
    warm_up()
    stack = mapped(file)
    recipe = tune_recipe(prepare(stack), Recipe()).recipe
    field, taking = LiveField(stack.images, stack.z_step_um, recipe), list[float]()
    for first in range(0, stack.n_frames, LIVE_FRAMES):
        stop = min(first + LIVE_FRAMES, stack.n_frames)
        taking.append(least(functools.partial(field.take, first, stop), 1)[1] / (stop - first))
    last = LIVE_FRAMES * taking[-1]
    clock, processor = least(lambda: field.surface(stack), 5)
    return float(np.median(taking)), clock + last, processor + last


def show_memory(file: Path) -> None:
    """A worker's own memory: what is mapped from the file is the system's."""
    peak_mb = alone(peak_memory_mb, file)
    print(f"\nWorker's own memory at most: {peak_mb:.0f} MB (goal {MEMORY_GOAL_MB:g} {met(peak_mb, MEMORY_GOAL_MB)})")


def peak_memory_mb(file: Path) -> float:
    """The most anonymous memory of this process in MB while it reconstructs a field (Linux; nan elsewhere)."""
    warm_up()
    stack = mapped(file)
    with highest(every_s=0.01) as most:
        reconstruct(stack, threads=1)
    return most[0]


def show_stitch(side: int) -> None:
    """Fields of random height, 10 % overlap; the blend alone, as when it is written shard by shard."""
    z = np.random.default_rng(1).normal(0, 1, (ROWS, COLS)).astype(np.float32)
    maps = [
        flat_map(z, col * 0.9 * COLS * PIXEL_UM, -row * 0.9 * ROWS * PIXEL_UM)
        for row in range(side)
        for col in range(side)
    ]
    mosaic = stitch(maps)
    mosaic.window()
    _, seconds = least(mosaic.window, 2)
    pixels = mosaic.shape[0] * mosaic.shape[1]
    size = f"{side} x {side} fields, {pixels / 1e6:.1f} Mpx"
    print(f"Stitch of {size}: {seconds:.2f} s of processor time, {seconds / pixels * 1e9:.0f} ns a pixel")


def flat_map(z: NDArray[np.float32], x0_um: float, y0_um: float) -> HeightMap:
    grey, measured = np.zeros(z.shape, np.uint8), np.zeros(z.shape, np.uint8)
    return HeightMap(z, z, np.ones_like(z), grey, measured, PIXEL_UM, x0_um, y0_um, Provenance(z_step_um=4.0))


def field_on_disk(file: Path, n_frames: int) -> FieldStack:
    """A full-size stack of the virtual wafer, memory-mapped from a file."""
    scene = SCENES["wafer"]
    renderer = FrameRenderer(scene, Optics(), Sensor(ROWS, COLS))
    x_um, y_um = scene.tour_center_um
    images = np.lib.format.open_memmap(file, "w+", np.uint8, (n_frames, ROWS, COLS))
    for k, z_um in enumerate(heights_um(n_frames)):
        images[k] = renderer.frame(x_um, y_um, min(z_um, 120.0), 100.0, k + 1)
    images.flush()
    return mapped(file)


def mapped(file: Path) -> FieldStack:
    images = np.load(file, mmap_mode="r")
    z_um = heights_um(len(images))
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=float(z_um[0]))
    return FieldStack(field, images, z_um, np.ones(len(images), bool), PIXEL_UM)


def heights_um(n_frames: int) -> NDArray[np.float64]:
    return -40.0 + 4.0 * np.arange(n_frames)


def has_avx512() -> bool:
    cpu = Path("/proc/cpuinfo")
    return cpu.exists() and "avx512f" in cpu.read_text()


def least(work: Callable[[], object], runs: int) -> tuple[float, float]:
    """Seconds by the clock and of processor time, each the least of some runs."""
    return took(work, runs).both


if __name__ == "__main__":
    main()
