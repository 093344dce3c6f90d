"""Golden dies as files, ``NAME.VERSION.golden.npz``: a JSON header and four layers; none is ever written over."""

from __future__ import annotations

import os
import re
import zipfile
import zlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.store.io.atomic_files import natural, remove, writing
from wafer_viewer.store.io.checksums import require_good_archive, seal_archive

FOLDER, ENDING = "golden", ".golden.npz"
"""The folder beside the datasets where they lie, and how their files end."""
LAYERS = ("z_um", "z_spread_um", "picture", "picture_spread")
_NAME = re.compile(r"[\w][\w +-]*")


def save_golden(golden: GoldenDie, path: str | Path) -> Path:
    """Keep a golden die as the next version of ``FOLDER/NAME`` and return its file, ``FOLDER/NAME.3.golden.npz`` say.

    Raises DatasetError where the name is no name or is another product's, or the folder cannot be written to.
    """
    place = Path(path)
    folder, name = place.parent, place.name.removesuffix(ENDING)
    if not _NAME.fullmatch(name):
        raise DatasetError(f"A golden die cannot be called {name!r}: use letters, digits, spaces, + - and _ only.")
    kept = versions_of(folder, name)
    if kept:
        _require_product(header_of(kept[-1]), golden.header.product)
    with writing(place):
        folder.mkdir(parents=True, exist_ok=True)
    return _write_next(golden, folder, name, _version(kept[-1]) + 1 if kept else 1)


def open_golden(path: str | Path) -> GoldenDie:
    """Read a golden die. Raises DatasetError when the file is none."""
    with _members(Path(path)) as (header, members):
        return GoldenDie(header, *(_layer(members[name]) for name in LAYERS))


def header_of(path: Path) -> GoldenHeader:
    """What a file is a golden die of. Raises DatasetError when it is none."""
    with _members(path) as (header, _):
        return header


@contextmanager
def _members(path: Path) -> Generator[tuple[GoldenHeader, Mapping[str, Any]]]:
    """The header and the arrays of a file; whatever is wrong with them becomes one sentence."""
    try:
        require_good_archive(path)
        with path.open("rb") as file, np.load(file) as members:
            yield decode(str(members["header"]), GoldenHeader, path.name, "json"), members
    except FileNotFoundError as fault:
        raise DatasetError(f"{path} does not exist: check the path.") from fault
    except KeyError as fault:
        raise DatasetError(f"{path} is not a golden die: give a file that ends in {ENDING}.") from fault
    except (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, TypeError) as fault:
        raise DatasetError(f"{path} cannot be read as a golden die: make it again or use an older version.") from fault


def golden_named(folder: Path, name: str, product: str = "") -> GoldenDie:
    """The newest version of a golden die in a folder, or that of ``NAME.VERSION``; `product`: of which it must be.

    Raises DatasetError where there is none, or it is of another product.
    """
    exact = folder / f"{name}{ENDING}"
    kept = (exact,) if exact.exists() else versions_of(folder, name)
    if not kept:
        there = ", ".join(header.name for header in list_golden(folder)) or "none"
        raise DatasetError(f"There is no golden die '{name}' in {folder}: choose one that is there ({there}).")
    golden = open_golden(kept[-1])
    _require_product(golden.header, product)
    return golden


def list_golden(folder: Path) -> tuple[GoldenHeader, ...]:
    """The newest version of every golden die in a folder, by name; files that cannot be read are left out."""
    return tuple({header.name: header for header in reversed(every_golden(folder))}.values())


def every_golden(folder: Path) -> tuple[GoldenHeader, ...]:
    """Every version of every golden die in a folder, by name from the last, the newest version first of each."""
    paths = sorted(folder.glob(f"*{ENDING}"), key=lambda path: natural(path.name), reverse=True)
    return tuple(header for path in paths if (header := _readable(path)) is not None)


def _readable(path: Path) -> GoldenHeader | None:
    try:
        return header_of(path)
    except DatasetError:
        return None


def versions_of(folder: Path, name: str) -> tuple[Path, ...]:
    """The files of a golden die, the newest last."""
    return tuple(sorted((p for p in folder.glob(f"{name}.*{ENDING}") if _version(p)), key=_version))


def _version(path: Path) -> int:
    """The number in a file's name, 0 without one."""
    number = path.name.removesuffix(ENDING).rpartition(".")[2]
    return int(number) if number.isdecimal() else 0


def _write_next(golden: GoldenDie, folder: Path, name: str, version: int) -> Path:
    """Write it whole beside, then give it its name; where another was quicker, the version after."""
    beside = folder / f".{name}.{os.getpid()}.part"
    try:
        while True:
            path = folder / f"{name}.{version}{ENDING}"
            header = _kept_now(golden.header, name, version)
            with writing(path), beside.open("wb") as file:
                members: dict[str, Any] = {layer: getattr(golden, layer) for layer in LAYERS}
                np.savez_compressed(file, header=np.array(encode(header, "json")), **members)
            with writing(path):
                seal_archive(beside)
            if _named(beside, path):
                return path
            version += 1
    finally:
        remove(beside)


def _kept_now(header: GoldenHeader, name: str, version: int) -> GoldenHeader:
    from wafer_viewer._version import __version__

    at = header.made_at or datetime.now().isoformat(timespec="seconds")
    return replace(header, name=name, version=version, made_at=at, software_version=__version__)


def _named(beside: Path, path: Path) -> bool:
    """Give a file its name unless that is taken: a link never goes over what is there, a renaming does."""
    try:
        with writing(path):
            path.hardlink_to(beside)
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
