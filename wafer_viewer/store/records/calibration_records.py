"""Records of calibrations: one signed file each in a data folder, written once.

The newest change applies to the rig's next scans, unless the rig itself has a newer calibration.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import ClassVar

from wafer_viewer.model.acquisition.calibration import Calibration, FlatField
from wafer_viewer.model.acquisition.characteristics import CalibrationKind, CalibrationRecord
from wafer_viewer.model.errors import DatasetError, MeasureError, WaferViewerError
from wafer_viewer.model.gauge import Certificate, GaugeRecord
from wafer_viewer.model.spec import Spec, decode, replace
from wafer_viewer.store.io.atomic_files import make_folder, os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import load_json, save_json
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.records.dcc_certificate import certificate_of_dcc
from wafer_viewer.store.records.signed_log import append_record, read_log

# -------------------------------------------------------------------------------------------------------- gauge records


CALIBRATIONS = "calibrations.jsonl"


class CalibrationChange(Spec, frozen=True, kw_only=True):
    """One line: calibration of a rig before and after a change; at: ISO 8601."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    rig: str
    at: str
    by: str
    why: str
    before: Calibration
    after: Calibration


def record_change(folder: Path, change: CalibrationChange) -> None:
    """Append a calibration that applies to the rig's next scans."""
    append_record(folder / CALIBRATIONS, change)


def calibration_changes(folder: Path, rig: str) -> tuple[CalibrationChange, ...]:
    """Return the calibration changes of a rig, oldest first. Raises DatasetError for a damaged or altered log."""
    return tuple(change for change in read_log(folder / CALIBRATIONS, CalibrationChange).records if change.rig == rig)


def calibration_in_force(folder: Path, rig: str, own: Calibration | None) -> Calibration | None:
    """Return the calibration for the next scan of a rig into a data folder; own: that of the rig itself."""
    if own is None:
        return None
    fit = [c.after for c in calibration_changes(folder, rig) if c.after.setup == own.setup and c.after.made >= own.made]
    return fit[-1] if fit else own


def read_certificate(path: Path, *, expires: datetime.date | None = None, blocks: Sequence[str] = ()) -> Certificate:
    """Read the calibration certificate of gauge blocks.

    Parameters
    ----------
    path : Path
        TOML file with the fields of `Certificate`, lengths in um at 20 C; or XML file of the laboratory, a digital
        calibration certificate (DCC [3]_), whose lengths, U, k and serial numbers are taken.
    expires : datetime.date, optional
        Last day of a DCC, which need not state one. Default None: by the interval that it states.
    blocks : sequence of str, optional
        Serial numbers of the two blocks of a DCC with more. Default (): the file has two blocks, or a step.

    Returns
    -------
    Certificate
        Certified step, or two blocks, with expanded uncertainty (k = 2).

    Raises
    ------
    MeasureError
        When the file cannot be read, is no valid TOML or DCC, has an unknown or invalid field, or lacks data that a
        check needs; of a DCC the element is named.

    References
    ----------
    .. [1] ISO 3650, Geometrical Product Specifications (GPS) - Length standards - Gauge blocks.
    .. [2] ISO 1, Geometrical product specifications (GPS) - Standard reference temperature for the specification of
       geometrical and dimensional properties.
    .. [3] Physikalisch-Technische Bundesanstalt, Digital Calibration Certificate, https://www.ptb.de/dcc.
    """
    if path.suffix.lower() == ".xml":
        return certificate_of_dcc(read_content(path, MeasureError), path.name, expires, blocks)
    return decode(read_content(path, MeasureError), Certificate, path.name)


GAUGE_LOG = "gauge-checks.jsonl"


def sign(folder: Path, record: GaugeRecord) -> None:
    """Append a signed check to the log of a data folder."""
    append_record(folder / GAUGE_LOG, record)


def signed_checks(folder: Path, serials: Iterable[str] = ()) -> tuple[GaugeRecord, ...]:
    """Return the signed checks of a data folder, oldest first, optionally for one set of serial numbers.

    Raises DatasetError when a line of the log is damaged, or the log was altered.
    """
    wanted = set(serials)
    records = read_log(folder / GAUGE_LOG, GaugeRecord).records
    return tuple(r for r in records if not wanted or set(r.check.certificate.serials) == wanted)


# ---------------------------------------------------------------------------------------------------------- flat fields


FLAT_FIELDS = "flat-fields"
"""Folder beside the records of the calibrations."""
_NAME_DIGITS = 16


def write_flat_field(folder: Path, flat_field: FlatField, permissions: int) -> Path:
    """Write a flat field into the folder of the calibrations; one with the same content stays as it is."""
    path = _path(folder, flat_field.digest)
    if not path.exists():
        make_folder(path.parent)
        save_json(path, flat_field)
        with os_errors_as_dataset_errors(path):
            path.chmod(permissions)
    return path


def flat_field_in_force(folder: Path, calibration: Calibration | None) -> FlatField | None:
    """Return the flat field that a calibration names, from the folder of the calibrations; None without one.

    Raises DatasetError when its file is missing or has another content.
    """
    digest = None if calibration is None else calibration.flat_field_digest
    return None if digest is None else read_flat_field(_path(folder, digest), digest)


def read_flat_field(path: Path, digest: str) -> FlatField:
    """Read a flat field. Raises DatasetError when it is missing, damaged or not the one of the digest."""
    if not path.exists():
        raise DatasetError(f"{path}, the flat field of the calibration, is missing: restore it from a copy.")
    found = load_json(path, FlatField)
    if found.digest != digest:
        raise DatasetError(
            f"{path} was changed: its content is not that of the calibration, whose flat field is {digest[:8]}. "
            "Restore it from a copy."
        )
    return found


def _path(folder: Path, digest: str) -> Path:
    return folder / FLAT_FIELDS / f"{digest[:_NAME_DIGITS]}.json"


# -------------------------------------------------------------------------------------------------- calibration records


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
