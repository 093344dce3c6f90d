"""Report pictures: the surface from above, the region of each result, and stored pictures at print size."""

from __future__ import annotations

import base64
import io
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from wafer_viewer.draw.surface.display_style import DisplayStyle, Light
from wafer_viewer.draw.surface.texture_baking import bake, light_gain
from wafer_viewer.model.errors import DatasetError, MeasureError, detail, parser_errors_as
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.store.io.guarded_reading import require_pixels

WHOLE_PX, PLACE_PX, PICTURE_PX = 1400, 320, 1600
ROUND_A_PLACE, LEAST_UM = 0.7, 20.0
"""Margin around a region as a fraction of its size, and minimum width of a picture in um."""
UNMEASURED = (222, 226, 231)
JPEG_QUALITY = 85


def whole_picture(mosaic: Mosaic, low_um: float, high_um: float) -> str:
    """Return the surface from above, as a data URL."""
    level = _level(mosaic, max(mosaic.shape), WHOLE_PX)
    return _picture(mosaic.window(level=level), low_um, high_um, WHOLE_PX)


def place_picture(surface: Mosaic, box_um: tuple[float, float, float, float], low_um: float, high_um: float) -> str:
    """Return the square surroundings of a region; empty if the region is outside of the surface."""
    x, y = (box_um[0] + box_um[2]) / 2, (box_um[1] + box_um[3]) / 2
    half = max(LEAST_UM, (1 + 2 * ROUND_A_PLACE) * max(box_um[2] - box_um[0], box_um[3] - box_um[1])) / 2
    level = _level(surface, round(2 * half / surface.pixel_um), PLACE_PX)
    try:
        part = surface.window(Region.rectangle(x - half, y - half, x + half, y + half), level)
    except MeasureError:
        return ""
    return _picture(part, low_um, high_um, PLACE_PX)


def taken_picture(path: Path) -> str:
    """Return a stored picture of print size, reduced for reports, as a data URL."""
    with parser_errors_as(partial(_no_picture, path)), Image.open(path) as picture:
        require_pixels(path.name, picture.height, picture.width)
        return _url(picture.convert("RGB"), PICTURE_PX)


def _no_picture(path: Path, fault: Exception) -> DatasetError:
    return DatasetError(f"{path} is no picture{detail(fault)}: remove it.")


def _level(surface: Mosaic, wide_px: int, target_px: int) -> int:
    """Return the coarsest level that still has the requested number of pixels."""
    return min(surface.levels - 1, max(0, int(np.log2(max(wide_px, 1) / target_px))))


def _picture(part: HeightMap, low_um: float, high_um: float, most_px: int) -> str:
    if 0 in part.shape:
        return ""
    light = Light(light_gain(part.z_um, part.pixel_um), max(high_um - low_um, 1e-6))
    baked = Image.fromarray(bake(part, DisplayStyle(low=low_um, high=high_um), light))
    paper = Image.new("RGB", baked.size, UNMEASURED)
    paper.paste(baked, (0, 0), baked)
    return _url(paper, most_px)


def _url(picture: Image.Image, most_px: int) -> str:
    if max(picture.size) > most_px:
        picture.thumbnail((most_px, most_px), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
