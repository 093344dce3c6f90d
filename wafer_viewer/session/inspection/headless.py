"""Defect inspection from the command line: a file or dataset is inspected in its own process."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.golden_die import GoldenDie
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.inspection.die_lattice_source import GivenDies, dies_or_why
from wafer_viewer.session.inspection.inspection_job import NOT_BY_DIES, RowHands
from wafer_viewer.session.surface.headless import LocalOrCluster, is_dataset, measured_surface
from wafer_viewer.store.dataset.dataset import Dataset

CLUSTER_PAYS_PX = 60_000_000
"""Number of pixels from which starting own worker processes is faster, despite their start-up time."""


@dataclass(frozen=True, slots=True, eq=False)
class Wafer:
    """Surface to inspect, with wafer data; center_um: centre of the wafer on the stage."""

    surface: Mosaic
    calibrated: bool
    sample: Sample = Sample()
    center_um: tuple[float, float] = (0.0, 0.0)
    job: Job | None = None
    lies_in: tuple[Path, Path] | None = None
    """Folders of its dataset and its result; None for a file."""
    before: Inspection | None = None
    """Earlier inspection, from which judgements are carried over."""


def wafer_of(src: Path, result: str) -> Wafer:
    """Return the stitched surface of a dataset, or that of a file. Raises DatasetError if there is none."""
    from wafer_viewer.store.records.inspection_records import read_inspection

    surface, calibrated = measured_surface(src, 0, result)
    if not is_dataset(src):
        return Wafer(surface, calibrated)
    data = Dataset.open(src)
    job = data.scan.job
    center_um = job.alignment.to_stage(0.0, 0.0) if job.alignment is not None else (0.0, 0.0)
    folder = data.result(result).path
    return Wafer(surface, calibrated, job.sample, center_um, job, (data.path, folder), read_inspection(folder))


def inspected(
    wafer: Wafer,
    recipe: DefectRecipe,
    given: GivenDies,
    golden: GoldenDie | None,
    against: str,
    tell: Progress,
    hire: LocalOrCluster = LocalOrCluster(),
) -> Inspection:
    """Inspect a surface for defects; the dies are given, from the job, or detected. `against` "form": without dies.

    If no dies are found, the surface is compared with the fitted form, and a note gives the reason. Raises MeasureError
    if nothing can be inspected.
    """
    from wafer_viewer.measure.defects.inspection import inspect
    from wafer_viewer.store.records.inspection_records import carry_over

    recipe_with_product = replace(recipe, product=recipe.product or wafer.sample.product)
    grid, no_dies = None, NOT_BY_DIES
    if against != "form":
        grid, no_dies = dies_or_why(lambda: dies_on(wafer, given), needed=golden is not None)
    with _rows_by(wafer, hire) as rows_by:
        inspection = inspect(
            wafer.surface,
            grid,
            recipe_with_product,
            golden,
            calibration_valid=wafer.calibrated,
            progress=tell,
            rows_by=rows_by,
            no_dies=no_dies,
        )
    return inspection if wafer.before is None else carry_over(wafer.before, inspection)


@contextmanager
def _rows_by(wafer: Wafer, hire: LocalOrCluster) -> Generator[RowHands | None]:
    """Provide the task runner for die rows; None if workers cannot read the surface themselves."""
    if wafer.lies_in is None:
        yield None
        return
    large = wafer.surface.shape[0] * wafer.surface.shape[1] >= CLUSTER_PAYS_PX
    with hire.crew(math.inf if large else 0.0) as crew:
        yield RowHands.of(crew, *wafer.lies_in)


def dies_on(wafer: Wafer, given: GivenDies) -> DieGrid:
    """Return the dies given by the operator, else those of the job, else the detected ones."""
    return given.on(wafer.surface, wafer.job).grid
