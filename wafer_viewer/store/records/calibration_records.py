"""Records of calibrations: one signed file each in a data folder, written once."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.acquisition.characteristics import CalibrationKind, CalibrationRecord
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import replace
from wafer_viewer.store.io.atomic_files import make_folder, os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import load_json, save_json
from wafer_viewer.store.records.flat_fields import write_flat_field
from wafer_viewer.store.records.gauge_records import CalibrationChange, record_change

FOLDER = "calibrations"
READ_ONLY = 0o444
"""Permissions of a record."""


def write_calibration(folder: Path, record: CalibrationRecord) -> Path:
    """Write the record of an accepted calibration, and apply its values to the rig's next scans.

    The maps of a flat field become a file of their own beside it; the record has their digest.

    Parameters
    ----------
    folder : Path
        Data folder.
    record : CalibrationRecord
        Accepted calibration.

    Returns
    -------
    Path
        File of the record.

    Raises
    ------
    DatasetError
        If the record exists or cannot be written.
    """
    day, time = record.at[:10], "".join(c for c in record.at[11:23] if c.isdigit())
    path = folder / FOLDER / f"{day}-{time}-{record.result.kind}.json"
    if path.exists():
        raise DatasetError(f"{path} exists: a record of a calibration is never written again.")
    make_folder(path.parent)
    if (flat_field := record.result.flat_field) is not None:
        write_flat_field(path.parent, flat_field, READ_ONLY)
    save_json(path, replace(record, result=replace(record.result, flat_field=None)))
    with os_errors_as_dataset_errors(path):
        path.chmod(READ_ONLY)
    if record.result.sets:
        why = record.why or f"Calibration of {record.at[:10]}: {path.name}"
        record_change(
            folder,
            CalibrationChange(
                rig=record.rig, at=record.at, by=record.signed_by, why=why, before=record.before, after=record.after
            ),
        )
    return path


def calibration_records(
    folder: Path, rig: str | None = None, kind: CalibrationKind | None = None
) -> tuple[CalibrationRecord, ...]:
    """Return the calibration records of a data folder, oldest first.

    Parameters
    ----------
    folder : Path
        Data folder.
    rig : str, optional
        Name of a rig, for its records alone.
    kind : str, optional
        Kind of calibration, such as 'delay', for its records alone.

    Returns
    -------
    tuple of CalibrationRecord
        Accepted calibrations, oldest first.

    Raises
    ------
    DatasetError
        When a record is damaged, or was changed after it was signed.
    """
    files = sorted((folder / FOLDER).glob("*.json"))
    records = (load_json(path, CalibrationRecord) for path in files)
    fit = (r for r in records if rig in (None, r.rig) and kind in (None, r.result.kind))
    return tuple(sorted(fit, key=lambda record: record.at))
