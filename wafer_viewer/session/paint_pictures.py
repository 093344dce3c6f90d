"""Small pictures of a place on a surface, seen from above: what stands beside a result in a list."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.draw.bake import bake
from wafer_viewer.draw.glb import jpeg
from wafer_viewer.draw.look import Light, Look
from wafer_viewer.draw.reduce import reduced
from wafer_viewer.draw.shade import light_gain
from wafer_viewer.model.region import Region
from wafer_viewer.session.paint_request import PaintRequest
from wafer_viewer.session.shelf import Shelf, levelled

SIDE_PX = 96
"""The longer side of a picture has at most so many pixels, where the request does not say."""
_QUALITY = 80
_UNMEASURED = np.array([200, 208, 216], np.uint8)


def picture(shelf: Shelf, request: PaintRequest) -> bytes:
    """The box of a request as JPEG, over its own range of heights; no bytes where nothing of it is measured.

    With the all-in-focus image in the look there is that much less of light and colours.
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
    low, high = (float(v) for v in np.percentile(part.z_um[there], [1, 99]))
    span = max(high - low, 1e-3)
    image = request.look.all_in_focus
    look = Look(low=low, high=low + span, hillshade=0.6 * (1 - image), all_in_focus=image)
    baked = bake(part, look, Light(light_gain(part.z_um, part.pixel_um), span))
    return jpeg(np.where(baked[..., 3:] > 0, baked[..., :3], _UNMEASURED), _QUALITY)
