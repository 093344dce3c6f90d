"""Sources of surfaces and frames for the render process, and access to any level of a surface."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from wafer_viewer.draw.surface.texture_baking import reduced
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.measurement.levelling import Datum
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.rendering.render_refused import PlacedField
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey

Window = tuple[slice, slice]

COARSE_PIXELS = 400_000
"""Pixel count of the level for statistics, ranges and reliefs: detailed enough for each, and fast to read."""


class SurfaceProvider(Protocol):
    """Source of surfaces and frames; the render process uses the store, tests use maps in memory."""

    def surface(self, source: SurfaceKey) -> Mosaic:
        """Return the surface."""
        ...

    def stacks(self, source: SurfaceKey) -> list[FieldStack]:
        """Return the focus stack of the source's field, or those of all fields for the stitched surface."""
        ...

    def fields(self, source: SurfaceKey) -> Sequence[PlacedField]:
        """Return the fields of the surface, at their positions in it; empty for a surface without fields."""
        ...


def coarse_level(surface: Mosaic) -> int:
    """Return the finest level with at most `COARSE_PIXELS` pixels."""
    rows, cols = surface.shape
    level = 0
    while (rows >> level) * (cols >> level) > COARSE_PIXELS:
        level += 1
    return level


def at_level(surface: Mosaic, level: int, window: Window | None = None) -> HeightMap:
    """Return a window of a level's lattice; missing levels are computed from the coarsest stored one."""
    stored_level = min(level, surface.levels - 1)
    factor = 2 ** (level - stored_level)
    if window is None:
        return reduced(surface.window(None, stored_level), factor)
    rows, cols = (slice(w.start * factor, w.stop * factor) for w in window)
    return reduced(surface.window(_region(surface, stored_level, rows, cols), stored_level), factor)


def levelled(part: HeightMap, datum: Datum | None) -> HeightMap:
    """Return heights above a datum; without one, relative to the stage's zero."""
    if datum is None:
        return part
    zero = datum.at(part.x_um[None, :], part.y_um[:, None]).astype(np.float32)
    return dataclasses.replace(part, z_um=part.z_um - zero, z_raw_um=part.z_raw_um - zero)


def _region(surface: Mosaic, level: int, rows: slice, cols: slice) -> Region:
    """Return the rectangle through the centres of the outermost pixels of a window."""
    scale = 2**level
    pixel, shift = surface.pixel_um * scale, (scale - 1) / 2 * surface.pixel_um
    x0, y0 = surface.x0_um + shift, surface.y0_um - shift
    return Region.rectangle(
        x0 + cols.start * pixel, y0 - (rows.stop - 1) * pixel, x0 + (cols.stop - 1) * pixel, y0 - rows.start * pixel
    )


def coarse(provider: SurfaceProvider, request: RenderRequest) -> HeightMap:
    """Return the surface of a request above its datum: its window, or without one the complete coarse level."""
    surface = provider.surface(request.source)
    if request.rows[1]:
        return levelled(at_level(surface, request.level, (slice(*request.rows), slice(*request.cols))), request.datum)
    return levelled(at_level(surface, coarse_level(surface)), request.datum)
