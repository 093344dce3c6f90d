"""Import of surfaces from files of this and other programs; the suffix selects the format."""

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
"""Surface readers by file suffix."""


DAMAGE = (OSError, ValueError, OverflowError, SyntaxError, KeyError, TypeError, struct.error, tokenize.TokenError)
"""Exceptions that libraries raise for damage that no reader checks for."""


def read_surface(
    path: str | Path,
    z_unit: str | None = None,
    pixel_um: float | None = None,
    invert_z: bool = False,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> HeightMap:
    """Read a surface from a file in the format given by its suffix.

    Lengths from other programs are uncalibrated.

    Parameters
    ----------
    path : str or Path
        File to read: ``.npz``, ``.gwy``, ``.x3p``, ``.gsf``, ``.tif``, ``.tiff``, ``.ply``, ``.pcd``, ``.csv`` or
        ``.xyz``.
    z_unit : str, optional
        Unit of the heights if the file states none (m, cm, mm, um, nm, pm or inch), for points of all three
        coordinates.
    pixel_um : float, optional
        Pixel size in um if the file states none, or the lattice pitch for scattered points.
    invert_z : bool, default False
        The values are depths: their sign is inverted.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.

    Returns
    -------
    HeightMap
        Heights in um; see `HeightMap`.

    Raises
    ------
    DatasetError
        With one sentence on the file, the cause and the remedy: when the file does not exist, is no surface, is a mesh,
        is damaged, holds no height, states no unit or no pixel size and none is given, contradicts itself or the given
        values, or the work is stopped.
    WaferViewerError
        When the provenance in an ``.npz`` is invalid.

    Notes
    -----
    The files that `export` writes can be read, except meshes (``.stl``, ``.obj``, ``.glb``). For an ``.npz``, `z_unit`,
    `pixel_um` and `invert_z` have no effect. A surface of heights only has confidence 1 and a black all-in-focus image.

    References
    ----------
    .. [1] ISO 25178-72, Geometrical product specifications (GPS) - Surface texture: Areal - Part 72: XML file format
       x3p.
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
    """Return whether the suffix is that of a surface file; a TIFF must also hold floats."""
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
