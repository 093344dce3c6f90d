"""Surfaces out of files that other programs, or this one, wrote. The ending picks the format."""

from __future__ import annotations

import struct
import tokenize
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import FORMATS, READ, Reading
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.gsf import read_gsf
from wafer_viewer.store.formats.gwy import read_gwy
from wafer_viewer.store.formats.npz_file import read_npz
from wafer_viewer.store.formats.pcd import read_pcd
from wafer_viewer.store.formats.ply import read_ply
from wafer_viewer.store.formats.reader_support import ReadOptions, require_some
from wafer_viewer.store.formats.text_table import read_table
from wafer_viewer.store.formats.tiff import is_heights, read_tiff
from wafer_viewer.store.formats.x3p import read_x3p

__all__ = ["READERS", "is_surface_file", "read_surface"]

Reader = Callable[[Path, ReadOptions], HeightMap]


def _read_npz(path: Path, asked: ReadOptions) -> HeightMap:
    surface = read_npz(path)
    require_some(asked, np.isfinite(surface.z_um))
    return surface


READERS: dict[str, Reader] = {
    ".npz": _read_npz,
    ".gwy": read_gwy,
    ".x3p": read_x3p,
    ".gsf": read_gsf,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".csv": read_table,
    ".xyz": read_table,
}
"""How a surface is read, by the ending of the file."""


DAMAGE = (OSError, ValueError, OverflowError, SyntaxError, KeyError, TypeError, struct.error, tokenize.TokenError)
"""What libraries raise where a file is damaged in a way that no reader looks for."""


def read_surface(
    path: str | Path,
    z_unit: str | None = None,
    pixel_um: float | None = None,
    invert_z: bool = False,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> HeightMap:
    """Read a surface from a file; what another program wrote has no calibration, so that its lengths are uncalibrated.

    z_unit: unit of the heights where the file says none, of all three coordinates of points; pixel_um: pixel size where
    the file says none, or the lattice to grid scattered points on; invert_z: its numbers are depths.

    Raises DatasetError, one sentence with the file, the thing and the mend, for whatever is no surface, is damaged,
    says no unit or contradicts itself.
    """
    place = Path(path)
    read = _reader_of(place)
    asked = ReadOptions(place.name, Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z), progress, should_stop)
    _require_file(place, asked)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # numbers beyond all heights are no heights
            return read(place, asked)
    except DAMAGE as fault:
        raise asked.refuse("cannot be read, it is damaged: copy it again.") from fault


def is_surface_file(path: Path) -> bool:
    """Whether a path names a surface file by its ending, be it readable or not; a TIFF only if it holds floats."""
    ending = path.suffix.lower()
    if ending in (".tif", ".tiff"):
        return path.is_file() and is_heights(path)
    return ending in FORMATS


def _reader_of(path: Path) -> Reader:
    ending = path.suffix.lower()
    if (found := READERS.get(ending)) is not None:
        return found
    if ending in FORMATS:
        raise DatasetError(
            f"{path.name} is a mesh, a drawing of a surface without its lattice, gaps and units: "
            "give the file it was made of, or one as X3P, GWY or PLY."
        )
    raise DatasetError(f"{path.name} has no ending of a surface file: give one of {', '.join(READ)}.")


def _require_file(path: Path, asked: ReadOptions) -> None:
    if not path.exists():
        raise DatasetError(f"{path} does not exist: check the path.")
    if path.is_dir():
        raise asked.refuse("is a folder: give a file.")
    if path.stat().st_size == 0:
        raise asked.refuse("is empty: copy it again.")
