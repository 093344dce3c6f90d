"""Surfaces: height maps of fields with their refused points, and mosaics of many fields."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import IntEnum
from pkgutil import resolve_name
from typing import Any, Literal, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Spec
from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.model.surface.recipe import Recipe

# ------------------------------------------------------------------------------------------------------- pyramid layers


EXTREMES = ("z_min_um", "z_max_um")
"""Lowest and highest measured height below a pixel."""
OF_ORIGIN, N_ORIGIN = ("z_um", "confidence"), "n_origin"
"""Layers that are means of the pixels with the best origin below a pixel, and the layer that counts these."""
OF_MEASURED = ("z_raw_um", "u_um")
"""Layers that only measured pixels have, of which they are means; `N_ORIGIN` counts them."""
OVERLAP, N_OVERLAP = "overlap_um", "n_overlap"
"""Layer that is the mean of the pixels measured by two fields, and the layer that counts these."""
GREY, N_COVERED = "all_in_focus", "n_covered"
"""Layer that is the mean of the covered pixels, and the layer that counts these."""
COUNTS = (N_ORIGIN, N_OVERLAP, N_COVERED)


# ----------------------------------------------------------------------------------------------------------- height map


@dataclass(frozen=True, slots=True, eq=False)
class RefusedHeights:
    """Peaks of a field that failed a gate, with the heights they would have had.

    Pixels filled afterwards are included: their origin in the height map is FILLED, their reason is stored here.

    Parameters
    ----------
    at
        Pixel numbers in row-major order, ascending; uint32 [n].
    z_um
        Height of the refused peak in um; float32 [n].
    reason
        Code of `Origin` of the first gate that failed; uint8 [n].

    Raises
    ------
    MeasureError
        If the three differ in length.
    """

    at: NDArray[np.uint32]
    z_um: NDArray[np.float32]
    reason: NDArray[np.uint8]

    def __post_init__(self) -> None:
        lengths = {len(self.at), len(self.z_um), len(self.reason)}
        if len(lengths) != 1:
            raise MeasureError(f"Refused heights have arrays of the lengths {sorted(lengths)}: give one length.")

    def __len__(self) -> int:
        return len(self.at)

    def of_rows(self, first: int, end: int, cols: int) -> slice:
        """Return the slice of points in the rows [first, end) of a map with `cols` columns."""
        low, high = np.searchsorted(self.at, [max(0, first) * cols, max(0, end) * cols])
        return slice(int(low), int(high))


class Origin(IntEnum):
    """Source of a pixel's height, or reason why it has none. Codes are never reused; from 10 on it is unmeasured."""

    MEASURED = 0
    FILLED = 1
    NOT_COVERED = 10
    CLIPPED = 11
    NO_TEXTURE = 12
    AMBIGUOUS = 13
    END_OF_RANGE = 14
    WINDOWS_DISAGREE = 15
    BLEEDING_EDGE = 16
    OUTLIER = 17
    TOO_FEW_FRAMES = 18
    STEP_EDGE = 19
    NO_REASON = 20


UNMEASURED_FROM = 10
ORIGIN_TITLES: dict[Origin, str] = {
    Origin.MEASURED: "measured",
    Origin.FILLED: "filled",
    Origin.NOT_COVERED: "not covered",
    Origin.CLIPPED: "too bright",
    Origin.NO_TEXTURE: "no texture",
    Origin.AMBIGUOUS: "ambiguous peak",
    Origin.END_OF_RANGE: "peak at the end of the range",
    Origin.WINDOWS_DISAGREE: "windows disagree",
    Origin.BLEEDING_EDGE: "light bleeding over an edge",
    Origin.OUTLIER: "outlier",
    Origin.TOO_FEW_FRAMES: "too few frames",
    Origin.STEP_EDGE: "at the edge of a step",
    Origin.NO_REASON: "no reason given",
}


class Provenance(Spec, frozen=True, kw_only=True):
    """Provenance of a surface: recipe with the values chosen by ``auto``, calibration, version, input, simulation.

    frame_health: uncertainty of heights from the z and the light of the frames; positions_assumed: positions of fields
    were made up by an import, from an assumed overlap, so that they tell nothing about pixel size and camera.
    even_step_um: distance of the frames of the one field whose heights these are, 0 where they do not lie evenly.
    """

    recipe: Recipe = Recipe()
    calibration: Calibration | None = None
    software_version: str = ""
    input_checksum: str = ""
    simulated: bool = False
    z_step_um: float = 0.0
    even_step_um: float = 0.0
    frame_health: FrameHealth = FrameHealth()
    positions_assumed: bool = False
    notes: tuple[str, ...] = ()


class AsArray:
    """Base class of surfaces that NumPy takes for their heights: ``numpy.asarray(surface)``."""

    __slots__ = ()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the heights that are measured on, um, float32 [row, col], NaN where there is none."""
        heights = cast(Mosaic, self).window().to_measure()
        return np.array(heights, dtype, copy=copy)

    def plot(self, axes: Any = None) -> Any:
        """Draw the heights over x and y of the stage by matplotlib, in new axes if none are given; return the axes."""
        return resolve_name("wafer_viewer.draw.plots:plot_surface")(self, axes)


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap(AsArray):
    """A surface on a grid, all arrays [row, col]: x = x0_um + col * pixel_um, y = y0_um - row * pixel_um.

    z_um: float32, NaN if unmeasured, filtered as the recipe says; z_raw_um: float32, gated, neither smoothed nor
    filled, the default for measurements; confidence: float32 in 0 ... 1; all_in_focus: uint8 or uint16 grey; origin:
    uint8 codes of `Origin`; overlap_um: float32, only for a mosaic: highest minus lowest raw height where two or more
    fields measured a pixel, NaN elsewhere; u_um: float32, standard uncertainty (k = 1) of z_raw_um, NaN where it is
    unmeasured or of unknown uncertainty, None if no height has one; refused: only for a field: the heights rejected by
    gates; None if they were not stored, and for a part of a map.

    Raises MeasureError if the shapes differ.
    """

    z_um: NDArray[np.float32]
    z_raw_um: NDArray[np.float32]
    confidence: NDArray[np.float32]
    all_in_focus: NDArray[np.uint8] | NDArray[np.uint16]
    origin: NDArray[np.uint8]
    pixel_um: float
    x0_um: float
    y0_um: float
    provenance: Provenance = Provenance()
    overlap_um: NDArray[np.float32] | None = None
    refused: RefusedHeights | None = None
    u_um: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        shapes = {a.shape for a in (self.z_um, self.z_raw_um, self.confidence, self.all_in_focus, self.origin)}
        shapes |= {a.shape for a in (self.overlap_um, self.u_um) if a is not None}
        if len(shapes) != 1:
            raise MeasureError(f"The layers of a height map have the shapes {sorted(shapes)}: they must be one shape.")

    def __repr__(self) -> str:
        z_um = self.z_raw_um[np.isfinite(self.z_raw_um)]
        span = f"z {z_um.min():.2f} to {z_um.max():.2f} um" if z_um.size else "no heights"
        rows, cols = self.shape
        x_um, y_um = (f"{low:.1f} to {high:.1f}" for low, high in np.reshape(self.bounds_um, (2, 2)).T)
        simulated = ", simulated" if self.provenance.simulated else ""
        return (
            f"{type(self).__name__}: {rows} x {cols} pixels of {self.pixel_um:g} um{simulated}\n"
            f"  x {x_um} um, y {y_um} um, {span}\n"
            f"  {100 * self.measured.mean():.1f} % measured"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.z_um.shape[0], self.z_um.shape[1]

    @property
    def x_um(self) -> NDArray[np.float64]:
        """Stage x of each column."""
        return self.x0_um + np.arange(self.shape[1], dtype=np.float64) * self.pixel_um

    @property
    def y_um(self) -> NDArray[np.float64]:
        """Stage y of each row."""
        return self.y0_um - np.arange(self.shape[0], dtype=np.float64) * self.pixel_um

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask of measured pixels, without filled ones."""
        return self.origin == Origin.MEASURED

    @property
    def bounds_um(self) -> tuple[float, float, float, float]:
        """(x low, y low, x high, y high) of the pixel centres."""
        rows, cols = self.shape
        return self.x0_um, self.y0_um - (rows - 1) * self.pixel_um, self.x0_um + (cols - 1) * self.pixel_um, self.y0_um

    def to_measure(self, count_filled: bool = False) -> NDArray[np.float32]:
        """Return the heights for measurements: gated and unsmoothed, unless the recipe says otherwise.

        count_filled: return the filtered heights with filled pixels instead.
        """
        if count_filled:
            return self.z_um
        smoothed = self.provenance.recipe.measure_on == "smoothed"
        return np.where(self.measured, self.z_um, np.float32(np.nan)) if smoothed else self.z_raw_um

    def crop(self, rows: slice, cols: slice) -> HeightMap:
        """Return the part [rows, cols], as views; slices need a start and a step of one."""
        return dataclasses.replace(
            self,
            z_um=self.z_um[rows, cols],
            z_raw_um=self.z_raw_um[rows, cols],
            confidence=self.confidence[rows, cols],
            all_in_focus=self.all_in_focus[rows, cols],
            origin=self.origin[rows, cols],
            overlap_um=None if self.overlap_um is None else self.overlap_um[rows, cols],
            u_um=None if self.u_um is None else self.u_um[rows, cols],
            refused=None,
            x0_um=self.x0_um + int(cols.start or 0) * self.pixel_um,
            y0_um=self.y0_um - int(rows.start or 0) * self.pixel_um,
        )

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the smallest part that contains a region, or the whole map; the only level is 0.

        Raises
        ------
        MeasureError
            If the region lies outside, or for another level.
        """
        if level != 0:
            raise MeasureError(f"This surface has one level, level {level} was asked for: take level 0.")
        if region is None:
            return self
        rows, cols = pixel_window(self, region)
        return self.crop(rows, cols)

    @property
    def levels(self) -> int:
        """Number of levels: one."""
        return 1


class Outline(Protocol):
    """Pixel grid of a surface; of a field it is known before the pixels are read."""

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        ...

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of pixel (0, 0) of level 0."""
        ...

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of pixel (0, 0) of level 0."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        ...


class Mosaic(Outline, Protocol):
    """A surface that may exceed memory: a pyramid of levels, each with half the resolution of the previous one."""

    @property
    def levels(self) -> int:
        """Number of levels, at least 1."""
        ...

    @property
    def provenance(self) -> Provenance:
        """Provenance of the surface."""
        ...

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that contains a region, or the whole level."""
        ...


HeightLayer = Literal["unsmoothed", "smoothed", "filled"]
LAYER_TITLES: dict[HeightLayer, str] = {
    "unsmoothed": "measured heights",
    "smoothed": "filtered heights",
    "filled": "filtered and filled heights",
}
"""Titles of the height layers on the page, in reports and in files; the keys are those of recipes."""


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """One layer of heights, float32 [row, col], NaN if unmeasured, on the grid of a HeightMap."""

    z_um: NDArray[np.float32]
    pixel_um: float
    x0_um: float
    y0_um: float

    @property
    def x_um(self) -> NDArray[np.float64]:
        """Stage x of each column."""
        return self.x0_um + np.arange(self.z_um.shape[1], dtype=np.float64) * self.pixel_um

    @property
    def y_um(self) -> NDArray[np.float64]:
        """Stage y of each row."""
        return self.y0_um - np.arange(self.z_um.shape[0], dtype=np.float64) * self.pixel_um


@runtime_checkable
class HasLayers(Protocol):
    """A surface that can read one layer of heights alone, which takes a sixth of the work."""

    def one_layer(self, layer: HeightLayer, region: Region, level: int = 0) -> Heights:
        """Return the part of a level that contains a region. Raises MeasureError if the region lies outside."""
        ...


class ReadThrough(AsArray):
    """Base class of a mosaic on the grid of another one, with the data read differently."""

    surface: Mosaic

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.surface.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of pixel (0, 0) of level 0."""
        return self.surface.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of pixel (0, 0) of level 0."""
        return self.surface.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.surface.shape

    @property
    def levels(self) -> int:
        """Number of levels."""
        return self.surface.levels

    @property
    def provenance(self) -> Provenance:
        """Provenance of the surface."""
        return self.surface.provenance


def pixel_window(surface: Mosaic | HeightMap, region: Region, level: int = 0) -> tuple[slice, slice]:
    """Return the rows and columns of a level that contain a region.

    Raises
    ------
    MeasureError
        If the region lies outside the surface.
    """
    scale = 2**level
    pixel = surface.pixel_um * scale
    x0 = surface.x0_um + (scale - 1) / 2 * surface.pixel_um
    y0 = surface.y0_um - (scale - 1) / 2 * surface.pixel_um
    rows, cols = (-(-n // scale) for n in surface.shape)
    xa, ya, xb, yb = region.bounds_um
    first_col, last_col = int(np.floor((xa - x0) / pixel + 0.5)), int(np.ceil((xb - x0) / pixel - 0.5))
    first_row, last_row = int(np.floor((y0 - yb) / pixel + 0.5)), int(np.ceil((y0 - ya) / pixel - 0.5))
    if last_col < 0 or first_col >= cols or last_row < 0 or first_row >= rows:
        raise MeasureError(
            f"The {region.kind} from ({xa:.1f}, {ya:.1f}) to ({xb:.1f}, {yb:.1f}) um lies outside of the surface: "
            f"({x0:.1f}, {y0 - (rows - 1) * pixel:.1f}) to ({x0 + (cols - 1) * pixel:.1f}, {y0:.1f}) um."
        )
    return (
        slice(max(0, first_row), min(rows, max(last_row, first_row) + 1)),
        slice(max(0, first_col), min(cols, max(last_col, first_col) + 1)),
    )


class PartOfMosaic(ReadThrough):
    """Part of a mosaic in the bounding box of a region, at full resolution.

    Raises
    ------
    MeasureError
        If the region lies outside the surface.
    """

    def __init__(self, surface: Mosaic, region: Region) -> None:
        self.surface = surface
        self.rows, self.cols = pixel_window(surface, region)

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of its first column."""
        return self.surface.x0_um + self.cols.start * self.pixel_um

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of its first row."""
        return self.surface.y0_um - self.rows.start * self.pixel_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows.stop - self.rows.start, self.cols.stop - self.cols.start

    @property
    def levels(self) -> int:
        """Number of levels: one."""
        return 1

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part that contains a region. Raises MeasureError for a level other than 0."""
        if level != 0:
            raise MeasureError(f"A part of a surface has one level, level {level} was asked for: take level 0.")
        rows, cols = (slice(0, n) for n in self.shape) if region is None else pixel_window(self, region)
        xa, xb = (self.x0_um + col * self.pixel_um for col in (cols.start, cols.stop - 1))
        ya, yb = (self.y0_um - row * self.pixel_um for row in (rows.stop - 1, rows.start))
        return self.surface.window(Region.rectangle(xa, ya, xb, yb))


@dataclass(frozen=True, slots=True, eq=False)
class TexturedHeights(Heights):
    """One layer of heights with the grey values on the same grid; picture: float32, NaN where no field covers it."""

    picture: NDArray[np.float32]


@runtime_checkable
class ProvidesTexture(Protocol):
    """A surface that can read heights and picture alone, which takes half of the work."""

    def pictured(self, layer: HeightLayer, region: Region, level: int = 0) -> TexturedHeights:
        """Return the part of a level that contains a region. Raises MeasureError if the region lies outside."""
        ...


def picture_of(all_in_focus: NDArray[np.uint8] | NDArray[np.uint16], origin: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the grey values as float32, NaN where no field covers the pixel."""
    picture = all_in_focus.astype(np.float32)
    picture[origin == Origin.NOT_COVERED] = np.nan
    return picture
