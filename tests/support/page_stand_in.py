"""A session of maps in memory: what the scene asks a session for, without a rig, processes or files."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from tests.support import surfaces
from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, ScanPlan
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.rendering.render_pictures import paint
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey
from wafer_viewer.session.rendering.surface_source import PlacedField
from wafer_viewer.session.state.snapshot import FieldState, LatestFrame, OpenDataset, RigStatus, Snapshot, SurfaceInfo

PIXEL_UM = 0.46729
ROWS, COLS = 540, 720


def height_map(
    z_um: np.ndarray, pixel_um: float = PIXEL_UM, x0_um: float = 0.0, y0_um: float = 0.0, grey=128
) -> HeightMap:
    """A map of heights; NaN has no texture."""
    sure = np.where(np.isfinite(z_um), 0.9, 0.1).astype(np.float32)
    return surfaces.height_map(z_um, pixel_um, x0_um, y0_um, grey=grey, confidence=sure)


def _place(surface: HeightMap) -> tuple[tuple[int, int], float, float, float]:
    return surface.shape, surface.pixel_um, surface.x0_um, surface.y0_um


class MemoryShelf:
    """Surfaces by running number, 0 the stitched one."""

    def __init__(self, surfaces: dict[int, HeightMap], stacks: dict[int, FieldStack] | None = None) -> None:
        self.surfaces, self.field_stacks = surfaces, stacks or {}

    def surface(self, source: SurfaceKey) -> Mosaic:
        return self.surfaces[source.show]

    def fields(self, source: SurfaceKey) -> list[PlacedField]:
        """The fields of the stitched surface are those that stand beside it."""
        shown = [n for n in self.surfaces if n > 0 and source.show in (0, n)]
        return [PlacedField(lambda n=n: self.surfaces[n], *_place(self.surfaces[n])) for n in shown]

    def stacks(self, source: SurfaceKey) -> list[FieldStack]:
        return [self.field_stacks[source.show]] if source.show else list(self.field_stacks.values())


class StandIn:
    """Answers what SceneView asks; paints on a thread. `requested` lists the requests in order."""

    def __init__(self, shelf: MemoryShelf) -> None:
        self.shelf = shelf
        self.latest_frame: LatestFrame | None = None
        self.asked: list[RenderRequest] = []
        self._pool = ThreadPoolExecutor(1)

    def paint(self, request: RenderRequest) -> Future[bytes]:
        self.asked.append(request)
        return self._pool.submit(paint, self.shelf, request)

    def surface_source(self, show: int) -> Mosaic:
        return self.shelf.surfaces[show]

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)


def grid(rows: int = 3, cols: int = 3, x_um: float = 0.0, y_um: float = 0.0) -> FieldGrid:
    made = FieldGrid(rows=rows, cols=cols, field_width_um=COLS * PIXEL_UM, field_height_um=ROWS * PIXEL_UM)
    return made.centred_on(x_um, y_um)


def job_and_plan(of: FieldGrid, z_start_um: float = -6.0) -> tuple[Job, ScanPlan]:
    job = Job(grid=of, sweep=FocusSweep(z_step_um=1.0, n_frames=60), z_start_um=z_start_um)
    plan = replace(plan_without_motion(job, (ROWS, COLS), PIXEL_UM), strategy="z_snake", predicted_s=42.0)
    return job, plan


def snapshot_of(surface: HeightMap, plan: ScanPlan, job: Job, done: tuple[int, ...] | None = None) -> Snapshot:
    """A dataset of a plan with some of its fields measured; without a list all of them, and stitched."""
    numbers = tuple(f.number for f in plan.fields) if done is None else done
    states = {f.number: FieldState.MEASURED if f.number in numbers else FieldState.TO_COME for f in plan.fields}
    data = OpenDataset(
        path=Path("memory.wafer"),
        name="memory.wafer",
        taken="",
        simulated=True,
        calibration_problem=None,
        read_only=None,
        finished=done is None,
        fields=plan.fields,
        states=states,
        stamps=dict.fromkeys(numbers, 1),
        plan=plan,
        job=job,
        results=("default",),
    )
    low, high = np.nanpercentile(surface.z_um, [0.5, 99.5])
    info = SurfaceInfo(
        result="default",
        stamp=1,
        rows=surface.shape[0],
        cols=surface.shape[1],
        pixel_um=surface.pixel_um,
        x0_um=surface.x0_um,
        y0_um=surface.y0_um,
        levels=1,
        n_fields=len(plan.fields),
        highest_um=float(high),
        lowest_um=float(low),
        measured_fraction=1.0,
        filled_fraction=0.0,
        unmeasured=(),
        overlap_rms_um=None,
        low_um=float(low),
        high_um=float(high),
    )
    return Snapshot(rig=RigStatus(state="ready"), dataset=data, surface=info if done is None else None)
