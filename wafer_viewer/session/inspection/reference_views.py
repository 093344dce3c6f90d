"""Comparison views for defect review: ``session.defects.views``; pictures are made by the render process."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.surface.comparison import ComparisonFace
from wafer_viewer.session.core.commands import query
from wafer_viewer.session.rendering.render_request import (
    ComparisonRequest,
    ComparisonViews,
    DiePicture,
    Place,
    RenderRequest,
    SurfaceKey,
)

if TYPE_CHECKING:
    from wafer_viewer.model.acquisition.sample import Alignment
    from wafer_viewer.model.inspection.defect import RepeatedPlace
    from wafer_viewer.model.inspection.die_grid import DieGrid
    from wafer_viewer.model.job import Job
    from wafer_viewer.session.state.snapshot import OpenDataset, Snapshot, SurfaceInfo

T = TypeVar("T")
Box = tuple[float, float, float, float]
ROUND_A_DEFECT, LEAST_PX = 2.2, 120
"""Side of a view relative to the defect, and its minimum in pixels."""
ELONGATED, ROUND_A_SECTION, LEAST_SECTION_PX = 2.5, 5.0, 60
"""Length over width from which a defect is cut across; length of a section relative to the defect along it, and its
minimum in pixels."""
MOST_DIES = 9
"""Maximum number of dies for the median: the nearest ones, or evenly spread ones."""


@dataclass(frozen=True, slots=True)
class Earlier:
    """Earlier scan of the same wafer; at_um maps stage positions of this scan to its own.

    turn_rad: rotation of the wafer there relative to here, anticlockwise.
    """

    source: SurfaceKey
    name: str
    at_um: Callable[[float, float], tuple[float, float]]
    turn_rad: float = 0.0


class DefectViews:
    """Comparison views, available on any thread; they read the disk. Methods raise WaferViewerError on failure."""

    def __init__(
        self,
        paint: Callable[[RenderRequest], Future[bytes]],
        snapshot: Callable[[], Snapshot],
        earlier: Callable[[Snapshot, OpenDataset], Earlier | str] | None = None,
    ) -> None:
        self._paint, self._snapshot, self._earlier = paint, snapshot, earlier or earlier_scan

    @query
    def beside(self, number: int) -> Future[ComparisonViews | None]:
        """Return views of a defect, of the same position on other dies or the golden die, and in the last scan.

        The result is None if nothing was scanned there.
        """
        now = self._snapshot()
        defect, inspection = now.inspection.defect(number), now.inspection.inspection
        data, surface = now.dataset, now.surface
        if defect is None or inspection is None or data is None or surface is None:
            raise DatasetError(f"There is no defect {number}: the surface was searched again, choose another.")
        box = box_of(defect, surface.pixel_um)
        section = section_of(defect, inspection.grid, surface.pixel_um)
        like = _like(inspection, defect, box, section, self._earlier(now, data))
        return _read(
            self._paint(RenderRequest(_source(data, surface), "beside", box_um=box, like=like)), ComparisonViews
        )

    @query
    def die(self) -> Future[DiePicture | None]:
        """Return a typical die: the golden one, or the median of some completely scanned dies."""
        now = self._snapshot()
        inspection, data, surface = now.inspection.inspection, now.dataset, now.surface
        if inspection is None or data is None or surface is None:
            raise DatasetError("Nothing was inspected yet: search for defects first.")
        request = RenderRequest(_source(data, surface), "die", like=like_die(inspection))
        return _read(self._paint(request), DiePicture)

    @query
    def repeats(self, within_um: float | None = None) -> tuple[RepeatedPlace, ...]:
        """Return the positions at which at least three dies have a defect; see `wafer_viewer.repeated_places`."""
        from wafer_viewer.measure.defects.defect_builder import repeated_places

        inspection = self._snapshot().inspection.inspection
        return () if inspection is None else repeated_places(inspection, within_um)


def box_of(defect: Defect, pixel_um: float) -> Box:
    """Return the box shown for a defect, stage um: x low, y low, x high, y high."""
    x0, y0, x1, y1 = defect.outline.bounds_um
    half = max(ROUND_A_DEFECT * max(x1 - x0, y1 - y0), LEAST_PX * pixel_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half


def section_of(defect: Defect, grid: DieGrid | None, pixel_um: float) -> Box:
    """Return the ends of the section through a defect: across a long one, else along the rows of the dies."""
    major, minor = defect.major.value_um, max(defect.minor.value_um, pixel_um)
    x0, _, x1, _ = defect.outline.bounds_um
    angle, along_um = (grid.angle_rad if grid is not None else 0.0), x1 - x0
    if major > ELONGATED * minor:
        angle, along_um = math.radians(defect.angle_deg + 90), minor
        if math.cos(angle) < 0:
            angle += math.pi
    half = max(ROUND_A_SECTION * along_um, LEAST_SECTION_PX * pixel_um) / 2
    x, y, dx, dy = defect.center.x_um, defect.center.y_um, half * math.cos(angle), half * math.sin(angle)
    return x - dx, y - dy, x + dx, y + dy


def like_die(inspection: Inspection) -> ComparisonRequest:
    """Return the request for a picture of the typical die, with the dies for its median."""
    return ComparisonRequest(
        inspection.grid, None, _spread(_complete_dies(inspection)), _golden(inspection), inspection.product
    )


def _like(inspection: Inspection, defect: Defect, box: Box, section: Box, found: Earlier | str) -> ComparisonRequest:
    own_die = _place(defect.die)
    missing, before = (found, None) if isinstance(found, str) else ("", found)
    middle = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    return ComparisonRequest(
        grid=inspection.grid,
        die=own_die,
        dies=_nearest(_complete_dies(inspection), own_die),
        golden=_golden(inspection),
        product=inspection.product,
        defect_um=defect.outline.bounds_um,
        section_um=section,
        before=before.source if before is not None else None,
        before_at_um=before.at_um(*middle) if before is not None else None,
        before_turn_rad=before.turn_rad if before is not None else 0.0,
        before_name=before.name if before is not None else "",
        no_before=missing,
    )


def _place(die: str) -> Place | None:
    if not die:
        return None
    col, row = map(int, die.split(","))
    return col, row


def _complete_dies(inspection: Inspection) -> list[Place]:
    return [(die.col, die.row) for die in inspection.dies if die.state == "whole"]


def _nearest(dies: list[Place], own_die: Place | None) -> tuple[Place, ...]:
    if own_die is None:
        return ()
    others = (die for die in dies if die != own_die)
    return tuple(sorted(others, key=lambda d: ((d[0] - own_die[0]) ** 2 + (d[1] - own_die[1]) ** 2, d))[:MOST_DIES])


def _spread(dies: list[Place]) -> tuple[Place, ...]:
    n = min(len(dies), MOST_DIES)
    return tuple(dies[k * len(dies) // n] for k in range(n))


def _golden(inspection: Inspection) -> str:
    return inspection.recipe.golden if inspection.reference == "golden" else ""


def _source(data: OpenDataset, surface: SurfaceInfo) -> SurfaceKey:
    return SurfaceKey(data.path, surface.result, 0, surface.stamp)


def _read(painted: Future[bytes], kind: type[T]) -> Future[T | None]:
    """Decode the answer of the render process as `kind`; None if it is empty."""
    answer: Future[T | None] = Future()

    def take(done: Future[bytes]) -> None:
        if done.cancelled():
            answer.cancel()
        elif (fault := done.exception()) is not None:
            answer.set_exception(fault)
        else:
            data = done.result()
            answer.set_result(msgspec.msgpack.decode(data, type=kind) if data else None)

    painted.add_done_callback(take)
    return answer


def earlier_scan(now: Snapshot, data: OpenDataset) -> Earlier | str:
    """Return the last earlier scan of the same wafer with a surface; a sentence if there is none."""
    sample = data.job.sample
    if not sample.wafer_id:
        return "The sample has no wafer id: an earlier scan of it cannot be found."
    before = (entry for entry in now.datasets if entry.path != data.path and entry.taken < data.taken)
    for entry in sorted(before, key=lambda entry: entry.taken, reverse=True):
        earlier_job = _known(entry.path)
        if earlier_job is not None and _same_wafer(data.job, earlier_job):
            if (source := _compared(now, data, entry.path)) is not None:
                return Earlier(source, entry.path.stem, lambda x, y: (x, y))
            if (source := _stitched(entry.path)) is not None:
                return _earlier_at(source, entry.path.stem, data.job.alignment, earlier_job.alignment)
    return f"No earlier scan of wafer {sample.wafer_id} with a surface lies in the data folder."


def _same_wafer(job: Job, other: Job) -> bool:
    product, other_product = job.product or job.sample.product, other.product or other.sample.product
    return job.sample.wafer_id == other.sample.wafer_id and (not product or product == other_product)


def _known(path: Path) -> Job | None:
    with suppress(WaferViewerError):
        return _job_of(path)
    return None


@lru_cache(maxsize=2048)
def _job_of(path: Path) -> Job:
    from wafer_viewer.store.dataset.dataset import Dataset

    return Dataset.open(path).scan.job


def _compared(now: Snapshot, data: OpenDataset, path: Path) -> SurfaceKey | None:
    """Return the other surface as resampled for a comparison with this one, if there is one."""
    for made in now.comparisons:
        second = made.comparison.second
        if Path(second.path) == path and not second.field and not made.outdated:
            return SurfaceKey(data.path, made.name, -ComparisonFace.SECOND, made.stamp)
    return None


def _stitched(path: Path) -> SurfaceKey | None:
    found = sorted(path.glob("results/*/mosaic.zarr/zarr.json"), key=lambda header: header.stat().st_mtime_ns)
    if not found:
        return None
    return SurfaceKey(path, found[-1].parent.parent.name, 0, found[-1].stat().st_mtime_ns)


def _earlier_at(source: SurfaceKey, name: str, alignment: Alignment | None, earlier: Alignment | None) -> Earlier:
    """Return the earlier scan mapped by the alignments of both scans, or by stage coordinates if one is missing."""
    if alignment is None or earlier is None:
        return Earlier(source, name, lambda x_um, y_um: (x_um, y_um))
    turn_rad = alignment.rotation_rad - earlier.rotation_rad
    return Earlier(source, name, lambda x_um, y_um: earlier.to_stage(*alignment.to_wafer(x_um, y_um)), turn_rad)
