"""Defect inspection of a dataset on a task runner: reads the dataset, returns the inspection."""

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
"""Reference of the comparison: the other dies or a golden die, or a form fitted to the surface."""
Dies = DieGrid | Literal["found"] | None
"""Source of the die lattice: a given one, detected on the surface, or None: the job's, else detected."""
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
    """Inspect the stitched surface of a dataset for defects; nothing is stored.

    dies: a given lattice covers the full surface, whatever columns and rows it names. crew: runner of the die rows,
    this process by default; the outcome is the same. If no dies are found, the surface is compared with the fitted
    form, and a note gives the reason.

    Raises MeasureError if nothing can be inspected, DatasetError if there is no surface, ComputeError when stopped.
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
    """Raise one ComputeError for a stopped inspection, whatever error it ended with."""
    try:
        yield
    except WaferViewerError:
        if not should_stop():
            raise
    if should_stop():
        raise ComputeError("The inspection was stopped. What was found before it is kept.")


def _laid(dies: Dies, data: Dataset, surface: Mosaic) -> DieGrid:
    """Return the lattice on a surface.

    Raises MeasureError if none is found, or the given one does not match its dies.
    """
    from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
    from wafer_viewer.measure.dies.given_lattice_fit import fitted_dies

    if isinstance(dies, DieGrid):
        return over_surface(fitted_dies(surface, dies).grid, surface)
    return find_dies(surface) if dies == "found" else GivenDies().on(surface, data.scan.job).grid


def mosaic_mark(kept: Result) -> str:
    """Return a hash of the mosaic's metadata, which changes with recipe, frames or fields; a copy has the same one."""
    header = kept.mosaic_path / "zarr.json"
    return hashlib.sha256(header.read_bytes()).hexdigest()[:MARK_DIGITS] if header.exists() else ""
