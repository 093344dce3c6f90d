"""What the command line does about defects: the surface of a file or a dataset inspected in its own process."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.defects import DefectRecipe, Inspection
from wafer_viewer.model.die_grid import DieGrid
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.golden import GoldenDie
from wafer_viewer.model.sample import Sample
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface import Mosaic
from wafer_viewer.session.offline import is_dataset, measured_surface
from wafer_viewer.store.dataset import Dataset


@dataclass(frozen=True, slots=True)
class GivenDies:
    """Where an operator says that the dies lie: pitch, lower left corner of die 0,0 (stage um) and size of a die.

    None: found on the surface; without a size dies are as large as their pitch.
    """

    pitch_um: tuple[float, float] | None = None
    origin_um: tuple[float, float] | None = None
    size_um: tuple[float, float] | None = None
    angle_deg: float = 0.0

    def __post_init__(self) -> None:
        if (self.pitch_um is None) != (self.origin_um is None):
            raise MeasureError("Dies are given by their pitch and the corner of one of them: give both, or neither.")
        if self.pitch_um is None and (self.size_um is not None or self.angle_deg):
            raise MeasureError("The size and the angle of dies go with their pitch and origin: give these too.")

    def on(self, surface: Mosaic) -> DieGrid | None:
        """The lattice over a surface; None where nothing was given. Raises MeasureError where none of it lies there."""
        from wafer_viewer.measure.die_grid import over

        if self.pitch_um is None or self.origin_um is None:
            return None
        width_um, height_um = self.size_um or self.pitch_um
        grid = DieGrid(
            pitch_x_um=self.pitch_um[0],
            pitch_y_um=self.pitch_um[1],
            x0_um=self.origin_um[0],
            y0_um=self.origin_um[1],
            width_um=width_um,
            height_um=height_um,
            angle_rad=math.radians(self.angle_deg),
        )
        return over(grid, surface)


@dataclass(frozen=True, slots=True, eq=False)
class Wafer:
    """The surface that is inspected, and what is known of the wafer; center_um: its centre on the stage."""

    surface: Mosaic
    calibrated: bool
    sample: Sample = Sample()
    center_um: tuple[float, float] = (0.0, 0.0)
    dies: DieGrid | None = None
    before: Inspection | None = None
    """What people said of its defects is taken over from there."""


def wafer_of(src: Path, result: str) -> Wafer:
    """The stitched surface of a dataset, or that of a file. Raises DatasetError where there is none."""
    from wafer_viewer.session.defect_work import dies_of
    from wafer_viewer.store.defects import read_inspection

    surface, calibrated = measured_surface(src, 0, result)
    if not is_dataset(src):
        return Wafer(surface, calibrated)
    data = Dataset.open(src)
    job = data.scan.job
    center_um = job.alignment.to_stage(0.0, 0.0) if job.alignment is not None else (0.0, 0.0)
    before = read_inspection(data.result(result).path)
    return Wafer(surface, calibrated, job.sample, center_um, dies_of(data), before)


def inspected(
    wafer: Wafer,
    recipe: DefectRecipe,
    given: GivenDies,
    golden: GoldenDie | None,
    against: str,
    tell: Callable[[float], None],
) -> Inspection:
    """Look for defects; the dies are those given, those of the job, or found. `against` "form": without dies.

    Raises MeasureError where nothing repeats, or nothing can be said.
    """
    from wafer_viewer.measure.defects import inspect
    from wafer_viewer.store.defects import carry_over

    known = replace(recipe, product=recipe.product or wafer.sample.product)
    grid = None if against == "form" else dies_on(wafer, given)
    found = inspect(wafer.surface, grid, known, golden, calibration_valid=wafer.calibrated, progress=tell)
    return found if wafer.before is None else carry_over(wafer.before, found)


def dies_on(wafer: Wafer, given: GivenDies) -> DieGrid:
    """The dies given by the operator, else those of the job, else as they are found."""
    from wafer_viewer.measure.die_grid import find_dies

    return given.on(wafer.surface) or wafer.dies or find_dies(wafer.surface)
