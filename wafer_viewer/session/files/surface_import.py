"""Import of a surface file as a dataset with one stitched surface, without frames and fields."""

from __future__ import annotations

import datetime
from functools import partial
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.plan import MIN_FRAMES, FieldGrid, FocusSweep, ScanPlan
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import Reading
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.core.surface_summary import save_summary, summarise
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.journal import Finished, JournalWriter
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record
from wafer_viewer.store.io.atomic_files import atomic_write

READ_SHARE = 0.4
"""Fraction of the progress bar for reading the file, during an import."""
_ANY_UM = 1.0
"""Placeholder for the z step where a plan needs a sweep and the file has none."""


def import_surface(
    src: Path,
    out: Path,
    says: Reading = Reading(),
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Import a surface file into a dataset, which appears once it is complete.

    says: values that the file does not contain. Raises DatasetError, with nothing written, for everything that
    `read_surface` refuses, for a path that exists or cannot be written to, and when the import is stopped.
    """
    from wafer_viewer.store.formats.readers import read_surface

    if out.exists():
        raise DatasetError(f"{out} exists already. Nothing was written. Choose another name.")
    read = partial(_part, progress, 0.0, READ_SHARE)
    surface = read_surface(src, says.z_unit, says.pixel_um, says.invert_z, read, should_stop)
    with atomic_write(out) as beside:
        beside.mkdir(parents=True)
        _write(beside, surface, src.name, partial(_part, progress, READ_SHARE, 1 - READ_SHARE), should_stop)
    return out


def _write(folder: Path, surface: HeightMap, source: str, progress: Progress, should_stop: ShouldStop) -> None:
    from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

    calibration, job = surface.provenance.calibration, _job(surface)
    taken = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    record = ScanRecord(
        software_version=surface.provenance.software_version,
        taken=taken,
        simulated=surface.provenance.simulated,
        imported_from=source,
        setup=OpticalSetup() if calibration is None else calibration.setup,
        calibration=calibration,
        job=job,
        plan=_plan(surface, job),
    )
    journal = JournalWriter(folder / JOURNAL)
    journal.write(Finished(taken))
    journal.close()
    write_record(folder, record)
    result = Dataset.open(folder).result(DEFAULT_RESULT)
    result.save_recipe(job.recipe)
    mosaic = write_mosaic(result.mosaic_path, surface, progress, should_stop)
    save_summary(result, summarise(mosaic, 0, DEFAULT_RESULT, job.recipe))


def _job(surface: HeightMap) -> Job:
    rows, cols = surface.shape
    x_low, y_low, x_high, y_high = surface.bounds_um
    return Job(
        grid=FieldGrid(
            rows=1,
            cols=1,
            field_width_um=cols * surface.pixel_um,
            field_height_um=rows * surface.pixel_um,
            x0_um=(x_low + x_high) / 2,
            y0_um=(y_low + y_high) / 2,
        ),
        sweep=FocusSweep(z_step_um=surface.provenance.z_step_um or _ANY_UM, n_frames=MIN_FRAMES),
        recipe=surface.provenance.recipe,
    )


def _plan(surface: HeightMap, job: Job) -> ScanPlan:
    return ScanPlan(
        fields=(),
        sweep=job.sweep,
        exposures_us=job.exposures_us,
        strategy="import",
        legs=(),
        predicted_s=0.0,
        prices=(),
        rows=surface.shape[0],
        cols=surface.shape[1],
        pixel_um=surface.pixel_um,
    )


def _part(tell: Progress, begin: float, length: float, share: float) -> None:
    tell(begin + length * share)
