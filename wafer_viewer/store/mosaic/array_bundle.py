"""Named arrays in one file, for exchange between processes: written once, read completely."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import atomic_write

Planes = Mapping[str, NDArray[Any]]


def write_planes(path: Path, planes: Planes) -> None:
    """Write arrays atomically. Raises DatasetError when the path cannot be written to."""
    with atomic_write(path) as beside, beside.open("wb") as file:
        np.savez(file, allow_pickle=False, **dict(planes))


def read_planes(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file. Raises DatasetError when it is missing or damaged."""
    try:
        with np.load(path) as members:
            return {name: members[name] for name in members.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as fault:
        raise DatasetError(f"{path} cannot be read: start the work again.") from fault
