"""Export of surfaces to files of other programs, by suffix; `SurfaceFormat` states what each loses.

Every format that can hold text states whether the data are simulated or uncalibrated.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import BY_SUFFIX, MESH_POINTS, WRITTEN, every_for, with_suffixes
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.model.surface_format import imported
from wafer_viewer.store.formats.reader_support import caveats
from wafer_viewer.store.formats.surface_strips import Strips
from wafer_viewer.store.io.atomic_files import atomic_write

__all__ = ["caveats", "export", "losses", "require_format", "write_surface"]

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

    The surface is written strip by strip and atomically; a mosaic is read at full resolution.

    Parameters
    ----------
    surface : HeightMap or Mosaic
        Surface to write; heights in um.
    path : str or Path
        File to write. Its suffix selects the format: ``{WRITTEN}``. An existing file is replaced.
    every : int, optional
        Write only every n-th row and column. Default: all of them; for a mesh (``.stl``, ``.obj``, ``.glb``) the
        smallest n that gives at most a million points.
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
        When the suffix is unknown, `every` is negative, the file would pass 4 GB (GWY and GLB), a mesh would hold no
        triangle, the file cannot be written, or the work is stopped.

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
    strips = Strips(surface, every or density(surface, target), progress, should_stop)
    with atomic_write(target) as temporary:
        write(strips, temporary)
    return target


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
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is None or kind.writer is None:
        raise DatasetError(f"{path.name} has no ending that is known: take one of {', '.join(WRITTEN)}.")
    return imported(kind.writer)


def density(surface: HeightMap | Mosaic, path: Path, most_points: int | None = None) -> int:
    """Return n for writing every n-th pixel: 1 by default, more for a mesh or a limited number of points."""
    if most_points is not None and most_points < 4:
        raise DatasetError(f"--max-points is {most_points}: a surface has at least 4.")
    if most_points is None and not BY_SUFFIX[path.suffix.lower()].is_mesh:
        return 1
    return every_for(surface.shape, most_points or MESH_POINTS)


def losses(surface: HeightMap | Mosaic, path: Path, every: int = 1) -> tuple[str, ...]:
    """Return what a file cannot hold of a surface, one sentence each; empty if it holds everything."""
    kind = BY_SUFFIX[path.suffix.lower()]
    sentences = [kind.loses]
    if every > 1:
        sentences.append(f"One row and one column in {every} are written, {surface.pixel_um * every:.4g} um apart.")
    if kind.loses_more is not None:
        sentences.append(imported(kind.loses_more)(Strips(surface, every)))
    return tuple(one for one in sentences if one)
