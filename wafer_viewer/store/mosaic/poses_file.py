"""Poses of a result on disk, and named arrays in one file for exchange between processes."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, Poses, Shifts, unknown_bend
from wafer_viewer.store.io.archives import Archive, open_archive
from wafer_viewer.store.io.atomic_files import atomic_write
from wafer_viewer.store.io.checksums import remedy, seal_archive

POSES = "poses.npz"
"""File name in the folder of a result."""
PLACES = (
    *("stage_x_um", "stage_y_um", "x_um", "y_um", "z_um", "tilt_x", "tilt_y"),
    *("u_x_um", "u_y_um", "u_z_um"),
)
_TABLES: dict[str, type[Any]] = {"shifts": Shifts, "seams": HeightOffsets, "form": Form}


def write_poses(poses: Poses, path: Path) -> None:
    """Save poses, replacing earlier ones."""
    with atomic_write(path) as temporary:
        with temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **_flat(poses, ""))
        seal_archive(temporary)


def read_poses(path: Path) -> Poses:
    """Read poses. Raises DatasetError when the file is damaged."""
    refusal = DatasetError(f"{path} holds no poses that can be read: {remedy(path)}.")
    with open_archive(path, lambda _: refusal) as archive:
        tables = {name: _built(kind, archive, f"{name}.") for name, kind in _TABLES.items()}
        return _built(Poses, archive, "", **tables)


def write_poses_csv(poses: Poses, path: Path) -> None:
    """Write one line per field: stage position, pose and standard uncertainty (k = 1); um and um per um.

    The last column is the probability of the chosen period, empty where no pattern repeats. Raises DatasetError when
    the path cannot be written to.
    """
    columns = ("numbers", *PLACES, "group", "left_out", "period_probability")
    lines = zip(*(getattr(poses, name).tolist() for name in columns), strict=True)
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("field", *PLACES, "group", "left_out", "period_probability"))
        table.writerows(
            (
                *(number, *(f"{v:.6g}" if abs(v) < 1 else f"{v:.4f}" for v in place), group, int(left_out)),
                "" if math.isnan(sure) else f"{sure:.4f}",
            )
            for number, *place, group, left_out, sure in lines
        )


def _flat(table: Any, prefix: str) -> dict[str, Any]:
    """Return each attribute of a table by name, those of nested tables with a prefix."""
    flat: dict[str, Any] = {}
    for item in dataclasses.fields(table):
        value = getattr(table, item.name)
        flat |= _flat(value, f"{prefix}{item.name}.") if item.name in _TABLES else {prefix + item.name: _array(value)}
    return flat


def _array(value: Any) -> Any:
    return np.asarray(value, dtype=str) if isinstance(value, tuple) and not value else np.asarray(value)


def _built(kind: type[Any], archive: Archive, prefix: str, **given: Any) -> Any:
    """Build a table from its arrays, with the declared types; terms that an older form lacks have their default."""
    values = dict(given)
    if kind is Shifts and f"{prefix}bend" not in archive:  # of an older version
        values["bend"] = unknown_bend(len(archive.array(f"{prefix}first")))
    for item in dataclasses.fields(kind):
        key = prefix + item.name
        if item.name not in values and (key in archive or kind is not Form):
            values[item.name] = _value(archive.array(key), str(item.type))
    return kind(**values)


def _value(array: Any, declared: str) -> Any:
    if declared.startswith("tuple"):
        return tuple(array.tolist())
    return array.item() if declared in ("float", "bool") else array


Planes = Mapping[str, NDArray[Any]]


def write_planes(path: Path, planes: Planes) -> None:
    """Write arrays atomically. Raises DatasetError when the path cannot be written to."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **dict(planes))


def read_planes(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file. Raises DatasetError when it is missing or damaged."""
    refusal = DatasetError(f"{path} cannot be read: start the work again.")
    with open_archive(path, lambda _: refusal, verify=False) as archive:
        return {name: archive.array(name) for name in archive.names}
