"""The inspection for defects of a dataset, led over a crew: what is open on the disk in, what was found out."""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from wafer_viewer.compute.task_runner import LocalRunner, TaskRunner
from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.inspection.die_lattice_source import GivenDies, dies_or_why
from wafer_viewer.session.inspection.die_row_tasks import RowHands

if TYPE_CHECKING:
    from wafer_viewer.model.surface.height_map import Mosaic
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.result import Result

Against = Literal["dies", "form"]
"""Each die with the others, or with a golden one; or all of the surface with a form fitted to it."""
Dies = DieGrid | Literal["found"] | None
"""Where the dies lie: as given, as they are found on the surface, or None: as the job says, else as found."""
MARK_DIGITS = 16
NOT_BY_DIES = "As asked"


def inspect_dataset(
    dataset: Path,
    result: str,
    recipe: DefectRecipe,
    dies: Dies = None,
    against: Against = "dies",
    *,
    crew: TaskRunner | None = None,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Inspection:
    """Look for defects on the stitched surface of a dataset; nothing is kept of it.

    dies: a lattice that is given goes over all of the surface, whatever columns and rows it names. crew: who compares
    the rows of dies, this process by default; what is found is the same. Where no dies are found it is compared
    with the fitted form, and a note says why.

    Raises MeasureError where nothing can be said, DatasetError where there is no surface, ComputeError when stopped.
    """
    from wafer_viewer.measure.defects.inspection import inspect
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.records.golden_dies import FOLDER, golden_named

    data = Dataset.open(dataset)
    kept = data.result(result)
    surface, mark, job = kept.mosaic(), mosaic_mark(kept), data.scan.job
    recipe = replace(recipe, product=recipe.product or job.product or job.sample.product)
    golden = golden_named(dataset.parent / FOLDER, recipe.golden, recipe.product) if recipe.golden else None
    grid, no_dies = None, NOT_BY_DIES
    if against == "dies":
        grid, no_dies = dies_or_why(lambda: _laid(dies, data, surface), needed=golden is not None)
    with _until_stopped(should_stop):
        found = inspect(
            surface,
            grid,
            recipe,
            golden,
            calibration_valid=data.calibration_problem(today()) is None,
            progress=progress,
            should_stop=should_stop,
            rows_by=RowHands.of(crew or LocalRunner(), data.path, kept.path, should_stop),
            no_dies=no_dies,
        )
    return replace(found, mark=mark)


@contextmanager
def _until_stopped(should_stop: ShouldStop) -> Generator[None]:
    """Whatever a stopped inspection ends with, people hear one sentence of it."""
    try:
        yield
    except WaferViewerError:
        if not should_stop():
            raise
    if should_stop():
        raise ComputeError("The inspection was stopped. What was found before it is kept.")


def _laid(dies: Dies, data: Dataset, surface: Mosaic) -> DieGrid:
    """The lattice on a surface. Raises MeasureError where none is found, or the one given lies beside its dies."""
    from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
    from wafer_viewer.measure.dies.given_lattice_fit import fitted_dies

    if isinstance(dies, DieGrid):
        return over_surface(fitted_dies(surface, dies).grid, surface)
    return find_dies(surface) if dies == "found" else GivenDies().on(surface, data.scan.job).grid


def mosaic_mark(kept: Result) -> str:
    """A word that changes when the surface is made by another recipe, of other frames or fields; a copy keeps it."""
    header = kept.mosaic_path / "zarr.json"
    return hashlib.sha256(header.read_bytes()).hexdigest()[:MARK_DIGITS] if header.exists() else ""
