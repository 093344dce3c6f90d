"""Import of surfaces from files of this and other programs; the suffix selects the format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.file_formats import BY_SUFFIX, READ, with_suffixes
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface_format import Reading, imported
from wafer_viewer.store.formats.reader_support import ReadOptions

__all__ = ["is_surface_file", "read_surface"]

Reader = Callable[[Path, ReadOptions], HeightMap]


@with_suffixes
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
        File to read. Its suffix selects the format: ``{READ}``.
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
    options = ReadOptions(
        place.name, Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z), progress, should_stop
    )
    _require_file(place, options)
    damaged = options.refuse("cannot be read, it is damaged: copy it again.")
    # numbers beyond the range of heights are invalid
    with parser_errors_as(lambda _: damaged), np.errstate(over="ignore", invalid="ignore"):
        return read(place, options)


def is_surface_file(path: Path) -> bool:
    """Return whether the suffix is that of a surface file; a TIFF must also hold floats."""
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is None or kind.is_surface is None:
        return kind is not None
    return path.is_file() and imported(kind.is_surface)(path)


def _reader_of(path: Path) -> Reader:
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is not None and kind.reader is not None:
        return imported(kind.reader)
    if kind is not None and kind.is_mesh:
        raise DatasetError(
            f"{path.name} is a mesh, a drawing of a surface without its lattice, gaps and units: "
            "give the file it was made of, or one as X3P, GWY or PLY."
        )
    raise DatasetError(f"{path.name} has no ending of a surface file: give one of {', '.join(READ)}.")


def _require_file(path: Path, options: ReadOptions) -> None:
    if not path.exists():
        raise DatasetError(f"{path} does not exist: check the path.")
    if path.is_dir():
        raise options.refuse("is a folder: give a file.")
    if path.stat().st_size == 0:
        raise options.refuse("is empty: copy it again.")
