"""File formats for surfaces: their titles, what each cannot store, and read options."""

from __future__ import annotations

import math
from typing import ClassVar

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Positive, Spec

_HEIGHTS_ONLY = (
    "It holds heights only: confidence, the all-in-focus picture, measured heights, what was filled in and why "
    "pixels are unmeasured stay behind"
)
_MESH = "It is a drawing, not data: a part of the heights as a mesh, without gaps marked, and is not read back"
MESH_POINTS = 1_000_000
"""Default number of points of a mesh."""


class FileFormat(Spec, frozen=True, kw_only=True):
    """A file format: its title, what it cannot store (a sentence, or empty) and whether it can be read."""

    title: str
    loses: str = ""
    is_read: bool = True
    is_mesh: bool = False


class Reading(Spec, frozen=True, kw_only=True):
    """User-supplied properties of a surface file that does not contain them.

    z_unit: unit of its heights, and of all three coordinates of points; pixel_um: pixel size, or the grid spacing for
    scattered points; invert_z: its values are depths, so the sign is inverted.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    z_unit: str | None = None
    pixel_um: Positive | None = None
    invert_z: bool = False


FORMATS: dict[str, FileFormat] = {
    ".npz": FileFormat(title="NumPy, all layers"),
    ".gwy": FileFormat(title="GWY, Gwyddion with layers as channels", loses="Differences in overlaps stay behind."),
    ".x3p": FileFormat(
        title="X3P, ISO 25178-72",
        loses=f"{_HEIGHTS_ONLY}. Gwyddion draws its rows downward, not up as the standard has them.",
    ),
    ".gsf": FileFormat(
        title="GSF, Gwyddion's simple field", loses=f"{_HEIGHTS_ONLY}. Heights are rounded to 7 digits."
    ),
    ".tif": FileFormat(title="TIFF, heights as 32-bit float", loses=f"{_HEIGHTS_ONLY}."),
    ".tiff": FileFormat(title="TIFF, heights as 32-bit float", loses=f"{_HEIGHTS_ONLY}."),
    ".ply": FileFormat(
        title="PLY, points with colour",
        loses="It holds points with a height: measured heights and why pixels are unmeasured stay behind, "
        "16-bit pictures become 8-bit.",
    ),
    ".pcd": FileFormat(
        title="PCD, points",
        loses="It holds points with a height as 32-bit floats, x and y from the corner of the surface: confidence, the "
        "all-in-focus picture, measured heights and why pixels are unmeasured stay behind.",
    ),
    ".csv": FileFormat(
        title="CSV, x y z",
        loses="It holds points with a height, rounded to 0.1 nm in x and y and 0.01 nm in z: confidence, the "
        "all-in-focus picture, measured heights and why pixels are unmeasured stay behind.",
    ),
    ".xyz": FileFormat(
        title="XYZ, x y z",
        loses="It holds points with a height, rounded to 0.1 nm in x and y and 0.01 nm in z: confidence, the "
        "all-in-focus picture, measured heights, what was filled in and why pixels are unmeasured stay behind.",
    ),
    ".stl": FileFormat(
        title="STL, a mesh",
        loses=f"{_MESH}; x and y are counted from the corner of the surface.",
        is_read=False,
        is_mesh=True,
    ),
    ".obj": FileFormat(title="OBJ, a mesh", loses=f"{_MESH}.", is_read=False, is_mesh=True),
    ".glb": FileFormat(title="GLB, a mesh with grey", loses=f"{_MESH}.", is_read=False, is_mesh=True),
}
"""Formats by file extension."""
READ = tuple(ending for ending, kind in FORMATS.items() if kind.is_read)
MESHES = tuple(ending for ending, kind in FORMATS.items() if kind.is_mesh)


def every_for(shape: tuple[int, int], most_points: int) -> int:
    """Return the smallest n such that every n-th pixel gives at most `most_points` points."""
    every = max(1, int(math.sqrt(shape[0] * shape[1] / most_points)))
    while -(-shape[0] // every) * -(-shape[1] // every) > most_points:
        every += 1
    return every
