"""Where the dies of a surface lie: as an operator or a job says, laid over what is seen of them, or else found."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from wafer_viewer.model.acquisition.alignment import Alignment
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.surface.height_map import Mosaic

if TYPE_CHECKING:
    from wafer_viewer.measure.dies.given_lattice_fit import FittedDies

Evidence = Literal["height", "picture", "both"]


@dataclass(frozen=True, slots=True)
class GivenDies:
    """What an operator says of the dies: pitch, lower left corner of die 0,0 (stage um) and size, or a job's file.

    None: those of the dataset's own job, or found on the surface; without a size dies are as large as their pitch.
    as_given: they are not moved to where they are seen.
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

    def on(self, surface: Mosaic, own: Job | None = None, evidence: Evidence = "both") -> FittedDies:
        """The dies over a surface; `own`: the job that it was scanned by.

        Raises MeasureError where none lie there, PlanError for a job that cannot be read or lists its dies one by one.
        """
        from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
        from wafer_viewer.measure.dies.given_lattice_fit import FittedDies

        if self.pitch_um is not None:
            fitted = self._fitted(surface, self._lattice(), evidence)
            return FittedDies(over_surface(fitted.grid, surface), fitted.off)
        named = self._of_file(own) if self.job is not None else dies_of_job(own)
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

    def _of_file(self, own: Job | None) -> DieGrid:
        """The dies of the job's file, on a wafer that lies as the scan's own job has it."""
        from wafer_viewer.session.planning.plan_editor import read_job

        path = self.job or Path()
        job = read_job(path)
        if job.dies is None:
            raise MeasureError(f"{path.name} names no dies: give --pitch-um and --origin-um, or leave --job out.")
        if job.marks is not None and job.alignment is None:
            if own is None or own.alignment is None:
                raise MeasureError(
                    f"{path.name} has its dies in wafer um and nothing says how the wafer lies on the stage: "
                    "give --pitch-um and --origin-um instead of --job."
                )
            return DieGrid.of(job.dies, own.alignment)
        return DieGrid.of(job.dies, job.alignment or Alignment())


def dies_or_why(find: Callable[[], DieGrid], *, needed: bool) -> tuple[DieGrid | None, str]:
    """The dies that `find` answers with, or None and the reason in a few words where it finds none.

    Raises MeasureError where they are needed, as they are for a golden die.
    """
    try:
        return find(), ""
    except DiesNotFound as fault:
        if needed:
            raise MeasureError(f"A golden die needs dies. {fault} Or compare with the fitted form.") from fault
        return None, fault.brief


def dies_of_job(job: Job | None) -> DieGrid | None:
    """The dies that a scan's own job names; None where it names no lattice, or the wafer was not aligned."""
    if job is None or job.dies is None or job.dies.listed or (job.marks is not None and job.alignment is None):
        return None
    return DieGrid.of(job.dies, job.alignment or Alignment())
