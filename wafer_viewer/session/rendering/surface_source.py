"""Where the painter finds surfaces and frames, and how it reads any level of one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from wafer_viewer.draw.surface.block_mean import reduced
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.measurement.levelling import Datum
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.rendering.render_refused import PlacedField
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey

Window = tuple[slice, slice]

COARSE_PIXELS = 400_000
"""What facts, ranges and reliefs are taken from: enough for any of them, and read in a moment."""


class SurfaceProvider(Protocol):
    """Where surfaces and frames are found; the painter's is the store, tests have maps in memory."""

    def surface(self, source: SurfaceKey) -> Mosaic:
        """The surface."""
        ...

    def stacks(self, source: SurfaceKey) -> list[FieldStack]:
        """The focus stack of the source's field, or those of all fields for the stitched surface."""
        ...

    def fields(self, source: SurfaceKey) -> Sequence[PlacedField]:
        """The fields that the surface is made of, each where the surface shows it; none of what has no fields."""
        ...


def coarse_level(surface: Mosaic) -> int:
    """The finest level of at most `COARSE_PIXELS`."""
    rows, cols = surface.shape
    level = 0
    while (rows >> level) * (cols >> level) > COARSE_PIXELS:
        level += 1
    return level


def at_level(surface: Mosaic, level: int, window: Window | None = None) -> HeightMap:
    """A window of a level's lattice; levels that the surface does not keep are made from the coarsest it has."""
    kept = min(level, surface.levels - 1)
    factor = 2 ** (level - kept)
    if window is None:
        return reduced(surface.window(None, kept), factor)
    rows, cols = (slice(w.start * factor, w.stop * factor) for w in window)
    return reduced(surface.window(_region(surface, kept, rows, cols), kept), factor)


def levelled(part: HeightMap, datum: Datum | None) -> HeightMap:
    """Heights over a datum; those of the stage where there is none."""
    if datum is None:
        return part
    zero = datum.at(part.x_um[None, :], part.y_um[:, None]).astype(np.float32)
    return dataclasses.replace(part, z_um=part.z_um - zero, z_raw_um=part.z_raw_um - zero)


def _region(surface: Mosaic, level: int, rows: slice, cols: slice) -> Region:
    """The rectangle through the centres of the outermost pixels of a window."""
    scale = 2**level
    pixel, shift = surface.pixel_um * scale, (scale - 1) / 2 * surface.pixel_um
    x0, y0 = surface.x0_um + shift, surface.y0_um - shift
    return Region.rectangle(
        x0 + cols.start * pixel, y0 - (rows.stop - 1) * pixel, x0 + (cols.stop - 1) * pixel, y0 - rows.start * pixel
    )


def coarse(shelf: SurfaceProvider, request: RenderRequest) -> HeightMap:
    """The surface of a request over its datum: the window it names, without one all of it at its coarse level."""
    surface = shelf.surface(request.source)
    if request.rows[1]:
        return levelled(at_level(surface, request.level, (slice(*request.rows), slice(*request.cols))), request.datum)
    return levelled(at_level(surface, coarse_level(surface)), request.datum)
