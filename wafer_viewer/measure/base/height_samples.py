"""Height samples of a region: layer, mask and pyramid level used by a measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import (
    HasLayers,
    HeightLayer,
    HeightMap,
    Heights,
    Mosaic,
    ProvidesTexture,
    TexturedHeights,
    picture_of,
)
from wafer_viewer.model.surface.recipe import Recipe

Layer = HeightLayer
Floats = NDArray[np.float64]
MAX_PIXELS = 2_000_000
"""Regions with more pixels are measured at a coarser level, whose pixels are means."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightSamples:
    """Measured points of a region, each array float64 [n], in stage um."""

    x_um: Floats
    y_um: Floats
    z_um: Floats

    def __len__(self) -> int:
        return len(self.z_um)

    def select(self, mask: NDArray[np.bool_]) -> HeightSamples:
        """Return the points selected by a mask."""
        return HeightSamples(self.x_um[mask], self.y_um[mask], self.z_um[mask])

    def and_also(self, others: HeightSamples) -> HeightSamples:
        """Return these points followed by the others."""
        pairs = ((self.x_um, others.x_um), (self.y_um, others.y_um), (self.z_um, others.z_um))
        return HeightSamples(*(np.concatenate(pair) for pair in pairs))


def layer_of(recipe: Recipe, layer: Layer | None) -> Layer:
    """Return the given layer, or by default the one that the recipe measures on."""
    require_choice("layer", layer, Layer | None, MeasureError)
    return layer or recipe.measure_on


def heights(surface: HeightMap, layer: Layer) -> NDArray[np.float32]:
    """Return the heights [row, col] of a layer, NaN where invalid.

    Filled pixels are valid only in the layer 'filled'.
    """
    if layer == "unsmoothed":
        return surface.z_raw_um
    if layer == "filled":
        return surface.z_um
    return np.where(surface.measured, surface.z_um, np.float32(np.nan))


def height_window(surface: Mosaic, layer: Layer, region: Region, level: int) -> Heights:
    """Return one layer of the part of a surface that contains a region.

    Only that layer is read where the surface supports it.
    """
    if isinstance(surface, HasLayers):
        return surface.one_layer(layer, region, level)
    part = surface.window(region, level)
    return Heights(heights(part, layer), part.pixel_um, part.x0_um, part.y0_um)


def pictured_window(surface: Mosaic, layer: Layer, region: Region, level: int = 0) -> TexturedHeights:
    """Return one height layer and the image of the part of a surface that contains a region.

    Raises MeasureError when the region lies outside the surface.
    """
    if isinstance(surface, ProvidesTexture):
        return surface.pictured(layer, region, level)
    part = surface.window(region, level)
    picture = picture_of(part.all_in_focus, part.origin)
    return TexturedHeights(heights(part, layer), part.pixel_um, part.x0_um, part.y0_um, picture)


def points_in(surface: Mosaic, region: Region, layer: Layer, level: int) -> HeightSamples:
    """Return the measured points of a region. Raises MeasureError when the region lies outside the surface."""
    part = height_window(surface, layer, region, level)
    rows, cols = np.nonzero(np.isfinite(part.z_um) & region.contains(part.x_um[None, :], part.y_um[:, None]))
    return HeightSamples(part.x_um[cols], part.y_um[rows], part.z_um[rows, cols].astype(np.float64))


def level_for(surface: Mosaic, *regions: Region) -> int:
    """Return the finest level at which no region has more than MAX_PIXELS pixels."""
    pixels = max(_area_um2(region) for region in regions) / surface.pixel_um**2
    return min(surface.levels - 1, max(0, math.ceil(math.log(max(pixels, 1) / MAX_PIXELS, 4))))


def level_note(surface: Mosaic, level: int) -> tuple[str, ...]:
    """Return the note for a result measured at a coarser level; empty at level 0."""
    return (f"Read at level {level}: each pixel is the mean of {4**level}.",) if level else ()


def require_region(region: object, what: str) -> None:
    """Raise MeasureError for what is no region."""
    if not isinstance(region, Region):
        raise MeasureError(f"The {what} region is {region!r}: give a Region, as of Region.rectangle(x0, y0, x1, y1).")


def require_area(region: Region, what: str) -> None:
    """Raise MeasureError for what is no region, and for a line or a point, which have no area to measure."""
    require_region(region, what)
    if region.is_path or region.kind == "point":
        raise MeasureError(
            f"The {what} region is a {region.kind} and has no area: draw a rectangle, a circle or a polygon."
        )


def _area_um2(region: Region) -> float:
    x0, y0, x1, y1 = region.bounds_um
    return (x1 - x0) * (y1 - y0)
