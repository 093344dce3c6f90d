"""Search lines in the all-in-focus image, with their mapping to the stage. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, level_for, require_area
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin

LEAST_PX = 16
"""Smallest region in pixels each way; the edge filter extends six pixels."""
LEAST_COVERED = 0.5
"""Smallest fraction of a region covered by the image, for a representative result."""
Way = tuple[float, float]
"""x, y in um."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchStrip:
    """Grey values along search lines, float32 [line, place], and mask of covered pixels, bool [line, place].

    A pixel lies at `corner_um` + line * `line_um` + place * `place_um`, each (x, y) in stage um.
    """

    grey: NDArray[np.float32]
    there: NDArray[np.bool_]
    corner_um: Way
    line_um: Way
    place_um: Way

    @classmethod
    def of(cls, grey: NDArray[np.generic], pixel_um: float, x0_um: float, y0_um: float) -> SearchStrip:
        """Return a strip of a complete image [row, col]; search lines run along x."""
        there = np.ones(grey.shape, bool)
        return cls(grey.astype(np.float32), there, (x0_um, y0_um), (0.0, -pixel_um), (pixel_um, 0.0))

    @property
    def pixel_um(self) -> float:
        """Pixel pitch along the search lines."""
        return float(np.hypot(*self.place_um))

    @property
    def turned(self) -> SearchStrip:
        """The same strip with its search lines transposed."""
        return SearchStrip(self.grey.T, self.there.T, self.corner_um, self.place_um, self.line_um)

    @property
    def reversed(self) -> SearchStrip:
        """The same strip with the direction of its search lines reversed."""
        last = self.grey.shape[1] - 1
        corner = self.corner_um[0] + last * self.place_um[0], self.corner_um[1] + last * self.place_um[1]
        back = -self.place_um[0], -self.place_um[1]
        return SearchStrip(self.grey[:, ::-1], self.there[:, ::-1], corner, self.line_um, back)

    def part(self, lines: slice, places: slice) -> SearchStrip:
        """Return some lines and places of it, as views; slices need a start and a step of one."""
        x, y = self.at(np.array(float(lines.start or 0)), np.array(float(places.start or 0)))
        grey, there = self.grey[lines, places], self.there[lines, places]
        return SearchStrip(grey, there, (float(x), float(y)), self.line_um, self.place_um)

    def at(self, line: Floats, place: Floats) -> tuple[Floats, Floats]:
        """Return stage x and y of lines and places, which may be fractional."""
        (x, y), (lx, ly), (px, py) = self.corner_um, self.line_um, self.place_um
        return x + line * lx + place * px, y + line * ly + place * py

    def where(self, x_um: Floats, y_um: Floats) -> tuple[Floats, Floats]:
        """Return lines and places of stage x and y: the inverse of `at`."""
        x, y = x_um - self.corner_um[0], y_um - self.corner_um[1]
        square = self.pixel_um**2
        line, place = ((x * way[0] + y * way[1]) / square for way in (self.line_um, self.place_um))
        return line, place


def read_strip(surface: Mosaic, region: Region, what: str) -> tuple[SearchStrip, int]:
    """Return the image of a region, with search lines along x, and the level it was read at.

    what: words of the error message, as in 'and a kerf width needs'. Raises MeasureError when the region has no area,
    lies outside, is smaller than 16 pixels either way, or has less than half of its area covered by the image.
    """
    require_area(region, "measured")
    level = level_for(surface, region)
    part = surface.window(region, level)
    _require_size(region, part, what)
    strip = strip_of(part)
    covered = np.count_nonzero(strip.there) * part.pixel_um**2
    x0, y0, x1, y1 = region.bounds_um
    share = covered / ((x1 - x0) * (y1 - y0))
    if share < LEAST_COVERED:
        raise MeasureError(
            f"Only {100 * share:.0f} % of the region lies on the picture and {what} needs {100 * LEAST_COVERED:.0f} %: "
            "move it to where fields were taken."
        )
    return strip, level


def strip_of(part: HeightMap) -> SearchStrip:
    """Return the image of a height map, without pixels that no field covers."""
    image = SearchStrip.of(part.all_in_focus, part.pixel_um, part.x0_um, part.y0_um)
    there = part.origin != Origin.NOT_COVERED
    return SearchStrip(image.grey, there, image.corner_um, image.line_um, image.place_um)


def require_rectangle(region: Region, what: str) -> None:
    """Raise MeasureError for another kind of region. what: as in 'A kerf width'."""
    if region.kind != "rectangle":
        raise MeasureError(f"{what} is measured in a rectangle, this region is a {region.kind}: draw a rectangle.")


def _require_size(region: Region, part: HeightMap, what: str) -> None:
    x0, y0, x1, y1 = region.bounds_um
    sides = (x1 - x0) / part.pixel_um, (y1 - y0) / part.pixel_um
    if min(sides) < LEAST_PX or min(part.shape) < LEAST_PX:
        raise MeasureError(
            f"The region is {sides[0]:.0f} x {sides[1]:.0f} pixels large and {what} needs at least "
            f"{LEAST_PX} x {LEAST_PX} on the surface: draw it larger."
        )
