"""Files of flat fields, named by the digest of their content, which the calibrations that use them contain."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.flat_field import FlatField
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import make_folder, os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import load_json, save_json

FOLDER = "flat-fields"
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
    return folder / FOLDER / f"{digest[:_NAME_DIGITS]}.json"
