"""What finding defects on large mosaics takes: seconds of clock and processor, and memory, alone and on two workers.

The mosaics are made up (patterned dies with noise of their own, 2 % unmeasured, some defects), written as any other is
and kept between runs under the folder for temporary files.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tests.bench.harness import HOME, alone, met, peak_mb, show, took
from tests.truth.defects import DEPTH_UM, Plan
from tests.truth.patterned import scene_of
from tests.truth.planted import PITCH_PX, PIXEL_UM, Planted, planted
from wafer_viewer.compute.dask_cluster import client_of
from wafer_viewer.compute.task_runner import DaskRunner, LocalRunner, TaskRunner
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance, pixel_window
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene, SceneWindow
from wafer_viewer.session.inspection.inspection_job import RowHands
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic, write_mosaic

GOALS = {3_000: (6.0, 3.0), 12_850: (120.0, 3.0)}
"""Side in px: seconds, and GB of memory of all processes together."""
QUICK_PX = 1_500
NOISE_UM, SMOOTH_PX = 0.15, 3


@dataclass(frozen=True)
class MadePattern:
    """A patterned wafer of about side_px x side_px, read as any mosaic is; every window costs its pixels."""

    side_px: int
    pixel_um: float = PIXEL_UM
    levels: int = 1
    provenance: Provenance = Provenance(simulated=True)

    @property
    def plan(self) -> Plan:
        """Whole dies and a margin."""
        cols, rows = (max(3, round((self.side_px - 120) / pitch)) for pitch in PITCH_PX)
        return Plan(cols=cols, rows=rows, seed=7, defective=0.05)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.plan.shape

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0)."""
        return (0.5 - self.plan.margin_px) * PIXEL_UM

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0)."""
        return self.plan.size_um[1] + (self.plan.margin_px - 0.5) * PIXEL_UM

    @cached_property
    def planted(self) -> tuple[Planted, ...]:
        """What is wrong with it."""
        return planted(self.plan, NOISE_UM)

    @cached_property
    def scene(self) -> Scene:
        """The wafer itself."""
        return scene_of(self.plan, self.planted)

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part that holds a region."""
        whole = slice(0, self.shape[0]), slice(0, self.shape[1])
        rows, cols = whole if region is None else pixel_window(self, region, level)
        n_rows, n_cols = rows.stop - rows.start, cols.stop - cols.start
        x0_um, y0_um = self.x0_um + cols.start * PIXEL_UM, self.y0_um - rows.start * PIXEL_UM
        sheets = self.scene.raster(SceneWindow(x0_um, y0_um, PIXEL_UM, n_rows, n_cols))
        rng = np.random.default_rng((rows.start, cols.start))
        coarse = rng.standard_normal((n_rows // SMOOTH_PX + 1, n_cols // SMOOTH_PX + 1), np.float32)
        noise = NOISE_UM * np.repeat(np.repeat(coarse, SMOOTH_PX, 0), SMOOTH_PX, 1)[:n_rows, :n_cols]
        gone = np.abs(noise) > 2.326 * NOISE_UM
        z_um = np.where(gone, np.float32(np.nan), sheets.surface_um() + noise).astype(np.float32)
        grey = np.clip(255 * self.scene.gain * sheets.radiance(), 0, 255).astype(np.uint8)
        return HeightMap(
            z_um=z_um, z_raw_um=z_um, confidence=np.where(gone, np.float32(0.1), np.float32(0.9)), all_in_focus=grey,
            origin=np.where(gone, np.uint8(Origin.NO_TEXTURE), np.uint8(Origin.MEASURED)), pixel_um=PIXEL_UM,
            x0_um=x0_um, y0_um=y0_um, provenance=self.provenance,
            overlap_um=np.full(z_um.shape, np.nan, np.float32),
        )  # fmt: skip


def made_mosaic(side_px: int) -> Path:
    """A mosaic on disk, made now or kept from before."""
    HOME.mkdir(parents=True, exist_ok=True)
    path = HOME / f"patterned-{side_px}-{DEPTH_UM:g}.zarr"
    if not path.exists():
        write_mosaic(path, MadePattern(side_px))
    return path


def show_speed(quick: bool) -> None:
    """Each size in this process alone and on two workers, each time with a process of its own to lead it."""
    sizes, hands = ((QUICK_PX,), (1, 2)) if quick else (tuple(GOALS), (1, 2))
    rows = [row(side_px, made_mosaic(side_px), n) for side_px in sizes for n in hands]
    header = "mosaic | workers | dies s | defects s | clock s | processor s | leader GB | worker GB | goals"
    show("Finding dies and defects on made-up mosaics on disk", header, rows)


def row(side_px: int, path: Path, workers: int) -> tuple[str | float | int | None, ...]:
    """One line of the table; a goal is what all processes together need."""
    told = alone(measured, path, workers)
    goals = "-"
    if side_px in GOALS:
        most_s, most_gb = GOALS[side_px]
        all_gb = told["leader_gb"] + workers * told.get("worker_gb", 0.0) * (workers > 1)
        goals = f"{most_s:g} s {met(told['clock_s'], most_s)}, {most_gb:g} GB {met(all_gb, most_gb)}"
    name = f"{told['pixels'] / 1e6:.1f} Mpx, {told['dies']} dies"
    shown = ("dies_s", "defects_s", "clock_s", "processor_s", "leader_gb", "worker_gb")
    return name, ("none" if workers == 1 else workers), *(told.get(key) for key in shown), goals


def measured(path: Path, workers: int) -> dict[str, float | int]:
    """One search for dies and defects, kernels compiled before; 1: this process alone."""
    if workers == 1:
        return timed(path, LocalRunner(), list)
    with client_of(None, workers) as client:
        return timed(path, DaskRunner(client), lambda: list(client.run(spent).values()))


def timed(path: Path, crew: TaskRunner, asked: Callable[[], list[tuple[float, float]]]) -> dict[str, float | int]:
    """asked: seconds of processor and peak of memory of each worker."""
    inspected(made_mosaic(QUICK_PX), crew)
    before = [spent()[0], *(seconds for seconds, _ in asked())]
    done = took(lambda: inspected(path, crew))
    (pixels, found, dies_s), clock_s = done.result, done.clock_s
    leader, *others = [spent(), *asked()]
    told = {
        "pixels": pixels,
        "dies": len(found.dies),
        "dies_s": dies_s,
        "defects_s": clock_s - dies_s,
        "clock_s": clock_s,
        "processor_s": sum(seconds for seconds, _ in (leader, *others)) - sum(before),
        "leader_gb": leader[1],
        "defects": len(found.found),
    }
    return told | ({"worker_gb": max(gigabytes for _, gigabytes in others)} if others else {})


def inspected(path: Path, crew: TaskRunner) -> tuple[int, Inspection, float]:
    """(pixels, what was found, s that the search for dies took)."""
    from wafer_viewer.measure.defects.inspection import inspect
    from wafer_viewer.measure.dies.die_lattice import find_dies

    mosaic = ZarrMosaic.open(path)
    dies = took(lambda: find_dies(mosaic))
    return mosaic.shape[0] * mosaic.shape[1], inspect(mosaic, dies.result, rows_by=RowHands(crew, path)), dies.clock_s


def spent() -> tuple[float, float]:
    """Seconds of processor of this process so far, and the most memory it had, GB."""
    return time.process_time(), peak_mb() / 1e3
