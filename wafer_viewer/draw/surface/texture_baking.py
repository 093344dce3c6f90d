"""Texture baking for a height map: colours of a quantity, lighting, and the all-in-focus image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import BRUSH, ELSEWHERE, origin_table, rgb, table
from wafer_viewer.draw.surface.clipping import depth_shade
from wafer_viewer.draw.surface.display_style import DisplayStyle, Form, Light, Plane, Quantity
from wafer_viewer.draw.surface.hillshade import Shading, shade, without_gaps
from wafer_viewer.model.surface.height_map import HeightMap, Origin

Picture = NDArray[np.uint8]
_BRUSH_SHARE = 0.86
"""Share of the brush colour in a brushed point."""


def plane_um(part: HeightMap, plane: Plane) -> NDArray[np.float32]:
    """Return the heights of a plane on the lattice of a map."""
    a, b, c = plane
    return (a * part.x_um[None, :] + b * part.y_um[:, None] + c).astype(np.float32)


def form_um(part: HeightMap, form: Form) -> NDArray[np.float32]:
    """Return the heights of a second-order form on the lattice of a map."""
    if not form:
        return np.zeros(part.shape, np.float32)
    u, v = (part.x_um[None, :] - form[0]) / form[2], (part.y_um[:, None] - form[1]) / form[2]
    a, b, c, d, e, f = form[3:]
    return np.asarray(a + b * u + c * v + d * u * u + e * u * v + f * v * v, np.float32)


def slope_degrees(part: HeightMap) -> NDArray[np.float32]:
    """Return the steepest slope at each pixel; NaN next to a gap."""
    down, right = np.gradient(part.z_um, part.pixel_um)
    return np.degrees(np.arctan(np.hypot(down, right))).astype(np.float32)


def overlap_um(part: HeightMap) -> NDArray[np.float32]:
    """Return the height difference between overlapping fields, NaN elsewhere."""
    return np.full_like(part.z_um, np.nan) if part.overlap_um is None else part.overlap_um


def grey_image(part: HeightMap) -> NDArray[np.float32]:
    """Return the all-in-focus image in 0 ... 1."""
    image = part.all_in_focus
    return image.astype(np.float32) / np.float32(np.iinfo(image.dtype).max)


VALUES: dict[Quantity, Callable[[HeightMap, Light], NDArray[np.float32]]] = {
    "height": lambda part, light: part.z_um,
    "confidence": lambda part, light: np.where(np.isfinite(part.z_um), part.confidence, np.nan),
    "slope": lambda part, light: slope_degrees(part),
    "deviation": lambda part, light: part.z_um - plane_um(part, light.plane),
    "form": lambda part, light: part.z_um - form_um(part, light.form),
    "overlap": lambda part, light: overlap_um(part),
    "grey": lambda part, light: grey_image(part),
    "origin": lambda part, light: part.origin.astype(np.float32),
    "difference": lambda part, light: part.z_um,
}
"""Values of each quantity of `QUANTITIES` per pixel; NaN where unknown."""


def bake(part: HeightMap, look: DisplayStyle, light: Light, filled_um: NDArray[np.float32] | None = None) -> Picture:
    """Return the texture of a height map in display colours, uint8 rgba [row, col, 4]; alpha 0 where nothing is drawn.

    filled_um: its heights `without_gaps`, if already computed.
    """
    heights = without_gaps(part.z_um) if filled_um is None else filled_um
    colour = _with_image(_coloured(part, look, light, heights), part, look.all_in_focus)
    colour = _with_brush(colour, part.z_um, look.brush_um)
    lit = _lit(colour, shade(heights, part.pixel_um, light.gain, light.span_um), look.hillshade)
    if look.depth_shade > 0:
        darkened = 1 - depth_shade(heights, part.pixel_um, light.gain)
        lit = lit * (1 - np.float32(look.depth_shade) * darkened)[..., None]
    shown = np.isfinite(part.z_um) if look.colour_by != "origin" else part.origin != Origin.NOT_COVERED
    return np.dstack([lit.astype(np.uint8), np.where(shown, 255, 0).astype(np.uint8)])


def _coloured(part: HeightMap, look: DisplayStyle, light: Light, heights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return colours 0 ... 255 before lighting; gaps take the nearest colour, so that filtering has no fringes."""
    if look.colour_by == "origin":
        return origin_table()[part.origin].astype(np.float32)
    values = VALUES[look.colour_by](part, light)
    if look.colour_by == "overlap":
        known = np.isfinite(values)
        return np.where(known[..., None], _by_value(np.where(known, values, 0), look), np.array(ELSEWHERE, np.float32))
    return _by_value(heights if values is part.z_um else without_gaps(values), look)


def _by_value(values: NDArray[np.float32], look: DisplayStyle) -> NDArray[np.float32]:
    """Return the colours of a display style for values without gaps."""
    place = (values - look.low) / max(look.high - look.low, 1e-12)
    return table(look.colours)[(np.clip(place, 0, 1) * 255).astype(np.uint8)].astype(np.float32)


def _with_image(colour: NDArray[np.float32], part: HeightMap, share: float) -> NDArray[np.float32]:
    """Return the colours tinted by the all-in-focus image, which darkens and lightens them."""
    if share <= 0:
        return colour
    tint = np.float32(0.35) + np.float32(0.9) * grey_image(part)[..., None] ** np.float32(0.8)
    return (colour * (1 - share + share * tint)).astype(np.float32)


def _with_brush(
    colour: NDArray[np.float32], z_um: NDArray[np.float32], brush_um: tuple[float, float] | None
) -> NDArray[np.float32]:
    """Return the colours with the brushed heights highlighted, mixed with a little of their own colour."""
    if brush_um is None:
        return colour
    lit = np.float32(_BRUSH_SHARE) * np.array(rgb(BRUSH), np.float32) + np.float32(1 - _BRUSH_SHARE) * colour
    return np.where(((z_um >= brush_um[0]) & (z_um <= brush_um[1]))[..., None], lit, colour)


def _lit(colour: NDArray[np.float32], shading: Shading, strength: float) -> NDArray[np.float32]:
    """Return the colours under lighting; strength 0 leaves them as in the colour bar."""
    if strength <= 0:
        return colour
    factor = 1 + np.float32(0.85 * strength) * (np.minimum(shading.lambert, 1.6) - 1)
    factor *= 1 - np.float32(1.2 * strength) * shading.occlusion
    lit = colour * factor[..., None] + np.float32(38 * strength) * shading.gloss[..., None]
    return np.clip(lit, 0, 255).astype(np.float32)
