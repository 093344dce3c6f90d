"""Export of defects to other programs, and storage of golden dies, for the command line and the workers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent

if TYPE_CHECKING:
    from wafer_viewer.model.inspection.defect import Inspection
    from wafer_viewer.session.inspection.headless import Wafer

Handover = Literal["klarf", "csv", "training"]


def write_klarf(wafer: Wafer, found: Inspection, path: Path) -> Path:
    """Write a KLARF 1.2 file."""
    from wafer_viewer.store.tables.klarf_writer import write_klarf

    return write_klarf(found, path, wafer.sample, center_um=wafer.center_um)


def write_csv(wafer: Wafer, found: Inspection, path: Path) -> Path:
    """Write a table for a spreadsheet."""
    from wafer_viewer.store.io.atomic_files import write_text
    from wafer_viewer.store.tables.defects_csv import defects_csv

    write_text(path, defects_csv(found))
    return path


def write_training(wafer: Wafer, found: Inspection, path: Path) -> Path:
    """Write a folder of image crops with the classes assigned by the rules and by people."""
    from wafer_viewer.store.tables.training_set import write_training_set

    return write_training_set(found, wafer.surface, path)


WRITERS: dict[Handover, Callable[[Wafer, Inspection, Path], Path]] = {
    "klarf": write_klarf,
    "csv": write_csv,
    "training": write_training,
}


def hand_over(
    dataset: Path,
    result: str,
    what: Handover,
    path: Path,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Write the stored defects of a dataset to a file or a folder, with their current judgements.

    Raises DatasetError if there are none, the format cannot hold them, or the path cannot be written to; for image
    crops also if the surface has changed since.
    """
    wafer, found = _inspected(dataset, result, same_surface=what == "training")
    return WRITERS[what](wafer, found, path)


def keep_golden(
    dataset: Path,
    result: str,
    name: str,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Store the typical die of an inspected surface as the next version of a golden die, next to the dataset.

    Raises DatasetError if this surface was not inspected, the name is invalid or another product's, or the folder
    cannot be written to; MeasureError if there are no dies, or too few of them.
    """
    from wafer_viewer.measure.defects.inspection import golden_of_surface
    from wafer_viewer.store.records.golden_dies import FOLDER, save_golden

    wafer, found = _inspected(dataset, result, same_surface=True)
    if found.grid is None:
        raise MeasureError("A golden die is made from dies and this inspection has none: inspect die to die first.")
    golden = golden_of_surface(wafer.surface, found.grid, found.recipe, product=found.product, made_of=dataset.stem)
    return save_golden(golden, dataset.parent / FOLDER / name)


def _inspected(dataset: Path, result: str, *, same_surface: bool) -> tuple[Wafer, Inspection]:
    """Return the surface and its inspection; same_surface: require that this very surface was inspected."""
    from wafer_viewer.session.inspection.headless import wafer_of
    from wafer_viewer.session.inspection.inspection_job import mosaic_mark
    from wafer_viewer.store.dataset.dataset import Dataset

    wafer = wafer_of(dataset, result)
    if (found := wafer.before) is None:
        raise DatasetError(f"{dataset.stem} was not inspected for defects yet: inspect it first.")
    if same_surface and found.mark not in ("", mosaic_mark(Dataset.open(dataset).result(result))):
        raise DatasetError(f"The surface of {dataset.stem} was reconstructed since it was inspected: inspect it again.")
    return wafer, found
