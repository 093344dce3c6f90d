"""Compilation of the kernels before they are needed, once for a machine.

The kernels are compiled in parts, in the order in which a first scan needs them. A part is compiled by whoever needs it
first: other processes wait for its lock, load what it has compiled, or compile other parts meanwhile. A lock ends with
its process, and numba keeps every kernel as soon as it is compiled, so that nothing is lost when one is killed.
"""

from __future__ import annotations

import functools
import gc
import os
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from wafer_viewer.compute.child_process import alongside, run_in_background
from wafer_viewer.compute.messages import WarmUp
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.progress import ShouldStop, never
from wafer_viewer.numerics.kernel_cache import cache_folder, is_writable, kernel_state
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.state.snapshot import KernelProgress
from wafer_viewer.store.io.file_lock import try_lock

if TYPE_CHECKING:
    from wafer_viewer.model.surface.height_map import HeightMap

PROCESSES, NICENESS = 2, 5
"""Processes that compile, and their niceness while nobody waits for them alone."""
LOOK_EVERY_S, LOCK_EVERY_S, PATIENCE_S = 0.2, 0.05, 600.0
"""Pauses between looks at the progress and at a lock, and the longest wait for a part that another one compiles."""
TELL_EVERY_S = 20
"""Longest time without a word on a part that takes long, in s."""


@dataclass(frozen=True, slots=True)
class KernelPart:
    """Kernels that are compiled together, by making and processing a few pixels."""

    name: str
    run: Callable[[], None]

    @property
    def mark(self) -> Path:
        """File that says that the part is compiled for this state of the sources and this machine."""
        return cache_folder() / "parts" / f"{self.name.replace(' ', '-')}-{_state()}"

    @property
    def is_compiled(self) -> bool:
        """True if the kernels need only be loaded."""
        return self.mark.exists()

    def compile(self) -> None:
        """Run without the search for unused objects, which would take a tenth of the time."""
        gc.disable()
        try:
            self.run()
        finally:
            gc.enable()
            gc.collect()


@functools.cache
def _state() -> str:
    return kernel_state()


# ------------------------------------------------------------------------------------------------------- the parts


def _samples(*names: str) -> None:
    from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES, SceneWindow

    for name in names:
        SCENES[name].raster(SceneWindow(0.0, 0.0, 1.0, 2, 2))


def _frames(bits: int = 8) -> None:
    from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
    from wafer_viewer.rigs.virtual.optics.optics import Optics
    from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES

    FrameRenderer(SCENES["plane"], Optics(), Sensor(48, 64, bits=bits)).frame(0.0, 0.0, 0.0, 100.0, 1)


def _search() -> None:
    from wafer_viewer.reconstruct.field_pipeline import warm_up_search

    warm_up_search()


def _edges() -> None:
    from wafer_viewer.reconstruct.field_pipeline import warm_up_stages

    warm_up_stages()


def _heights() -> None:
    from wafer_viewer.reconstruct.field_pipeline import warm_up

    warm_up()


def _overlaps() -> None:
    from wafer_viewer.reconstruct.stitching import stitch

    stitch([_tiny_surface(_tiny_stack(x_um)) for x_um in _TINY_X_UM])


def _mosaic() -> None:
    """Write a mosaic to nowhere; it is too small for coarser levels, which are computed apart."""
    from wafer_viewer.reconstruct.blending.stitched_mosaic import coarser_levels
    from wafer_viewer.reconstruct.stitching import stitch
    from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

    height = _tiny_surface(_tiny_stack(_TINY_X_UM[0]))
    with TemporaryDirectory() as folder:
        write_mosaic(Path(folder) / "mosaic.zarr", stitch([height]))
    for _ in islice(coarser_levels(height), 3):
        pass


def _stitching() -> None:
    from wafer_viewer.reconstruct.stitching import stitch
    from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

    _overlaps()
    _mosaic()
    with TemporaryDirectory() as folder:
        write_mosaic(Path(folder) / "mosaic.zarr", stitch([_tiny_surface(_tiny_stack(x_um)) for x_um in _TINY_X_UM]))


def _deep_frames() -> None:
    import numpy as np

    from wafer_viewer.reconstruct.field_pipeline import warm_up

    warm_up(np.uint16)
    _frames(bits=16)


def _other_searches() -> None:
    """Compile the focus measures and peak estimators that a recipe can ask for."""
    import numpy as np

    from wafer_viewer.model.surface.focus_measures import BUILT_IN
    from wafer_viewer.model.surface.recipe import Recipe
    from wafer_viewer.reconstruct.field_pipeline import warm_up

    recipes = [Recipe(focus_measure=measure.name, edges="none") for measure in BUILT_IN]
    for recipe in (*recipes, Recipe(peak="argmax", edges="none"), Recipe(peak="gaussian", edges="none")):
        warm_up(np.uint8, recipe)


SIMULATION = (
    KernelPart("simulated wafers", partial(_samples, "wafer", "tour_wafer")),
    KernelPart("simulated frames", _frames),
)
HEIGHTS = (
    KernelPart("focus search", _search),
    KernelPart("edges and cleaning", _edges),
    KernelPart("heights", _heights),
)
STITCHING = (
    KernelPart("overlaps", _overlaps),
    KernelPart("mosaics", _mosaic),
    KernelPart("stitching", _stitching),
)
RARE = (
    KernelPart("frames of 16 bits", _deep_frames),
    KernelPart("other focus measures", _other_searches),
)
PARTS = (*SIMULATION, *HEIGHTS, *STITCHING, *RARE)
"""All parts: whatever else is compiled is compiled at its first use."""


# ------------------------------------------------------------------------------------------------- their compilation


def compile_parts(parts: Iterable[KernelPart]) -> None:
    """Compile parts in this process; those that others compile already come last, when they are waited for."""
    if not is_writable(cache_folder()):
        return
    todo = [part for part in parts if not part.is_compiled]
    for patience_s in (0.0, PATIENCE_S):
        for part in todo:
            with _locked(part, patience_s) as held:
                if (held or patience_s) and not part.is_compiled:
                    part.compile()
                    part.mark.touch()


@contextmanager
def _locked(part: KernelPart, patience_s: float) -> Generator[bool]:
    """Hold the lock of a part; yield False if another process held it all the time."""
    path = part.mark.with_name(f"{part.mark.name}.lock")
    path.parent.mkdir(parents=True, exist_ok=True)
    until = time.monotonic() + patience_s
    while (lock := try_lock(path)) is None and time.monotonic() < until:
        time.sleep(LOCK_EVERY_S)
    try:
        yield lock is not None
    finally:
        if lock is not None:
            lock.release()


def compile_missing(
    parts: Sequence[KernelPart] = PARTS,
    report: Callable[[KernelProgress], None] = lambda progress: print(progress.words, flush=True),
    should_stop: ShouldStop = never,
    niceness: int = 0,
) -> None:
    """Compile what this machine lacks of some parts, in processes of their own, and report the progress."""
    todo = [part for part in parts if not part.is_compiled] if is_writable(cache_folder()) else []
    n_processes, n_left = min(PROCESSES, os.cpu_count() or 1, len(todo)), len(todo) + 1
    began, told = time.monotonic(), 0
    with ExitStack() as at_end:
        work = partial(_compile_in_background, tuple(todo), niceness)
        processes = [at_end.enter_context(alongside(work)) for _ in range(n_processes)]
        while any(process.is_alive() for process in processes) and not should_stop():
            left = [part for part in todo if not part.is_compiled]
            turns = int((time.monotonic() - began) / TELL_EVERY_S)
            if left and (len(left) < n_left or turns > told):
                n_left, told = len(left), turns
                report(KernelProgress(len(todo) - n_left, len(todo), left[0].name, turns * TELL_EVERY_S))
            time.sleep(LOOK_EVERY_S)


def _compile_in_background(parts: tuple[KernelPart, ...], niceness: int) -> None:
    run_in_background(niceness)
    compile_parts(parts)


class KernelBuild:
    """Compilation that a session runs in the background; its progress is part of the snapshot."""

    def __init__(self, command_queue: CommandQueue) -> None:
        self._command_queue, self._stop = command_queue, threading.Event()
        self._thread = threading.Thread(target=self._run, name="kernels", daemon=True)

    def start(self) -> None:
        """Begin, unless everything is compiled."""
        self._thread.start()

    def close(self) -> None:
        """End the processes; what they have compiled is kept."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        compile_missing(PARTS, self._show, self._stop.is_set, NICENESS)
        self._show(None)

    def _show(self, progress: KernelProgress | None) -> None:
        if progress != self._command_queue.snapshot.kernels:
            self._command_queue.note(lambda: self._command_queue.change(kernels=progress))


# ------------------------------------------------------------------------------------------------ loading by workers


def compile_surface_kernels(should_stop: ShouldStop = never) -> None:
    """Compile what a field and a mosaic need, or wait until it is compiled."""
    compile_missing((*HEIGHTS, *STITCHING), lambda _: None, should_stop)


def load_heights() -> None:
    """Load the kernels of a field."""
    compile_parts(HEIGHTS)
    _heights()


def load_all() -> None:
    """Load the kernels of a field and of a mosaic."""
    compile_parts((*HEIGHTS, *STITCHING))
    load_kernels()
    _stitching()


def load_kernels() -> None:
    """Load the kernels of a field and of the search for overlaps without starting a thread."""
    from wafer_viewer.reconstruct.field_pipeline import reconstruct
    from wafer_viewer.reconstruct.stitching import stitch

    _heights()
    stitch([reconstruct(_tiny_stack(x_um), threads=1) for x_um in _TINY_X_UM])


WARM_UP = WarmUp(
    compile=compile_surface_kernels,
    first=load_heights,
    complete=load_all,
    loaded="wafer_viewer.session.surface.loaded_worker",
)
"""Compilation before the workers of a session start, and what they load before a scan needs it."""


_TINY_X_UM = 0.0, 40.0
"""Positions of two tiny fields that overlap."""


def _tiny_surface(stack: FieldStack) -> HeightMap:
    """Return a level surface with the picture of the middle frame."""
    import numpy as np

    from wafer_viewer.model.surface.height_map import HeightMap, Provenance

    grey = np.ascontiguousarray(stack.images[len(stack.images) // 2])
    z_um = np.zeros(grey.shape, np.float32)
    nothing, place = np.zeros(grey.shape, np.uint8), (stack.pixel_um, stack.x0_um, stack.y0_um)
    return HeightMap(z_um, z_um, np.ones_like(z_um), grey, nothing, *place, Provenance(z_step_um=1.0))


def _tiny_stack(x_um: float) -> FieldStack:
    """Return a few frames of a sample of noise, sharpest in the middle.

    The second field is a pixel and a half off its place, so that its alignment takes several steps.
    """
    import numpy as np

    noise = np.random.default_rng(1)
    sample, first = noise.normal(0, 1, (64, 66 + round(_TINY_X_UM[-1]))), round(x_um + (x_um > 0))
    seen = (sample[:, first : first + 64] + sample[:, first + (x_um > 0) : first + 64 + (x_um > 0)]) / 2
    frames = (128 + (5 + 40 * np.exp(-((k - 3) ** 2))) * seen + noise.normal(0, 1, seen.shape) for k in range(8))
    images = np.stack([frame.clip(0, 255) for frame in frames])
    return FieldStack(
        field=Field(number=1, row=0, col=0, x_um=x_um, y_um=0.0, z_start_um=0.0),
        images=images.astype(np.uint8),
        z_um=np.arange(8.0),
        present=np.ones(8, bool),
        pixel_um=1.0,
    )
