"""Pictures of a report: places on the surface with the profile across them, whole surfaces, stored pictures, a logo."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageColor

from wafer_viewer.draw.charts.marked_map import HATCH, place_svg
from wafer_viewer.draw.charts.profile_plot import profile_svg
from wafer_viewer.draw.surface.display_style import DisplayStyle, Light
from wafer_viewer.draw.surface.texture_baking import bake, light_gain
from wafer_viewer.model.errors import DatasetError, MeasureError, detail, parser_errors_as
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.sections import Section, SectionRequest
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.reporting.report_data import Material, bounds_of, outline_um
from wafer_viewer.store.io.guarded_reading import require_pixels

WHOLE_PX, PLACE_PX, PICTURE_PX, LOGO_PX = 1400, 320, 1600, 400
ROUND_A_PLACE, LEAST_UM = 0.7, 20.0
"""Margin around a region as a fraction of its size, and minimum width of a picture in um."""
HATCHES, LEAST_HATCH_PX = 110, 6
"""Lines of the hatch along the longer side of a picture, and their least distance in px."""
PROFILE_PX = 430, 200
BEYOND = 0.75
"""Length of a profile beyond the centres of its places, as a share of their extent along it."""
BAND_POINTS = 600
NEARLY_ALL, LEAST_RANGE_UM = (0.5, 99.5), 0.2
"""Percentiles of heights that the colours of a place cover, and their least range in um, which does not show noise."""
JPEG_QUALITY = 85


def whole_picture(mosaic: Mosaic, low_um: float, high_um: float) -> str:
    """Return the surface from above, as a data URL."""
    level = _level(mosaic, max(mosaic.shape), WHOLE_PX)
    return map_picture(mosaic.window(level=level), low_um, high_um, WHOLE_PX)


def place_picture(surface: Mosaic, box_um: tuple[float, float, float, float], low_um: float, high_um: float) -> str:
    """Return the square surroundings of a region; empty if the region is outside of the surface."""
    part = _surroundings(surface, box_um)
    return map_picture(part, low_um, high_um, PLACE_PX) if part is not None else ""


def _surroundings(surface: Mosaic, box_um: tuple[float, float, float, float]) -> HeightMap | None:
    x, y = (box_um[0] + box_um[2]) / 2, (box_um[1] + box_um[3]) / 2
    half = max(LEAST_UM, (1 + 2 * ROUND_A_PLACE) * max(box_um[2] - box_um[0], box_um[3] - box_um[1])) / 2
    level = _level(surface, round(2 * half / surface.pixel_um), PLACE_PX)
    try:
        part = surface.window(Region.rectangle(x - half, y - half, x + half, y + half), level)
    except MeasureError:
        return None
    return part if 0 not in part.shape else None


def views_of(material: Material, places: tuple[Region, ...], finding: AnyResult | None = None) -> dict[str, Any]:
    """Return the picture of the places of a feature or result, and the profile across them, as fields of a sheet."""
    surface, info = _surface(material, finding.show if finding is not None else 0), material.info
    if not places or surface is None or info is None:
        return {}
    part = _surroundings(surface, bounds_of(places))
    if part is None:
        return {}
    line = line_across(places)
    url = map_picture(part, *_range_um(part, info.low_um, info.high_um), PLACE_PX)
    return {
        "picture": place_svg(url, outline_um(part), places, line),
        "profile": _profile(surface, line, places, finding),
    }


def _range_um(part: HeightMap, low_um: float, high_um: float) -> tuple[float, float]:
    """Return the range of heights of a place, that of the whole surface if it has none."""
    z_um = part.z_um[np.isfinite(part.z_um)]
    if not z_um.size:
        return low_um, high_um
    low, high = np.percentile(z_um, NEARLY_ALL).tolist()
    return low, max(high, low + LEAST_RANGE_UM)


def line_across(places: tuple[Region, ...]) -> Region:
    """Return the line of a result, or one through its first two places, or across its only one."""
    drawn = next((place for place in places if place.is_path), None)
    if drawn is not None:
        return drawn
    ends = places[0], places[min(1, len(places) - 1)]
    (x0, y0), (x1, y1) = map(_centre, ends)
    length = float(np.hypot(x1 - x0, y1 - y0))
    across, up = ((x1 - x0) / length, (y1 - y0) / length) if length else (1.0, 0.0)
    before, after = (BEYOND * max(LEAST_UM, _extent(place, across, up)) for place in ends)
    return Region.line(x0 - before * across, y0 - before * up, x1 + after * across, y1 + after * up)


def _centre(place: Region) -> tuple[float, float]:
    x0, y0, x1, y1 = place.bounds_um
    return (x0 + x1) / 2, (y0 + y1) / 2


def _extent(place: Region, across: float, up: float) -> float:
    """Return the length of a direction inside the bounds of a place."""
    x0, y0, x1, y1 = place.bounds_um
    sides = ((x1 - x0) / abs(across) if across else np.inf, (y1 - y0) / abs(up) if up else np.inf)
    return float(min(sides))


def _profile(surface: Mosaic, line: Region, places: tuple[Region, ...], finding: AnyResult | None) -> str:
    """Return the section along a line with the places on it; empty if too little of it was measured."""
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.measure.tools.profile import profile

    levelling = finding.levelling if finding is not None else Levelling()
    try:
        numbers, curve = profile(levelled(surface, levelling), line, layer=finding.surface if finding else None)
    except MeasureError:
        return ""
    section = Section(SectionRequest(place=0, line=line, levelling=levelling), numbers, curve, "")
    bands = [band for place in places for band in _along(line, place)]
    return profile_svg(section, PROFILE_PX, bands)


def _along(line: Region, place: Region) -> Iterator[tuple[float, float]]:
    """Yield the parts of a line inside a place, as distances from its first end."""
    from wafer_viewer.measure.tools.profile import length_um_of, samples_along

    path = samples_along(line, length_um_of(line) / BAND_POINTS)
    inside = place.contains(path.x_um, path.y_um)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    for first, last in ends.reshape(-1, 2).tolist():
        yield float(path.distance_um[first]), float(path.distance_um[last - 1])


def _surface(material: Material, show: int) -> Mosaic | None:
    """Return the stitched surface, or that of a field; None if it is missing, or the result is of no surface."""
    if show <= 0:
        return material.result.mosaic() if show == 0 and material.result.has_mosaic else None
    field = material.dataset.field(show)
    return material.result.surface(field) if material.result.surfaces_done([field]) else None


def logo_picture(path: Path) -> str:
    """Return the logo of a laboratory on white, as a data URL."""
    with parser_errors_as(partial(_no_picture, path)), Image.open(path) as picture:
        require_pixels(path.name, picture.height, picture.width)
        logo = picture.convert("RGBA")
        return _url(Image.alpha_composite(Image.new("RGBA", logo.size, "white"), logo).convert("RGB"), LOGO_PX)


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


def map_picture(part: HeightMap, low_um: float, high_um: float, most_px: int) -> str:
    """Return a surface from above with colours between two heights, as a data URL; empty if it has no pixels."""
    if 0 in part.shape:
        return ""
    light = Light(light_gain(part.z_um, part.pixel_um), max(high_um - low_um, 1e-6))
    baked = Image.fromarray(bake(part, DisplayStyle(low=low_um, high=high_um), light))
    baked.thumbnail((most_px, most_px), Image.Resampling.LANCZOS)
    hatched = _hatched(baked.size)
    hatched.paste(baked, (0, 0), baked)
    return _url(hatched, most_px)


def _hatched(size: tuple[int, int]) -> Image.Image:
    """Return the hatch of what is not measured."""
    period = max(LEAST_HATCH_PX, max(size) // HATCHES)
    column, row = np.arange(size[0]), np.arange(size[1])[:, None]
    lines = (column + row) % period < 0.4 * period
    ground, line = (np.array(ImageColor.getrgb(colour), np.uint8) for colour in HATCH)
    return Image.fromarray(np.where(lines[..., None], line, ground))


def _url(picture: Image.Image, most_px: int) -> str:
    if max(picture.size) > most_px:
        picture.thumbnail((most_px, most_px), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
