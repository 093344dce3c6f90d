"""Die lattice of a surface: given by an operator or a job and fitted to the visible dies, or detected."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.job import Job
from wafer_viewer.model.surface.height_map import Mosaic

if TYPE_CHECKING:
    from wafer_viewer.measure.dies.given_lattice_fit import FittedDies

Evidence = Literal["height", "picture", "both"]


@dataclass(frozen=True, slots=True)
class GivenDies:
    """Die lattice given by an operator: pitch, lower left corner of die 0,0 (stage um) and size, or a job's file.

    None: the dies of the dataset's own job, or detected on the surface; without a size dies are as large as their
    pitch. as_given: the dies are not fitted to the surface.
    """

    pitch_um: tuple[float, float] | None = None
    origin_um: tuple[float, float] | None = None
    size_um: tuple[float, float] | None = None
    angle_deg: float = 0.0
    job: Path | None = None
    as_given: bool = False

    def __post_init__(self) -> None:
        if (self.pitch_um is None) != (self.origin_um is None):
            raise MeasureError("Dies are given by their pitch and the corner of one of them: give both, or neither.")
        if self.pitch_um is None and (self.size_um is not None or self.angle_deg):
            raise MeasureError("The size and the angle of dies go with their pitch and origin: give these too.")
        if self.pitch_um is not None and self.job is not None:
            raise MeasureError("Dies are given by a job or by their pitch and origin: leave --job or --pitch-um out.")

    def on(self, surface: Mosaic, dataset_job: Job | None = None, evidence: Evidence = "both") -> FittedDies:
        """Return the dies over a surface; `dataset_job`: the job that it was scanned by.

        Raises MeasureError if there are none, PlanError for a job that cannot be read or lists its dies one by one.
        """
        from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
        from wafer_viewer.measure.dies.given_lattice_fit import FittedDies

        if self.pitch_um is not None:
            fitted = self._fitted(surface, self._lattice(), evidence)
            return FittedDies(over_surface(fitted.grid, surface), fitted.off)
        named = self._of_file(dataset_job) if self.job is not None else dies_of_job(dataset_job)
        return self._fitted(surface, named, evidence) if named else FittedDies(find_dies(surface, evidence=evidence))

    def _fitted(self, surface: Mosaic, grid: DieGrid, evidence: Evidence) -> FittedDies:
        from wafer_viewer.measure.dies.given_lattice_fit import FittedDies, fitted_dies

        return FittedDies(grid) if self.as_given else fitted_dies(surface, grid, evidence)

    def _lattice(self) -> DieGrid:
        pitch_um, origin_um = self.pitch_um or (0.0, 0.0), self.origin_um or (0.0, 0.0)
        width_um, height_um = self.size_um or pitch_um
        return DieGrid(
            pitch_x_um=pitch_um[0],
            pitch_y_um=pitch_um[1],
            x0_um=origin_um[0],
            y0_um=origin_um[1],
            width_um=width_um,
            height_um=height_um,
            angle_rad=math.radians(self.angle_deg),
        )

    def _of_file(self, dataset_job: Job | None) -> DieGrid:
        """Return the dies of the job file, with the wafer alignment of the scan's own job if the file has none."""
        from wafer_viewer.session.planning.job_releases import read_job

        path = self.job or Path()
        job = read_job(path)
        if job.dies is None:
            raise MeasureError(f"{path.name} names no dies: give --pitch-um and --origin-um, or leave --job out.")
        if job.marks is not None and job.alignment is None:
            if dataset_job is None or dataset_job.alignment is None:
                raise MeasureError(
                    f"{path.name} has its dies in wafer um and nothing says how the wafer lies on the stage: "
                    "give --pitch-um and --origin-um instead of --job."
                )
            return DieGrid.of(job.dies, dataset_job.alignment)
        return DieGrid.of(job.dies, job.alignment or Alignment())


def dies_or_why(find: Callable[[], DieGrid], *, needed: bool) -> tuple[DieGrid | None, str]:
    """Return the dies that `find` returns, or None and a short reason if it finds none.

    Raises MeasureError if dies are needed, as for a golden die.
    """
    try:
        return find(), ""
    except DiesNotFound as fault:
        if needed:
            raise MeasureError(f"A golden die needs dies. {fault} Or compare with the fitted form.") from fault
        return None, fault.brief


def dies_of_job(job: Job | None) -> DieGrid | None:
    """Return the dies named by a scan's own job; None if it has no lattice, or the wafer was not aligned."""
    if job is None or job.dies is None or job.dies.listed or (job.marks is not None and job.alignment is None):
        return None
    return DieGrid.of(job.dies, job.alignment or Alignment())
