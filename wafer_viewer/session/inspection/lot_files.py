"""Stored inspections of several wafers, read from datasets and KLARF files into one form."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.lot import WaferDefects
from wafer_viewer.session.surface.headless import is_dataset
from wafer_viewer.store.records.inspection_records import DEFECTS, read_inspection


def read_wafer_defects(path: str | Path, result: str = "default") -> WaferDefects:
    """Read the stored inspection of a wafer for statistics.

    Parameters
    ----------
    path : str or Path
        A NAME.wafer that was inspected, the ``defects.json`` of one of its results, or a KLARF file.
    result : str, default "default"
        Name of the reconstruction of a NAME.wafer.

    Returns
    -------
    WaferDefects
        Defects without nuisances, dies and inspected area. The rough bins of a KLARF are not interpreted.

    Raises
    ------
    DatasetError
        When the dataset was not inspected, or the file cannot be read.
    """
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.tables.klarf import read_klarf

    place = Path(path)
    if place.name == DEFECTS and place.exists():
        folder = place.absolute().parent
        return _of_result(folder, folder.parent.parent)
    if is_dataset(place):
        return _of_result(Dataset.open(place).result(result).path, place)
    if place.is_dir():
        raise DatasetError(f"{place} is no dataset: give a NAME.wafer that was inspected, or a KLARF file.")
    return WaferDefects.of_klarf(read_klarf(place), place.name)


def _of_result(folder: Path, dataset: Path) -> WaferDefects:
    """Return the inspection of a result, with the sample of its dataset if that is one."""
    from wafer_viewer.store.dataset.dataset import Dataset

    if (inspection := read_inspection(folder)) is None:
        raise DatasetError(f"{dataset.stem} was not inspected for defects yet: inspect it first.")
    if not is_dataset(dataset):
        return WaferDefects.of(inspection, folder.name)
    job = Dataset.open(dataset).scan.job
    return WaferDefects.of(inspection, dataset.stem, job.sample, job.alignment)
