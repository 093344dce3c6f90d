"""The kinds of files that surfaces are exchanged in, what each cannot hold, and what a person says of a file."""

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
"""A mesh has about as many points where nobody asks for another density."""


class FileFormat(Spec, frozen=True, kw_only=True):
    """A kind of file: its name, what it cannot hold (a sentence; empty where it holds all), and whether it is read."""

    title: str
    loses: str = ""
    is_read: bool = True
    is_mesh: bool = False


class Reading(Spec, frozen=True, kw_only=True):
    """What a person says of a surface file that does not say it itself.

    z_unit: unit of its heights, and of all three coordinates of points; pixel_um: pixel size, or the lattice that
    scattered points are gridded on; invert_z: its numbers are depths, so that they are turned over.
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
"""By the ending of the file."""
READ = tuple(ending for ending, kind in FORMATS.items() if kind.is_read)
MESHES = tuple(ending for ending, kind in FORMATS.items() if kind.is_mesh)


def every_for(shape: tuple[int, int], most_points: int) -> int:
    """The smallest density, as every n-th pixel, that makes at most so many points."""
    every = max(1, int(math.sqrt(shape[0] * shape[1] / most_points)))
    while -(-shape[0] // every) * -(-shape[1] // every) > most_points:
        every += 1
    return every
