"""What stitching a grid costs, in a process of its own: time by the clock and of the processor, and anonymous memory.

Memory is RssAnon of /proc/self/status, looked at every few milliseconds: what the process holds itself. Pages of the
height maps that the system keeps mapped and may drop at any time do not count. Kernels are compiled or loaded before.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from tests.bench.harness import alone, highest, took
from tests.bench.stitch_judge import mosaic_of
from tests.truth.field_grid import SMALL, Grid, Made, make
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.recipe import Stitching
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, blend_window
from wafer_viewer.reconstruct.focus.focus_volume import on_threads
from wafer_viewer.reconstruct.overlap_settlement import FieldsToPlace, OverlapObservers
from wafer_viewer.reconstruct.pose_graph.vertical_poses import solve_heights
from wafer_viewer.reconstruct.registration.height_seams import compare
from wafer_viewer.reconstruct.registration.pair_registration import refine, register
from wafer_viewer.reconstruct.stitching import find_poses
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

REGISTERED = Stitching(poses="registered", blend="confidence")
STORE = "blend, pyramid and store"
THREADS, WINDOW_PX, LOOK_S = 2, 1024, 0.004
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds by the clock and of the processor, and the most anonymous memory meanwhile, MB."""

    clock_s: float
    processor_s: float
    peak_mb: float


class Meter:
    """Costs by name, in the order they were met."""

    def __init__(self) -> None:
        self.costs: dict[str, Cost] = {}

    def __call__(self, name: str, work: Callable[[], T]) -> T:
        with highest(every_s=LOOK_S) as peak:
            done = took(work)
        self.costs[name] = Cost(*done.both, peak[0])
        return done.result

    def without(self, name: str, *parts: str) -> None:
        """Take the time of parts off the whole that they were measured in."""
        whole = self.costs[name]
        clock_s, processor_s = (
            getattr(whole, k) - sum(getattr(self.costs[part], k) for part in parts) for k in ("clock_s", "processor_s")
        )
        self.costs[name] = replace(whole, clock_s=clock_s, processor_s=processor_s)


def found_poses(made: Made, meter: Meter | None = None) -> Poses:
    """Poses from the overlaps, on two threads."""
    meter = meter or Meter()
    eyes = OverlapObservers(
        lambda pairs: meter("registration", lambda: register(made.heights, pairs, threads=THREADS)),
        lambda pairs, shift_um: meter("registration", lambda: refine(made.heights, pairs, shift_um, threads=THREADS)),
        lambda pairs, x_um, y_um: meter("seams", lambda: compare(made.heights, pairs, x_um, y_um, threads=THREADS)),
        made.heights.__getitem__,
    )
    numbers, marks = [f.number for f in made.fields], np.zeros(len(made.fields), np.int64)
    listed = FieldsToPlace.of(made.heights, numbers, marks, REGISTERED)
    poses = meter("poses", lambda: find_poses(listed, eyes))
    meter.without("poses", "registration", "seams")
    return poses


def with_levels(made: Made, poses: Poses) -> Poses:
    """The same places, z and tilt solved for where they are."""
    seams = compare(made.heights, made.known.grid.edges, poses.x_um, poses.y_um, threads=THREADS)
    plan = made.known.grid.plan
    size_um = plan.field_width_um, plan.field_height_um
    levels = solve_heights(poses.x_um, poses.y_um, seams, z_error_um="auto", tilt_error="auto", field_size_um=size_um)
    there = replace(poses, z_um=levels.z_um, tilt_x=levels.tilt_x, tilt_y=levels.tilt_y)
    return replace(there, seams=levels.seams, form=levels.form)


def stitched(made: Made, meter: Meter, folder: Path) -> None:
    """All that is done to a grid, as it is done to a scan."""
    poses = found_poses(made, meter)
    mosaic = meter("places", lambda: mosaic_of(made.heights, poses, "confidence"))
    meter("blend", lambda: blended(mosaic))
    meter(STORE, lambda: write_mosaic(folder / "mosaic.zarr", mosaic, threads=THREADS))


def blended(mosaic: StitchedMosaic) -> None:
    """Every window of the mosaic once, none of them kept."""

    def blend(todo: Iterator[tuple[slice, slice]]) -> None:
        for window in todo:
            blend_window(mosaic.heights, *window, mosaic.layout, mosaic.provenance)

    on_threads(blend, windows(mosaic.shape), THREADS)


def windows(shape: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    for row in range(0, shape[0], WINDOW_PX):
        for col in range(0, shape[1], WINDOW_PX):
            yield slice(row, min(row + WINDOW_PX, shape[0])), slice(col, min(col + WINDOW_PX, shape[1]))


def costs_of(grid: Grid) -> dict[str, Cost]:
    """The costs of a grid, measured in a process of its own."""
    return alone(measured, grid)


def measured(grid: Grid) -> dict[str, Cost]:
    """The costs of a grid, after a small one for which kernels are compiled or loaded."""
    for one in (replace(SMALL, rows=2, cols=2), grid):
        meter = Meter()
        with tempfile.TemporaryDirectory() as folder:
            stitched(make(one), meter, Path(folder))
    return meter.costs
