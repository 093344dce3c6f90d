"""Descriptor of a surface file format, and the user's values for a file that does not contain them."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Positive, Setting, Spec

Table = Literal["points", "matrix"] | None
"""Meaning of the lines of a text file; None: found out."""
Function = str | Callable[..., Any]
"""A function, or its path ``package.module:function``, which is imported when the function is called."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceFormat:
    """Surface file format. Page, command line, Python API and documentation read its fields.

    Parameters
    ----------
    suffixes : tuple of str
        Lower-case suffixes with their dot, such as ``(".tif", ".tiff")``; lists show the first.
    title : str
        Title in lists, such as ``TIFF, heights as 32-bit float``.
    loses : str
        Sentence on what a file cannot hold of a surface; empty if it holds everything.
    layout : str
        Units and orientation of the coordinates, for the documentation.
    reader : callable or str, optional
        ``reader(path, options)``, with `ReadOptions`; returns a `HeightMap`. Default: files are not read.
    writer : callable or str, optional
        ``writer(strips, path)``, with `Strips`; the path is renamed when it returns. Default: files are not written.
    is_surface : callable or str, optional
        ``is_surface(path)`` for suffixes that other kinds of files share. Default: every file is a surface.
    loses_more : callable or str, optional
        ``loses_more(strips)``: sentence on what a file loses of one surface beyond `loses`, or an empty text.
    is_drawing : bool, default False
        A drawing rather than data: at most `MESH_POINTS` points by default.
    magic : tuple of bytes, optional
        First bytes, one of which each file has, by which a file with the suffix of another format is recognised.

    Raises
    ------
    DatasetError
        When there is no suffix, a suffix has no dot or an upper-case letter, or neither reader nor writer is given.
    """

    suffixes: tuple[str, ...]
    title: str
    loses: str = ""
    layout: str = ""
    reader: Function | None = None
    writer: Function | None = None
    is_surface: Function | None = None
    loses_more: Function | None = None
    is_drawing: bool = False
    magic: tuple[bytes, ...] = ()

    def __post_init__(self) -> None:
        if not self.suffixes or any(not s.startswith(".") or s != s.lower() for s in self.suffixes):
            raise DatasetError(
                f"The suffixes of '{self.title}' are {self.suffixes}: give them as in ('.tif', '.tiff')."
            )
        if self.reader is None and self.writer is None:
            raise DatasetError(f"The format '{self.title}' has neither a reader nor a writer: give one of them.")


_Z_UNIT = Setting("z unit", "Unit of the heights of a surface file, such as um; of points the unit of x and y, too")
_DEPTHS = Setting("Depths", "The file holds depths, positive downward: they are inverted")
_LINES = Setting(
    "Lines",
    "Meaning of the lines of a text file: points by x, y, z, or the rows of a matrix of heights",
    titles={None: "found out", "points": "points by x, y, z", "matrix": "rows of a matrix"},
)


class Reading(Spec, frozen=True, kw_only=True):
    """User-supplied properties of a surface file that does not contain them.

    z_unit: unit of its heights, and of all three coordinates of points; pixel_um: pixel size, or the grid spacing for
    scattered points and meshes; invert_z: its values are depths, so the sign is inverted; table: whether the lines of a
    text are points or the rows of a matrix of heights, where it could be either.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    z_unit: Annotated[str | None, _Z_UNIT] = None
    pixel_um: Positive | None = None
    invert_z: Annotated[bool, _DEPTHS] = False
    table: Annotated[Table, _LINES] = None


def imported(function: Function) -> Callable[..., Any]:
    """Return the function of a descriptor. Raises DatasetError when its module cannot be imported."""
    if not isinstance(function, str):
        return function
    try:
        return pkgutil.resolve_name(function)
    except (ImportError, AttributeError, ValueError) as fault:
        raise DatasetError(f"{function} cannot be loaded ({fault}): update or remove the package it is of.") from fault
