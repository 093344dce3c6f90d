"""Table of the surface file formats: those of this program and those of other packages."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from wafer_viewer.model.maker_formats import MAKER_FORMAT
from wafer_viewer.model.plugins import PluginWarning, plugins
from wafer_viewer.model.surface_format import SurfaceFormat

F = TypeVar("F", bound=Callable[..., object])
_STORE = "wafer_viewer.store.formats"
_HEIGHTS_ONLY = (
    "It holds heights only: confidence, uncertainty, the all-in-focus picture, measured heights, what was filled in "
    "and why pixels are unmeasured stay behind"
)
_MESH = "It is a drawing, not data: a part of the heights as a mesh, without the layers, and without gaps marked"
MESH_POINTS = 1_000_000
"""Default number of points of a mesh or a web page."""

OWN_FORMATS = (
    SurfaceFormat(
        suffixes=(".npz",),
        title="NumPy, all layers",
        layout="µm, row 0 at the top edge",
        reader=f"{_STORE}.npz_file:read_npz_surface",
        writer=f"{_STORE}.npz_file:write_npz_strips",
    ),
    SurfaceFormat(
        suffixes=(".gwy",),
        title="GWY, Gwyddion with layers as channels",
        loses="Differences in overlaps stay behind.",
        layout="m, y downward from minus the stage's y",
        reader=f"{_STORE}.gwy:read_gwy",
        magic=(b"GWYP",),
        writer=f"{_STORE}.gwy:write_gwy",
        loses_more=f"{_STORE}.gwy:lost_layers",
    ),
    SurfaceFormat(
        suffixes=(".x3p",),
        title="X3P, ISO 25178-72",
        loses=f"{_HEIGHTS_ONLY}.",
        layout="m, first row at the top, y downward from minus the stage's y, revision ISO5436_2000",
        reader=f"{_STORE}.x3p:read_x3p",
        writer=f"{_STORE}.x3p:write_x3p",
    ),
    SurfaceFormat(
        suffixes=(".gsf",),
        title="GSF, Gwyddion's simple field",
        loses=f"{_HEIGHTS_ONLY}. Heights are rounded to 7 digits.",
        layout="m, y downward from minus the stage's y",
        reader=f"{_STORE}.gsf:read_gsf",
        magic=(b"Gwyddion Simple Field 1.0",),
        writer=f"{_STORE}.gsf:write_gsf",
    ),
    SurfaceFormat(
        suffixes=(".tif", ".tiff"),
        title="TIFF, heights as 32-bit float",
        loses=f"{_HEIGHTS_ONLY}.",
        layout="µm, pixel size as resolution, and with the place for GDAL; Gwyddion reads no units of it",
        reader=f"{_STORE}.tiff:read_tiff",
        writer=f"{_STORE}.tiff:write_tiff",
        is_surface=f"{_STORE}.tiff:is_heights",
    ),
    SurfaceFormat(
        suffixes=(".ome.tif", ".ome.tiff"),
        title="OME-TIFF, heights and picture with pyramids",
        loses="It holds heights as 32-bit floats and the all-in-focus picture: confidence, uncertainty, measured "
        "heights, what was filled in and why pixels are unmeasured stay behind.",
        layout="µm, pixel size and place as OME has them, for viewers of large images",
        reader=f"{_STORE}.tiff:read_tiff",
        writer=f"{_STORE}.ome_pyramid:write_ome_tiff",
        is_surface=f"{_STORE}.tiff:is_heights",
    ),
    SurfaceFormat(
        suffixes=(".ply",),
        title="PLY, points with colour",
        loses="It holds points with a height: measured heights and why pixels are unmeasured stay behind, "
        "16-bit pictures become 8-bit.",
        layout="stage µm, 64-bit",
        reader=f"{_STORE}.ply:read_ply",
        magic=(b"ply\n", b"ply\r\n"),
        writer=f"{_STORE}.ply:write_ply",
    ),
    SurfaceFormat(
        suffixes=(".pcd",),
        title="PCD, points",
        loses="It holds points with a height as 32-bit floats, x and y from the corner of the surface. Confidence, "
        "uncertainty, the all-in-focus picture, measured heights and why pixels are unmeasured stay behind.",
        layout="µm from the surface's corner, which a comment names: Open3D reads zeros from 64-bit PCD",
        reader=f"{_STORE}.pcd:read_pcd",
        writer=f"{_STORE}.pcd:write_pcd",
    ),
    SurfaceFormat(
        suffixes=(".laz",),
        title="LAZ, points",
        loses="It holds points with a height, rounded to 1 nm in x and y and 0.01 nm in z, and their grey. Confidence, "
        "uncertainty, measured heights and why pixels are unmeasured stay behind.",
        layout="stage µm",
        writer=f"{_STORE}.laz:write_laz",
    ),
    SurfaceFormat(
        suffixes=(".csv",),
        title="CSV, x y z",
        loses="It holds points with a height, rounded to 0.1 nm in x and y and 0.01 nm in z. Confidence, "
        "uncertainty, the all-in-focus picture, measured heights and why pixels are unmeasured stay behind.",
        layout="stage µm",
        reader=f"{_STORE}.text_table:read_table",
        writer=f"{_STORE}.text_table:write_csv",
    ),
    SurfaceFormat(
        suffixes=(".xyz",),
        title="XYZ, x y z",
        loses="It holds points with a height, rounded to 0.1 nm in x and y and 0.01 nm in z. Confidence, "
        "uncertainty, the all-in-focus picture, measured heights, what was filled in and why pixels are unmeasured "
        "stay behind.",
        layout="stage µm",
        reader=f"{_STORE}.text_table:read_table",
        writer=f"{_STORE}.text_table:write_xyz",
    ),
    SurfaceFormat(
        suffixes=(".txt", ".asc", ".tsv"),
        title="Text, x y z or a matrix of heights",
        layout="stage µm; a matrix has its first line on top. So may `.csv` and `.xyz`",
        reader=f"{_STORE}.text_table:read_table",
    ),
    MAKER_FORMAT,
    SurfaceFormat(
        suffixes=(".stl",),
        title="STL, a mesh",
        loses=f"{_MESH}. The coordinates x and y are counted from the corner of the surface.",
        layout="µm from the surface's corner",
        reader=f"{_STORE}.mesh_files:read_mesh",
        writer=f"{_STORE}.mesh:write_stl",
        is_drawing=True,
    ),
    SurfaceFormat(
        suffixes=(".obj",),
        title="OBJ, a mesh",
        loses=f"{_MESH}.",
        layout="stage µm",
        reader=f"{_STORE}.mesh_files:read_mesh",
        writer=f"{_STORE}.mesh:write_obj",
        is_drawing=True,
    ),
    SurfaceFormat(
        suffixes=(".glb",),
        title="GLB, a mesh with grey",
        loses=f"{_MESH}.",
        layout="m, y up",
        reader=f"{_STORE}.mesh_files:read_mesh",
        writer=f"{_STORE}.mesh:write_glb",
        is_drawing=True,
    ),
    SurfaceFormat(
        suffixes=(".html",),
        title="Web page, to send and look at",
        loses="It is a drawing, not data: a part of the heights in 16 bits, and the all-in-focus picture as JPEG.",
        layout="stage µm; any browser shows it from a disk or a web server, without this program",
        writer=f"{_STORE}.web_page:write_web_page",
        is_drawing=True,
    ),
    SurfaceFormat(
        suffixes=(".3mf",),
        title="3MF, a mesh",
        layout="its own unit; meshes are read by `pip install 'wafer-viewer[surfaces]'`",
        reader=f"{_STORE}.mesh_files:read_mesh",
    ),
)


def _all_formats() -> tuple[SurfaceFormat, ...]:
    """Return the formats of this program, then those of other packages that take no suffix or title of another."""
    found = list(OWN_FORMATS)
    for brought in plugins("surface_formats", SurfaceFormat):
        taken = {name for one in found for name in (one.title, *one.suffixes)}
        if twice := taken.intersection((brought.title, *brought.suffixes)):
            sentence = f"The format '{brought.title}' is left out, {', '.join(sorted(twice))} is taken: rename it."
            warnings.warn(sentence, PluginWarning, stacklevel=2)
        else:
            found.append(brought)
    return tuple(found)


FORMATS = _all_formats()
BY_SUFFIX = {suffix: one for one in FORMATS for suffix in one.suffixes}
READ = tuple(suffix for suffix, one in BY_SUFFIX.items() if one.reader is not None)
WRITTEN = tuple(suffix for suffix, one in BY_SUFFIX.items() if one.writer is not None)


def suffix_of(path: Path) -> str:
    """Return the ending of a file name that names a format, such as ``.ome.tif``, else its last one; in lower case."""
    double = "".join(path.suffixes[-2:]).lower()
    return double if double in BY_SUFFIX else path.suffix.lower()


def format_of(suffix: str, head: bytes) -> SurfaceFormat | None:
    """Return the format of a file by its first bytes, or by its suffix where they tell nothing; None if unknown.

    suffix: with its dot. head: at least the first 32 bytes, empty where there are none.
    """
    by_suffix = BY_SUFFIX.get(suffix.lower())
    if by_suffix is not None and head.startswith(by_suffix.magic):
        return by_suffix
    by_content = next((one for one in FORMATS if one.magic and head.startswith(one.magic)), None)
    return by_content or by_suffix


def with_suffixes(function: F) -> F:
    """Fill the suffixes of the formats into a docstring that names ``{READ}`` and ``{WRITTEN}``."""
    text = function.__doc__ or ""
    function.__doc__ = text.replace("{READ}", " ".join(READ)).replace("{WRITTEN}", " ".join(WRITTEN))
    return function


def formats_markdown() -> str:
    """Return the table of this program's formats in the documentation."""
    rows = (
        f"| {', '.join(f'`{suffix}`' for suffix in one.suffixes)} | {one.title} | {one.layout} | {one.loses} "
        f"| {'yes' if one.reader else 'no'} | {'yes' if one.writer else 'no'} |"
        for one in OWN_FORMATS
    )
    head = "| ending | format | units, orientation | stays behind | read | written |"
    return "\n".join((head, f"{'|---' * 6}|", *rows))


def every_for(shape: tuple[int, int], most_points: int) -> int:
    """Return the smallest n such that every n-th pixel gives at most `most_points` points."""
    every = max(1, int(math.sqrt(shape[0] * shape[1] / most_points)))
    while -(-shape[0] // every) * -(-shape[1] // every) > most_points:
        every += 1
    return every
