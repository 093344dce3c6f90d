"""Full-resolution picking: refine the ray intersection with the surface heights near a click."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from wafer_viewer.gui.scene.heightfield import Box, Floats, HeightField
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.rendering.render_request import CoarseHeightField

Read = Callable[[int], Mosaic]
"""Returns the surface with a number; 0 is the stitched one."""
_REACH_PX, _MOST_PX = 4, 512
"""Margin around the ray's footprint in coarse pixels, and the most fine pixels per direction."""


def refine_height_field(read: Read, land: HeightField, origin: Floats, direction: Floats) -> HeightField:
    """Return the heights under a ray at the surface's resolution; the coarse heights if no finer ones can be read."""
    show, box = land.on_show.source.show, _ray_footprint(land, origin, direction)
    if show < 0:  # two surfaces compared are as coarse as they are drawn
        return land
    try:
        surface = read(show)
        if surface.pixel_um >= land.pixel_um:
            return land
        side_px = max(box[2] - box[0], box[3] - box[1]) / surface.pixel_um
        level = max(0, math.ceil(math.log2(max(1.0, side_px / _MOST_PX))))
        part = surface.window(Region.rectangle(*box), min(level, surface.levels - 1))
    except WaferViewerError:
        return land
    return HeightField(_relief(part, land), land.on_show, land.holes)


def _ray_footprint(land: HeightField, origin: Floats, direction: Floats) -> Box:
    """Return the footprint of a ray between the highest height and the ground, in um, with a margin."""
    on_show, reach_um = land.on_show, _REACH_PX * land.pixel_um
    levels = on_show.scene_z(on_show.facts.highest_um), 0.0
    ends = [1e3 * (origin + direction * ((z - origin[2]) / direction[2])) for z in levels]
    x, y = ([float(end[k]) for end in ends] for k in range(2))
    low, high = (
        land.clamped((min(x) - reach_um, min(y) - reach_um)),
        land.clamped((max(x) + reach_um, max(y) + reach_um)),
    )
    return *low, *high


def _relief(part: HeightMap, land: HeightField) -> CoarseHeightField:
    """Return a part of a surface relative to the displayed datum, with gaps filled from the coarse heights."""
    x_um, y_um = (np.asarray(a, np.float64) for a in np.meshgrid(part.x_um, part.y_um))
    datum = land.on_show.datum
    z_um = part.z_um - (datum.at(x_um, y_um) if datum is not None else 0.0)
    there = np.isfinite(z_um)
    z_um = np.where(there, z_um, land.z_um(x_um, y_um))
    return CoarseHeightField(
        *part.shape, part.pixel_um, part.x0_um, part.y0_um, z_um.astype("<f4").tobytes(), there.tobytes()
    )
