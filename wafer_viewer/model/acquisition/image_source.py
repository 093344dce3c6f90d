"""Planes of image files with axes, places and lengths, each value with its source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, ClassVar, Generic, Literal, NoReturn, TypeVar

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Setting, Spec, Within

T = TypeVar("T")
GridOrder = Literal["rows", "columns", "snake-rows", "snake-columns"]
Corner = Literal["top-left", "top-right", "bottom-left", "bottom-right"]
Mirror = Literal["none", "x", "y", "both"]


@dataclass(frozen=True, slots=True)
class Stated(Generic[T]):
    """A value that a file states. source: where it was found, such as ``OME PhysicalSizeZ``."""

    value: T
    source: str


@dataclass(frozen=True, slots=True)
class Statements:
    """Statements of a file on all its images; None where it says nothing.

    pixel_um: pixel size along x; pixel_y_um: along y; z_step_um: distance between neighbouring planes, under 0 if the
    planes go down; numerical_aperture and objective: of the lens; taken: date and time, ISO 8601.
    notes: one sentence each on how the images are read.
    """

    pixel_um: Stated[float] | None = None
    pixel_y_um: Stated[float] | None = None
    z_step_um: Stated[float] | None = None
    numerical_aperture: Stated[float] | None = None
    objective: Stated[str] | None = None
    taken: Stated[str] | None = None
    notes: tuple[str, ...] = ()

    def merged(self, other: Statements) -> Statements:
        """Return these statements, completed by another file's."""
        values = {f.name: getattr(self, f.name) or getattr(other, f.name) for f in fields(self)}
        return Statements(**values)


@dataclass(frozen=True, slots=True)
class ImagePlane:
    """One grey image of a file, with its place on the axes of the file.

    path, page: file and page that hold it. read: returns it as grey [row, col], uint8 or uint16.
    position, channel, time: names of its place on these axes; empty where the file has no such axis.
    exposure: number of the exposure of its slot, where the channels of a file are exposures.
    k: number along z; z_um, x_um, y_um: stated place of the stage; exposure_us: stated exposure time; time_us: when it
    was taken, since the first frame of the file.
    simulated: True if the file says that it was not taken of a real sample.
    """

    name: str
    path: Path
    page: int
    read: Callable[[], Image]
    position: str = ""
    channel: str = ""
    time: str = ""
    exposure: int = 0
    k: int = 0
    z_um: float | None = None
    x_um: float | None = None
    y_um: float | None = None
    exposure_us: float | None = None
    time_us: float | None = None
    simulated: bool = False
    says: Statements = Statements()


_PIXEL = Setting("Pixel, µm", "Size of a pixel on the sample, µm; over 0", "not given")
_Z_STEP = Setting("z step, µm", "Between two images of the stack, µm; under 0 if they go down", "not given")
_NA = Setting("NA", "Numerical aperture of the objective, in air", "not known")
_LIGHT = Setting("Light, µm", "Wavelength; empty: 0.55 µm", "0.55")
_PATTERN = Setting("Pattern", "Only for a grid of fields, such as r{row}_c{col}_k{k}.tif")
_ONLY = Setting("Only", "Files to take, by a pattern of their names such as img_*.png")
_COLUMNS = Setting("Columns", "Of a grid whose fields have running numbers, {n}")
_ORDER = Setting(
    "Numbered",
    "In which order the running numbers of the fields go through the grid",
    titles={
        "rows": "along rows",
        "columns": "along columns",
        "snake-rows": "snake along rows",
        "snake-columns": "snake along columns",
    },
)
_CORNER = Setting(
    "Begins",
    "The corner of the grid where the first field lies",
    titles={
        "top-left": "from top left",
        "top-right": "from top right",
        "bottom-left": "from bottom left",
        "bottom-right": "from bottom right",
    },
)


class ImageOptions(Spec, frozen=True, kw_only=True):
    """Values of images taken elsewhere that the user gives, and choices where the files leave one.

    z_step_um: distance between frames, under 0 if taken downward; pixel_um: pixel size on the sample;
    numerical_aperture: of the objective, in air; wavelength_um: of the light, 0.55 um by default.
    pattern: how the files are named, such as ``r{row}_c{col}_k{k}.tif``.
    channel, time, position: name or number, from 0, of the one to take; all positions become fields by default.
    only: pattern of the file names to take, such as ``*.tif``; as_listed: take all files in the order given, or in that
    of their numbers, without a look for gaps, copies and strangers; overrule: take given values where files differ.
    columns, order, corner: of a grid whose fields have running numbers: how many columns, in which order from which
    corner; mirror: axes whose direction is reversed; places: table of the places of the fields.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    z_step_um: Annotated[float | None, _Z_STEP] = None
    pixel_um: Annotated[float | None, _PIXEL] = None
    numerical_aperture: Annotated[float | None, _NA] = None
    wavelength_um: Annotated[float | None, _LIGHT] = None
    pattern: Annotated[str | None, _PATTERN] = None
    channel: str | None = None
    time: str | None = None
    position: str | None = None
    only: Annotated[str | None, _ONLY] = None
    as_listed: bool = False
    overrule: bool = False
    columns: Annotated[Annotated[int, Within(1, 100_000)] | None, _COLUMNS] = None
    order: Annotated[GridOrder, _ORDER] = "rows"
    corner: Annotated[Corner, _CORNER] = "top-left"
    mirror: Mirror = "none"
    places: Path | None = None

    def refuse(self, name: str, limit: str) -> NoReturn:
        """Raise DatasetError with the value in its unit."""
        title = "number of columns" if name == "columns" else name.removesuffix("_um").replace("_", " ")
        unit = " um" if name.endswith("_um") else ""
        raise self.error(f"The {title} is {getattr(self, name)}{unit}: it must be {limit}.")
