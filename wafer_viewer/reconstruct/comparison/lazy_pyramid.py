"""Pyramid of a height map whose coarser levels are computed on first request."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Provenance, pixel_window
from wafer_viewer.reconstruct.blending.height_pyramid import halved

_COARSEST_PX = 256


@dataclass(frozen=True, eq=False)
class Reduced:
    """A `Mosaic` over a map in memory."""

    whole: HeightMap
    _made: list[HeightMap] = field(default_factory=list[HeightMap])

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.whole.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0) of level 0."""
        return self.whole.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0) of level 0."""
        return self.whole.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.whole.shape

    @property
    def levels(self) -> int:
        """Number of levels until the longer side is about 256 pixels."""
        return 1 + max(0, math.ceil(math.log2(max(self.shape) / _COARSEST_PX)))

    @property
    def provenance(self) -> Provenance:
        """Provenance of the map."""
        return self.whole.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region. Raises MeasureError if either does not exist."""
        if not 0 <= level < self.levels:
            raise MeasureError(f"The surface has levels 0 to {self.levels - 1}, level {level} was asked for.")
        if region is None:
            return self._at(level)
        return self._at(level).crop(*pixel_window(self, region, level))

    def _at(self, level: int) -> HeightMap:
        if level == 0:
            return self.whole
        while len(self._made) < level:
            self._made.append(halved(self._made[-1] if self._made else self.whole))
        return self._made[level - 1]


def as_pyramid(surface: Mosaic) -> Mosaic:
    """Return the surface itself, or a pyramid over it if it is a map with one level."""
    return Reduced(surface) if isinstance(surface, HeightMap) else surface
