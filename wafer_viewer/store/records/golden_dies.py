"""Golden die files, ``NAME.VERSION.golden.npz``: a JSON header and four layers; never overwritten."""

from __future__ import annotations

import os
import re
from collections.abc import Generator
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.store.io.archives import Archive, open_archive
from wafer_viewer.store.io.atomic_files import (
    make_folder,
    natural_sort_key,
    os_errors_as_dataset_errors,
    remove,
    to_disk,
)
from wafer_viewer.store.io.checksums import seal_archive

FOLDER, ENDING = "golden", ".golden.npz"
"""Folder of golden dies in the data folder, and suffix of their files."""
LAYERS = ("z_um", "z_spread_um", "picture", "picture_spread")
_NAME = re.compile(r"[\w][\w +-]*")


def save_golden(golden: GoldenDie, path: str | Path) -> Path:
    """Save a golden die as the next version of its name.

    The file is named as in ``FOLDER/NAME.3.golden.npz``; existing versions are never overwritten.

    Parameters
    ----------
    golden : GoldenDie
        Golden die to save. Name, version and software version of its header are replaced in the file, and the time if
        it is empty.
    path : str or Path
        ``FOLDER/NAME``, with or without the suffix ``.golden.npz``. The folder is made if it does not exist.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the name is invalid (letters, digits, spaces, ``+``, ``-`` and ``_`` are permitted) or belongs to another
        product, the newest version cannot be read, or the folder cannot be written to.
    MeasureError
        When the header of the newest version is invalid.
    """
    place = Path(path)
    folder, name = place.parent, place.name.removesuffix(ENDING)
    if not _NAME.fullmatch(name):
        raise DatasetError(f"A golden die cannot be called {name!r}: use letters, digits, spaces, + - and _ only.")
    versions = versions_of(folder, name)
    if versions:
        _require_product(header_of(versions[-1]), golden.header.product)
    make_folder(folder)
    return _write_next(golden, folder, name, _version(versions[-1]) + 1 if versions else 1)


def open_golden(path: str | Path) -> GoldenDie:
    """Read a golden die from a file.

    Parameters
    ----------
    path : str or Path
        The ``.golden.npz`` file.

    Returns
    -------
    GoldenDie
        Header and layers, float32 [row, col]: expected heights and their spread in um, expected image and its spread.

    Raises
    ------
    DatasetError
        When the file does not exist, is no golden die, is damaged, or its checksum differs.
    MeasureError
        When its header is invalid or its layers differ in size.
    """
    with _opened(Path(path)) as (header, archive):
        return GoldenDie(header, *(_layer(archive.array(name)) for name in LAYERS))


def header_of(path: Path) -> GoldenHeader:
    """Return the header of a golden die file. Raises DatasetError when it is none."""
    with _opened(path) as (header, _):
        return header


@contextmanager
def _opened(path: Path) -> Generator[tuple[GoldenHeader, Archive]]:
    """Yield the header and the archive of a file; any defect raises DatasetError."""
    with open_archive(path, partial(_unreadable, path)) as archive:
        yield decode(archive.text("header"), GoldenHeader, path.name, "json"), archive


def _unreadable(path: Path, fault: Exception) -> DatasetError:
    match fault:
        case FileNotFoundError():
            return DatasetError(f"{path} does not exist: check the path.")
        case KeyError():
            return DatasetError(f"{path} is not a golden die: give a file that ends in {ENDING}.")
        case _:
            return DatasetError(f"{path} cannot be read as a golden die: make it again or use an older version.")


def golden_named(folder: Path, name: str, product: str = "") -> GoldenDie:
    """Return the newest version of a golden die, or that of ``NAME.VERSION``; `product`: the required product.

    Raises
    ------
    DatasetError
        If there is none, or it is of another product.
    """
    exact = folder / f"{name}{ENDING}"
    versions = (exact,) if exact.exists() else versions_of(folder, name)
    if not versions:
        names = ", ".join(header.name for header in list_golden(folder)) or "none"
        raise DatasetError(f"There is no golden die '{name}' in {folder}: choose one that is there ({names}).")
    golden = open_golden(versions[-1])
    _require_product(golden.header, product)
    return golden


def list_golden(folder: Path) -> tuple[GoldenHeader, ...]:
    """Return the newest version of every golden die in a folder; unreadable files are ignored."""
    return tuple({header.name: header for header in reversed(every_golden(folder))}.values())


def every_golden(folder: Path) -> tuple[GoldenHeader, ...]:
    """Return all versions of all golden dies in a folder, in reverse natural order of their file names."""
    paths = sorted(folder.glob(f"*{ENDING}"), key=lambda path: natural_sort_key(path.name), reverse=True)
    return tuple(header for path in paths if (header := _readable(path)) is not None)


def _readable(path: Path) -> GoldenHeader | None:
    try:
        return header_of(path)
    except DatasetError:
        return None


def versions_of(folder: Path, name: str) -> tuple[Path, ...]:
    """Return the files of a golden die, newest last."""
    return tuple(sorted((p for p in folder.glob(f"{name}.*{ENDING}") if _version(p)), key=_version))


def _version(path: Path) -> int:
    """Return the version number in a file name, 0 without one."""
    number = path.name.removesuffix(ENDING).rpartition(".")[2]
    return int(number) if number.isdecimal() else 0


def _write_next(golden: GoldenDie, folder: Path, name: str, version: int) -> Path:
    """Write a temporary file, then link it under the next free version number."""
    temporary = folder / f".{name}.{os.getpid()}.part"
    try:
        while True:
            path = folder / f"{name}.{version}{ENDING}"
            header = _stamped(golden.header, name, version)
            with os_errors_as_dataset_errors(path), temporary.open("wb") as file:
                members: dict[str, Any] = {layer: getattr(golden, layer) for layer in LAYERS}
                np.savez_compressed(file, header=np.array(encode(header, "json")), **members)
            with os_errors_as_dataset_errors(path):
                seal_archive(temporary)
                to_disk(temporary)
            if _named(temporary, path):
                to_disk(folder)
                return path
            version += 1
    finally:
        remove(temporary)


def _stamped(header: GoldenHeader, name: str, version: int) -> GoldenHeader:
    from wafer_viewer._version import __version__

    at = header.made_at or datetime.now().isoformat(timespec="seconds")
    return replace(header, name=name, version=version, made_at=at, software_version=__version__)


def _named(temporary: Path, path: Path) -> bool:
    """Hard-link a file unless the target exists; unlike a rename, a link never overwrites."""
    try:
        with os_errors_as_dataset_errors(path):
            path.hardlink_to(temporary)
    except DatasetError as fault:
        if isinstance(fault.__cause__, FileExistsError):
            return False
        raise
    return True


def _require_product(own: GoldenHeader, product: str) -> None:
    if own.product and product and own.product != product:
        raise DatasetError(
            f"The golden die '{own.name}' is of product '{own.product}', not of '{product}': choose another name."
        )


def _layer(values: NDArray[Any]) -> NDArray[np.float32]:
    if values.ndim != 2:
        raise ValueError(f"a layer of {values.ndim} dimensions")
    return values.astype(np.float32, copy=False)
