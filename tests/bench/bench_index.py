"""How long a dataset of very many fields takes to open, and what the session and the page make of it.

    python tests/bench/bench_index.py [--quick] [--fields N ...] [--frames N]

Made up: a scan of a square grid, field by field, with every frame in the journal and no pixels. first: opened without
an index of the journal, which it leaves; again: by a process that opened it before. Seconds are of the processor, the
least of a few runs; memory is the most of a process of its own. --quick: 1000 and 10 000 fields. A million fields of 3
frames take 2 GB of the temp folder and some minutes.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import msgspec

from tests.bench.harness import Cell, alone, peak_mb, read_options, show, took
from tests.support.plans import plan_without_motion
from wafer_viewer.gui.scenes.scene_view import acquire_contents
from wafer_viewer.gui.shell.left_panel import MapState, field_map
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Leg, PulseTrain, ScanPlan, Shot
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.dataset import scan_record
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import (
    JOURNAL,
    Finished,
    FrameKept,
    PassBegun,
    PassEnded,
    ScanRecord,
    read_record,
    write_record,
)
from wafer_viewer.store.io.checksums import sealed_line

FULL, QUICK = (10_000, 100_000), (1_000, 10_000)
FRAMES, RUNS = 10, 3
TIME = "2026-01-01T00:00:00"
HEADER = "fields | plan s | first s | open s | again s | field s | session s | scene s | map s | MB | journal MB"
T = TypeVar("T")


def main() -> None:
    asked = read_options(__doc__, fields={"type": int, "nargs": "+"}, frames=FRAMES)
    rows = [row_of(n, asked.frames) for n in asked.fields or (QUICK if asked.quick else FULL)]
    show(f"A dataset of very many fields, {asked.frames} frames each", HEADER, rows)


def row_of(n_fields: int, n_frames: int) -> list[Cell]:
    """Make a dataset and measure it in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = make(Path(folder) / "many.wafer", n_fields, n_frames)
        return [str(n_fields), *alone(measured, path), (path / JOURNAL).stat().st_size / 1e6]


def measured(path: Path) -> list[float]:
    """Seconds of the columns of `HEADER`, and MB."""
    plan_s, _ = least(lambda: as_new(read_record, path))
    first_s, _ = least(lambda: as_new(Dataset.open, path), runs=1)
    open_s, data = least(lambda: as_new(Dataset.open, path))
    again_s, _ = least(lambda: Dataset.open(path))
    field_s, _ = least(lambda: [data.field(field.number) for field in data.fields])
    queue = CommandQueue(Snapshot(data_folder=path.parent))
    library = Library(queue, path.parent)
    session_s, _ = least(lambda: library.open(path, taking=True))
    shown, view = queue.now, View(step="acquire")
    cache: Any = SimpleNamespace(available_facts=lambda sources: {})
    scene_s, _ = least(lambda: acquire_contents(cache, shown, view, None))
    map_s, _ = least(lambda: map_of(shown, view))
    return [plan_s, first_s, open_s, again_s, field_s, session_s, scene_s, map_s, peak_mb()]


def as_new(read: Callable[[Path], T], path: Path) -> T:
    """Read as a new process does, which remembers no plan."""
    scan_record._large_record.cache_clear()
    return read(path)


def map_of(shown: Snapshot, view: View) -> None:
    """Draw the map of the fields."""
    here: Any = SimpleNamespace(snapshot=shown, view=view, page=SimpleNamespace(statistics=None), own=MapState())
    field_map(here)


def least(work: Callable[[], T], runs: int = RUNS) -> tuple[float, T]:
    """The least seconds of the processor of a few runs, and what the last returned."""
    done = took(work, runs)
    return done.processor_s, done.result


def make(path: Path, n_fields: int, n_frames: int) -> Path:
    """Write the record and the journal of a scan, field by field."""
    side = round(math.sqrt(n_fields))
    grid = FieldGrid(rows=-(-n_fields // side), cols=side, field_width_um=673.0, field_height_um=505.0)
    job = Job(grid=grid, sweep=FocusSweep(z_step_um=4.0, n_frames=n_frames))
    plan = with_legs(plan_without_motion(job, (1080, 1440), 0.46729))
    path.mkdir()
    write_record(path, ScanRecord(software_version="bench", taken=TIME, simulated=True, job=job, plan=plan))
    with (path / JOURNAL).open("wb") as journal:
        for number, leg in enumerate(plan.legs):
            journal.write(b"".join(sealed_line(msgspec.json.encode(line)) + b"\n" for line in lines_of(number, leg)))
        journal.write(sealed_line(msgspec.json.encode(Finished(TIME))) + b"\n")
    return path


def with_legs(plan: ScanPlan) -> ScanPlan:
    """The plan with a motion for each field."""
    n = plan.sweep.n_frames
    train = PulseTrain(axis="z", first_count=0, counts_per_frame=40, n_frames=n, direction=1)
    legs = (
        Leg(train=train, shots=tuple(Shot(f.number, k) for k in range(n)), x_um=f.x_um, y_um=f.y_um, z_um=0.0,
            speed_um_s=100.0)
        for f in plan.fields
    )  # fmt: skip
    return replace(plan, legs=tuple(legs))


def lines_of(number: int, leg: Leg) -> list[PassBegun | FrameKept | PassEnded]:
    """The journal of a pass that kept all its frames."""
    n = leg.train.n_frames
    summary = PulseSummary(emitted=n, suppressed=0, quadrature_errors=0, exposures=n)
    frames = [
        FrameKept(shot, 40 * shot.k, leg.x_um, leg.y_um, 4.0 * shot.k, 100.0, 100_000 * number + 1000 * shot.k,
                  (7919 * shot.field + 104_729 * shot.k) % 2**32)
        for shot in leg.shots
    ]  # fmt: skip
    return [PassBegun(number, "z", n, TIME, provisional=True), *frames, PassEnded(number, summary, TIME)]


if __name__ == "__main__":
    main()
