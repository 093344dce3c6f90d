"""What a cluster of workers costs and gains: heights, overlaps and mosaic on two workers, beside one worker.

    python tests/bench/bench_workers.py [--quick]

Fields of full size, 1080 x 1440, of the virtual wafer. Heights: 12 fields of 126 frames, by one process, two bare
processes and two workers. Overlaps and mosaic: 40 fields of 12 frames, stitched as the viewer stitches them, by one
worker and by two; what their tasks take is summed for overlaps (registered, measured again, compared) and for mosaic
(patches drawn). All do the same in turn, several rounds; the least time of each counts, so that what else the machine
does counts little. Kernels are compiled and loaded before. --quick: two fields of 12 frames, once.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import psutil

from tests.bench.harness import met, read_options, show, took
from wafer_viewer.compute.crews import crew_for
from wafer_viewer.compute.dask_cluster import client_of
from wafer_viewer.compute.task_runner import DaskRunner, Done, Task, TaskRunner
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, ScanPlan, Shot
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import ShouldStop, never
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
from wafer_viewer.rigs.virtual.optics.optics import Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES
from wafer_viewer.session.surface.kernel_build import load_all
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.mosaic.poses_file import POSES

ROWS, COLS, PIXEL_UM, OVERLAP = 1080, 1440, 0.46729, 0.12
RESULT, RECIPE, WORKERS = "bench", Recipe(), 2
SPEED_UP_GOAL, OVERHEAD_GOAL_MS, N_EMPTY = 0.9, 3.0, 2000
TWICE_GOAL = 1.8
"""How many times as fast as one worker two are to be."""
MANY = 40, 12
"""Fields that are stitched, and frames of each."""
PARTS = {
    "overlaps": ("register_pairs", "refine_pairs", "compare_pairs"),
    "mosaic": ("draw_patch",),
}
Item = tuple[Path, int, str, Recipe, int]


@dataclass(frozen=True, slots=True)
class Took:
    """Seconds by the clock, and of all processors together."""

    clock_s: float
    busy_s: float

    def times(self, factor: float) -> Took:
        """As much for more of the same."""
        return Took(self.clock_s * factor, self.busy_s * factor)


def main() -> None:
    quick = read_options(__doc__).quick
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.wafer"
        n_fields, n_frames = (2, 12) if quick else (12, 126)
        make_dataset(path, n_fields, n_frames)
        items = [(path, field.number, RESULT, RECIPE, 1) for field in Dataset.open(path).fields]
        reconstruct_field(path, 1, RESULT, RECIPE)  # settles what `auto` means for all
        began = time.perf_counter()
        with crew_for(workers=WORKERS) as crew:
            first = next(crew.each(nothing, [(0,)]))
            show_start(time.perf_counter() - began, crew, first.fault is None, N_EMPTY // 20 if quick else N_EMPTY)
            show_speed_up(crew, items, rounds=1 if quick else 3)
            if not quick:
                path = Path(folder) / "many.wafer"
                make_dataset(path, *MANY)
                reconstruct_field(path, 1, RESULT, RECIPE)
                drain(crew, reconstruct_field, [(path, f.number, RESULT, RECIPE, 1) for f in Dataset.open(path).fields])
            else:
                drain(crew, reconstruct_field, items)
            show_stitching(crew, path, rounds=1 if quick else 3)


def make_dataset(path: Path, n_fields: int, n_frames: int) -> None:
    """Fields of two rows over the middle of the virtual wafer."""
    scene = SCENES["wafer"]
    size = {"field_width_um": COLS * PIXEL_UM, "field_height_um": ROWS * PIXEL_UM}
    grid = FieldGrid(rows=2, cols=n_fields // 2, overlap_x_fraction=OVERLAP, overlap_y_fraction=OVERLAP, **size)
    sweep = FocusSweep(z_step_um=4.0, n_frames=n_frames)
    job = Job(grid=grid.centred_on(*scene.tour_center_um), z_start_um=-40.0, sweep=sweep)
    about = {"exposures_us": (100.0,), "strategy": "z_up", "legs": (), "predicted_s": 1.0, "prices": ()}
    plan = ScanPlan(fields=job.all_fields(), sweep=sweep, rows=ROWS, cols=COLS, pixel_um=PIXEL_UM, **about)
    renderer = FrameRenderer(scene, Optics(), Sensor(ROWS, COLS))
    with DatasetWriter.create(path, plan, job, simulated=True) as writer:
        for field in plan.fields:
            for k in range(n_frames):
                z_um = sweep.z_um(field, k)
                image = renderer.frame(field.x_um, field.y_um, min(z_um, 120.0), 100.0, k + 1)
                at = {"x_um": field.x_um, "y_um": field.y_um, "z_um": z_um}
                about = {"exposure_us": 100.0, "device_time_us": k, "status": FrameStatus.OK}
                writer.frame(Frame(shot=Shot(field.number, k), pulse_count=k, image=image, **at, **about))


def show_start(start_s: float, crew: TaskRunner, well: bool, n_empty: int) -> None:
    """From nothing to the first answer of a worker, and what one empty task costs among many."""
    if not well:
        raise SystemExit("The workers do not answer.")
    empty = partial(drain, crew, nothing, [(i,) for i in range(n_empty)])
    clock_ms, own_ms = (1e3 * seconds / n_empty for seconds in took(empty, 3).both)
    rows = [("two workers", start_s, clock_ms, own_ms, f"{OVERHEAD_GOAL_MS:g} {met(clock_ms, OVERHEAD_GOAL_MS)}")]
    header = ("", "start, s", "an empty task, ms", "of it here", "goal")
    show("A cluster of one's own, its scheduler in this process", header, rows)


def show_speed_up(crew: TaskRunner, items: list[Item], rounds: int) -> None:
    """The same fields by one process, by two bare ones and by two workers."""
    n = len(items)
    drain(crew, warm, [()] * 2 * WORKERS)
    ways = {"one process": list[Took](), "two processes": list[Took](), "two workers": list[Took]()}
    with bare(1) as one, bare(WORKERS) as two:
        for _ in range(rounds):
            ways["one process"].append(
                taken(lambda: one.starmap(reconstruct_field, items[: n // 2], 1)).times(n / (n // 2))
            )
            ways["two processes"].append(taken(lambda: two.starmap(reconstruct_field, items, 1)))
            ways["two workers"].append(taken(lambda: drain(crew, reconstruct_field, items)))
    least = {name: Took(min(t.clock_s for t in took), min(t.busy_s for t in took)) for name, took in ways.items()}
    alone, ours, theirs = least["one process"], least["two workers"], least["two processes"]
    share, twice = theirs.clock_s / ours.clock_s, alone.clock_s / ours.clock_s
    goals = {
        "two workers": f"{share:.2f} of two processes; {SPEED_UP_GOAL} {met(share, SPEED_UP_GOAL, at_least=True)}; "
        f"{twice:.2f} of one; {TWICE_GOAL} {met(twice, TWICE_GOAL, at_least=True)}"
    }
    rows = [
        (name, took.clock_s, f"{alone.clock_s / took.clock_s:.2f} x", goals.get(name), took.busy_s)
        for name, took in least.items()
    ]
    show(f"Heights of {n} fields", ("", "clock, s", "faster", "goal", "processors, all of it, s"), rows)


def show_stitching(two: TaskRunner, path: Path, rounds: int) -> None:
    """The same fields stitched by one worker and by two, overlaps and mosaic apart."""
    with client_of(None, 1) as client:
        one = DaskRunner(client)
        for crew in (one, two):
            drain(crew, load_all, [()] * 2 * WORKERS)
        least = {name: dict.fromkeys(PARTS, float("inf")) for name in ("one worker", "two workers")}
        for _ in range(rounds):
            for name, crew in zip(least, (one, two), strict=True):
                timed = stitched(crew, path)
                for part, tasks in PARTS.items():
                    least[name][part] = min(least[name][part], sum(timed.spent_s.get(task, 0.0) for task in tasks))
    alone, both = least.values()
    rows = []
    for part in PARTS:
        twice = alone[part] / both[part]
        goal = f"{TWICE_GOAL} {met(twice, TWICE_GOAL, at_least=True)}"
        rows.append((part, alone[part], both[part], f"{twice:.2f} x", goal))
    n = len(Dataset.open(path).fields)
    show(f"Stitching of {n} fields", ("", "one worker, s", "two workers, s", "faster", "goal"), rows)


def stitched(crew: TaskRunner, path: Path) -> TimedRunner:
    """Stitch a dataset from scratch; return what its tasks took."""
    stored = Dataset.open(path).result(RESULT)
    shutil.rmtree(stored.mosaic_path, ignore_errors=True)
    (stored.path / POSES).unlink(missing_ok=True)
    timed = TimedRunner(crew)
    bring_up_to_date(path, RESULT, RECIPE, crew=timed)
    return timed


class TimedRunner:
    """A task runner that adds up the seconds by the clock that the tasks of each name take."""

    def __init__(self, crew: TaskRunner) -> None:
        self.crew, self.spent_s = crew, dict[str, float]()

    @property
    def n_slots(self) -> int:
        """See `TaskRunner`."""
        return self.crew.n_slots

    @property
    def threads_each(self) -> int | None:
        """See `TaskRunner`."""
        return self.crew.threads_each

    def require_sight(self, dataset: Path) -> None:
        """See `TaskRunner`."""
        self.crew.require_sight(dataset)

    def each(self, task: Task, items: Sequence[tuple[Any, ...]], *, should_stop: ShouldStop = never) -> Generator[Done]:
        """See `TaskRunner`."""
        began = time.perf_counter()
        yield from self.crew.each(task, items, should_stop=should_stop)
        self.spent_s[task.__name__] = self.spent_s.get(task.__name__, 0.0) + time.perf_counter() - began


def taken(work: Callable[[], object]) -> Took:
    """What a work takes by the clock, and of all processors in this process and those that it started."""
    busy_s = family_s()
    clock_s = took(work).clock_s
    return Took(clock_s, family_s() - busy_s)


def family_s() -> float:
    """Processor time of this process and of those that live under it, so far."""
    me = psutil.Process()
    times = [one.cpu_times() for one in (me, *me.children(recursive=True))]
    return sum(one.user + one.system for one in times)


@contextmanager
def bare(n_processes: int) -> Iterator[Pool]:
    """Processes that do fields and nothing else, with their kernels loaded."""
    with get_context("spawn").Pool(n_processes) as pool:
        pool.starmap(warm, [()] * 2 * n_processes, 1)
        yield pool


def drain(crew: TaskRunner, task: Callable, items: list) -> list:
    """What a crew makes of all items; the first fault is raised."""
    values = []
    for done in crew.each(task, items):
        if done.fault is not None:
            raise done.fault
        values.append(done.value)
    return values


def nothing(number: int) -> int:
    """A task that costs nothing itself."""
    return number


def warm() -> None:
    """Load the kernels."""
    load_all()


if __name__ == "__main__":
    main()
