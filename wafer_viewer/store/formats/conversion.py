"""Import and export of surfaces by suffix; `SurfaceFormat` states what each format loses.

Every format that can hold text states whether the data are simulated or uncalibrated.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.file_formats import (
    BY_SUFFIX,
    MESH_POINTS,
    READ,
    WRITTEN,
    every_for,
    format_of,
    suffix_of,
    with_suffixes,
)
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, PartOfMosaic
from wafer_viewer.model.surface_format import Reading, Table, imported
from wafer_viewer.store.formats.reader_support import ReadOptions, caveats
from wafer_viewer.store.formats.surface_strips import Strips
from wafer_viewer.store.io.atomic_files import atomic_write
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

__all__ = ["caveats", "export", "is_surface_file", "losses", "read_surface", "require_format", "write_surface"]

# -------------------------------------------------------------------------------------------------------------- readers


Reader = Callable[[Path, ReadOptions], HeightMap]


def read_surface(
    path: str | Path,
    z_unit: str | None = None,
    pixel_um: float | None = None,
    invert_z: bool = False,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    *,
    table: Table = None,
) -> HeightMap:
    """Read a surface from a file in the format given by its suffix; `wafer_viewer.read_surface` documents it."""
    place = Path(path)
    says = Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z, table=table)
    options = ReadOptions(place.name, says, progress, should_stop)
    read = _reader_of(place, options)
    _require_file(place, options)
    damaged = options.refuse("cannot be read, it is damaged: copy it again.")
    # numbers beyond the range of heights are invalid
    with parser_errors_as(lambda _: damaged), np.errstate(over="ignore", invalid="ignore"):
        return read(place, options)


def is_surface_file(path: Path) -> bool:
    """Return whether a file is a surface by its first bytes, or else its suffix; a TIFF must also hold floats."""
    kind = format_of(suffix_of(path), _head(path))
    if kind is None or kind.is_surface is None:
        return kind is not None
    return path.is_file() and imported(kind.is_surface)(path)


def _head(path: Path) -> bytes:
    """Return the first bytes of a file; none if it cannot be read."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(_HEAD_BYTES)
    return b""


_HEAD_BYTES = 64


def _reader_of(path: Path, options: ReadOptions) -> Reader:
    """Return the reader by the first bytes of a file, or else its suffix; a note tells if the two contradict."""
    kind = format_of(suffix_of(path), _head(path))
    if kind is not None and kind is not BY_SUFFIX.get(suffix_of(path)):
        options.notes.append(f"Its content and not its ending told its format: {kind.title}.")
    if kind is not None and kind.reader is not None:
        return imported(kind.reader)
    raise DatasetError(f"{path.name} has no ending of a surface file: give one of {', '.join(READ)}.")


def _require_file(path: Path, options: ReadOptions) -> None:
    if not path.exists():
        raise DatasetError(f"{path} does not exist: check the path.")
    if path.is_dir():
        raise options.refuse("is a folder: give a file.")
    if path.stat().st_size == 0:
        raise options.refuse("is empty: copy it again.")


# ------------------------------------------------------------------------------------------------------------ exporters


Writer = Callable[[Strips, Path], None]


@with_suffixes
def export(
    surface: HeightMap | Mosaic,
    path: str | Path,
    every: int | None = None,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> Path:
    """Write a surface to a file in the format given by its suffix.

    The surface is written strip by strip and atomically; a mosaic is read at full resolution, without its empty margin.

    Parameters
    ----------
    surface : HeightMap or Mosaic
        Surface to write; heights in um.
    path : str or Path
        File to write. Its suffix selects the format: ``{WRITTEN}``. An existing file is replaced.
    every : int, optional
        Write only every n-th row and column. Default: all of them; for a mesh or a web page (``.stl``, ``.obj``,
        ``.glb``, ``.html``) the smallest n that gives at most a million points.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the suffix is unknown, `every` is negative, the file would pass 4 GB (GWY and GLB) or 16 million points (a
        web page), a mesh would hold no triangle, the file cannot be written, or the work is stopped.

    Notes
    -----
    ``.npz`` holds all layers; `losses` states what the other formats cannot hold. A GWY file that would pass 4 GB with
    all layers holds heights only. Every format that can hold text states whether the data are simulated or
    uncalibrated.

    References
    ----------
    .. [1] ISO 25178-72, Geometrical product specifications (GPS) - Surface texture: Areal - Part 72: XML file format
       x3p.
    """
    target = Path(path)
    write = require_format(target)
    surface = _without_margin(surface)
    strips = Strips(surface, every or density(surface, target), progress, should_stop)
    with atomic_write(target) as temporary:
        write(strips, temporary)
    return target


def _without_margin(surface: HeightMap | Mosaic) -> HeightMap | Mosaic:
    """Return the part of a stored mosaic that fields cover: it is stored with a margin for later changes."""
    if not isinstance(surface, ZarrMosaic):
        return surface
    rows, cols = surface.covered()
    if (rows.stop - rows.start, cols.stop - cols.start) == surface.shape:
        return surface
    pixel_um, x0_um, y0_um = surface.pixel_um, surface.x0_um, surface.y0_um
    xs = x0_um + cols.start * pixel_um, x0_um + (cols.stop - 1) * pixel_um
    ys = y0_um - (rows.stop - 1) * pixel_um, y0_um - rows.start * pixel_um
    return PartOfMosaic(surface, Region.rectangle(xs[0], ys[0], xs[1], ys[1]))


def write_surface(height: HeightMap | Mosaic, path: str | Path) -> Path:
    """Write a surface in the format given by the suffix.

    This is `export` with default options.

    Parameters
    ----------
    height : HeightMap or Mosaic
        Surface to write; heights in um. A mosaic is read at full resolution.
    path : str or Path
        File to write; its suffix selects the format, see `export`.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the suffix is unknown, the file would pass 4 GB (GWY and GLB), a mesh would hold no triangle, or the file
        cannot be written.
    """
    return export(height, path)


def require_format(path: Path) -> Writer:
    """Return the exporter for a file's suffix. Raises DatasetError when there is none."""
    kind = BY_SUFFIX.get(suffix_of(path))
    if kind is None or kind.writer is None:
        raise DatasetError(f"{path.name} has no ending that is known: take one of {', '.join(WRITTEN)}.")
    return imported(kind.writer)


def density(surface: HeightMap | Mosaic, path: Path, most_points: int | None = None) -> int:
    """Return n for writing every n-th pixel: 1 by default, more for a drawing or a limited number of points."""
    if most_points is not None and most_points < 4:
        raise DatasetError(f"--max-points is {most_points}: a surface has at least 4.")
    if most_points is None and not BY_SUFFIX[suffix_of(path)].is_drawing:
        return 1
    return every_for(surface.shape, most_points or MESH_POINTS)


def losses(surface: HeightMap | Mosaic, path: Path, every: int = 1) -> tuple[str, ...]:
    """Return what a file cannot hold of a surface, one sentence each; empty if it holds everything."""
    kind = BY_SUFFIX[suffix_of(path)]
    sentences = [kind.loses]
    if every > 1:
        sentences.append(f"One row and one column in {every} are written, {surface.pixel_um * every:.4g} um apart.")
    if kind.loses_more is not None:
        sentences.append(imported(kind.loses_more)(Strips(surface, every)))
    return tuple(one for one in sentences if one)
