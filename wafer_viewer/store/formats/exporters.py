"""Surfaces as files that other programs read. The ending picks the format; model/formats.py says what each loses.

Every format that can hold a text says what is simulated or uncalibrated.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import FORMATS, MESH_POINTS, every_for
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.store.formats.embedded_metadata import caveats
from wafer_viewer.store.formats.gsf import write_gsf
from wafer_viewer.store.formats.gwy import fits, fits_heights, write_gwy
from wafer_viewer.store.formats.mesh import write_glb, write_obj, write_stl
from wafer_viewer.store.formats.npz_file import write_npz_strips
from wafer_viewer.store.formats.pcd import write_pcd
from wafer_viewer.store.formats.ply import write_ply
from wafer_viewer.store.formats.surface_strips import Strips
from wafer_viewer.store.formats.text_table import write_csv, write_xyz
from wafer_viewer.store.formats.tiff import write_tiff
from wafer_viewer.store.formats.x3p import write_x3p
from wafer_viewer.store.io.atomic_files import replacing

__all__ = ["EXPORTERS", "caveats", "export", "losses", "require_known", "write_surface"]

Writer = Callable[[Strips, Path], None]
EXPORTERS: dict[str, Writer] = {
    ".npz": write_npz_strips,
    ".gwy": write_gwy,
    ".x3p": write_x3p,
    ".gsf": write_gsf,
    ".tif": write_tiff,
    ".tiff": write_tiff,
    ".ply": write_ply,
    ".pcd": write_pcd,
    ".csv": write_csv,
    ".xyz": write_xyz,
    ".stl": write_stl,
    ".obj": write_obj,
    ".glb": write_glb,
}
"""How a surface is written, by the ending of the file."""


def export(
    surface: HeightMap | Mosaic,
    path: str | Path,
    every: int | None = None,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> Path:
    """Write a surface strip by strip, whole or not at all; a mosaic is read at its full resolution.

    every: only every n-th row and column; all of them by default, of a mesh as many as make a million points.
    Raises DatasetError when the ending names no format, the file cannot be written, or the work is stopped.
    """
    target = Path(path)
    write = require_known(target)
    strips = Strips(surface, every or density(surface, target), progress, should_stop)
    if target.suffix.lower() == ".gwy" and not fits_heights(strips):
        raise DatasetError(
            f"{target.name} would pass the 4 GB of a GWY file: take X3P, or fewer points with --every 2."
        )
    with replacing(target) as beside:
        write(strips, beside)
    return target


def write_surface(height: HeightMap | Mosaic, path: str | Path) -> Path:
    """Write a surface as the kind of file that the ending names; `export` with nothing else to say."""
    return export(height, path)


def require_known(path: Path) -> Writer:
    """The exporter of a file's ending. Raises DatasetError when there is none."""
    if (found := EXPORTERS.get(path.suffix.lower())) is None:
        raise DatasetError(f"{path.name} has no ending that is known: take one of {', '.join(EXPORTERS)}.")
    return found


def density(surface: HeightMap | Mosaic, path: Path, most_points: int | None = None) -> int:
    """Every how manieth pixel is written: all of them, unless at most so many points are asked for, or a mesh is."""
    if most_points is not None and most_points < 4:
        raise DatasetError(f"--max-points is {most_points}: a surface has at least 4.")
    if most_points is None and not FORMATS[path.suffix.lower()].is_mesh:
        return 1
    return every_for(surface.shape, most_points or MESH_POINTS)


def losses(surface: HeightMap | Mosaic, path: Path, every: int = 1) -> tuple[str, ...]:
    """What a file cannot hold of a surface, a sentence each; empty where it holds all."""
    said = [FORMATS[path.suffix.lower()].loses]
    if every > 1:
        said.append(f"One row and one column in {every} are written, {surface.pixel_um * every:.4g} um apart.")
    if path.suffix.lower() == ".gwy" and not fits(Strips(surface, every)):
        said.append("All layers would pass the 4 GB of a GWY file: it holds heights only.")
    return tuple(one for one in said if one)
