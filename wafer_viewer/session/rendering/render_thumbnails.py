"""Thumbnails of a region of a surface, seen from above, for lists of results."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from wafer_viewer.draw.surface.block_mean import reduced
from wafer_viewer.draw.surface.display_style import DisplayStyle, Light
from wafer_viewer.draw.surface.glb import jpeg
from wafer_viewer.draw.surface.hillshade import light_gain
from wafer_viewer.draw.surface.texture_baking import bake, grey_image
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.rendering.surface_source import SurfaceProvider, levelled

SIDE_PX = 96
"""Maximum length in pixels of the longer side of a picture, unless the request specifies it."""
_QUALITY = 80
_UNMEASURED = np.array([200, 208, 216], np.uint8)


def picture(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return the box of a request as JPEG, over its own range of heights; no bytes if nothing of it is measured.

    Coloured by ``grey`` it is the all-in-focus image.
    """
    if request.box_um is None:
        return b""
    surface = shelf.surface(request.source)
    x0, y0, x1, y1 = request.box_um
    pixels = max(x1 - x0, y1 - y0) / surface.pixel_um
    level = max(0, math.ceil(math.log2(max(1.0, pixels / (request.side_px or SIDE_PX)))))
    kept = min(level, surface.levels - 1)
    part = levelled(
        reduced(surface.window(Region.rectangle(*request.box_um), kept), 2 ** (level - kept)), request.datum
    )
    there = np.isfinite(part.z_um)
    if 0 in part.shape or not there.any():
        return b""
    grey = request.look.colour_by == "grey"
    low, high = (float(v) for v in np.percentile(grey_image(part)[there] if grey else part.z_um[there], [1, 99]))
    span = max(high - low, 1e-3)
    heights = DisplayStyle(low=low, high=low + span, hillshade=0.6)
    look = replace(heights, colour_by="grey", colours="grey", hillshade=0.0) if grey else heights
    baked = bake(part, look, Light(light_gain(part.z_um, part.pixel_um), span))
    return jpeg(np.where(baked[..., 3:] > 0, baked[..., :3], _UNMEASURED), _QUALITY)
