"""Texture baking for a height map: colours of a quantity, lighting, clipping, and the all-in-focus image.

All functions take heights without gaps (`without_gaps`) and a gain that `light_gain` derives from the surface, so that
a lapped block and a bumped die both show their relief, independent of pixel size and exaggeration.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter

from wafer_viewer.draw.colormaps import BRUSH, ELSEWHERE, Rgb, origin_table, rgb, table
from wafer_viewer.draw.raster_text import font, write
from wafer_viewer.draw.surface.display_style import DisplayStyle, Form, Light, Plane, Quantity
from wafer_viewer.model.surface.clipping import LEFT_OUT, Clip, LeftOut
from wafer_viewer.model.surface.height_map import HeightMap, Origin

# --------------------------------------------------------------------------------------------------------- ground plane


@dataclass(frozen=True, slots=True)
class GroundLabel:
    """Number next to the block: position in mm from the image's top left corner, text height and anchor (l, m, r)."""

    text: str
    x_mm: float
    y_mm: float
    height_mm: float
    align: str


def shadow(
    outline_mm: Sequence[tuple[float, float]],
    width_mm: float,
    height_mm: float,
    blur_mm: float,
    *,
    darkness: float,
    shade: Rgb,
    ink: Rgb = (0, 0, 0),
    figures: tuple[GroundLabel, ...] = (),
    long_side_px: int = 1600,
) -> Picture:
    """Return the soft shadow of an outline in an image of width x height mm, with labels drawn into it, as rgba.

    Positions are in mm from the top left corner, y downwards. Shadow and labels share one image, because two
    translucent images in one plane would hide parts of each other.
    """
    px_per_mm = long_side_px / max(width_mm, height_mm)
    soft = _soft(outline_mm, (round(width_mm * px_per_mm), round(height_mm * px_per_mm)), px_per_mm, blur_mm) * darkness
    if not figures:
        return np.dstack([np.full((*soft.shape, 3), shade, np.uint8), (soft * 255).astype(np.uint8)])
    letters = _letters(soft.shape, figures, px_per_mm)
    alpha = letters + soft * (1 - letters)
    share = letters / np.maximum(alpha, 1e-6)
    picture = np.empty((*soft.shape, 4), np.uint8)
    for channel in range(3):  # three channels at once would take 24 bytes per pixel, several times
        picture[..., channel] = ink[channel] * share + shade[channel] * (1 - share)
    picture[..., 3] = alpha * 255
    return picture


_SMALLER = 8


def _soft(
    outline_mm: Sequence[tuple[float, float]], size_px: tuple[int, int], px_per_mm: float, blur_mm: float
) -> NDArray[np.float32]:
    """Return a blurred polygon in 0 ... 1; it is blurred at low resolution and enlarged for speed."""
    small = Image.new("L", (max(8, size_px[0] // _SMALLER), max(8, size_px[1] // _SMALLER)), 0)
    scale = px_per_mm / _SMALLER
    ImageDraw.Draw(small).polygon([(x * scale, y * scale) for x, y in outline_mm], fill=255)
    blurred = small.filter(ImageFilter.GaussianBlur(blur_mm * scale))
    return (np.asarray(blurred.resize(size_px, Image.Resampling.BILINEAR)) / 255).astype(np.float32)


def _letters(shape: tuple[int, ...], figures: tuple[GroundLabel, ...], px_per_mm: float) -> NDArray[np.float32]:
    image = Image.new("L", (shape[1], shape[0]), 0)
    pen = ImageDraw.Draw(image)
    for figure in figures:
        face = font(figure.height_mm * px_per_mm * 0.76)
        place = (figure.x_mm * px_per_mm, figure.y_mm * px_per_mm)
        write(pen, place, figure.text, face, 255, align=figure.align)
    return (np.asarray(image) / 255).astype(np.float32)


def hatch(rows: int, cols: int, *, dark: bool, pitch_px: int = 26, line_px: int = 5) -> Picture:
    """Return diagonal lines, rgb: the ground seen through holes, and the legend pattern for 'not measured'."""
    lines = np.add.outer(np.arange(rows), np.arange(cols)) % pitch_px < line_px
    ground, line = ((28, 34, 41), (92, 104, 116)) if dark else ((203, 211, 219), (132, 145, 158))
    return np.where(lines[..., None], np.array(line, np.uint8), np.array(ground, np.uint8))


WALL_TONES: dict[bool, tuple[Rgb, Rgb]] = {False: ((116, 130, 144), (92, 105, 118)), True: ((76, 87, 99), (52, 61, 71))}
"""Top and bottom colours of the walls between the surface and its lowest height, by dark theme."""
PLINTH_TONES: dict[bool, tuple[Rgb, Rgb]] = {False: ((92, 105, 118), (70, 82, 94)), True: ((52, 61, 71), (34, 41, 48))}
"""Top and bottom colours of the plinth below the lowest height, by dark theme."""
_SIDE_SHADES = (1.0, 0.94, 1.1, 0.86)
"""Brightness of the south, north, west and east sides, with light from the north-west and above."""


def sides(top: Rgb, foot: Rgb) -> Picture:
    """Return the texture of four walls for `mesh.walls`: eight columns per side, darker towards the bottom."""
    down = np.linspace(0, 1, 32)[:, None, None]
    shades = np.repeat(np.array(_SIDE_SHADES), 8)[None, :, None]
    return np.clip((np.array(top) * (1 - down) + np.array(foot) * down) * shades, 0, 255).astype(np.uint8)


# ------------------------------------------------------------------------------------------------------- texture baking


Floats = NDArray[np.float64]

DRAWN = 0
CODES: dict[LeftOut, int] = {reason: code for code, reason in enumerate(LEFT_OUT, 1)}

_RADII_PX = (1, 3, 9)
_DIRECTIONS = (
    *((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)),
    *((0.7, 0.7), (-0.7, 0.7), (0.7, -0.7), (-0.7, -0.7)),
)
_DARKEST, _PER_SLOPE = 0.28, 0.55
"""Darkest shade and its rate, chosen so that baked shading resembles eye-dome lighting."""


def clip_codes(part: HeightMap, clip: Clip) -> NDArray[np.uint8]:
    """Return the reason why each pixel is clipped as a code of `CODES`, or `DRAWN`; uint8 [row, col]."""
    return point_codes(part.x_um[None, :], part.y_um[:, None], part.z_um, part.confidence, clip)


def point_codes(
    x_um: Floats, y_um: Floats, z_um: NDArray[np.float32], confidence: NDArray[np.float32], clip: Clip
) -> NDArray[np.uint8]:
    """Return the reason why each point is not drawn.

    Parameters
    ----------
    x_um, y_um
        Positions in um; they broadcast to the shape of `z_um`.
    z_um, confidence
        Height in um and confidence from 0 to 1 of each point.
    clip
        Clipping limits.

    Returns
    -------
    NDArray[np.uint8]
        A code of `CODES`, or `DRAWN`, in the shape of `z_um`.
    """
    codes = np.zeros(z_um.shape, np.uint8)
    if clip.box_um is not None:
        x0, y0, x1, y1 = clip.box_um
        inside = ((y_um >= y0) & (y_um <= y1)) & ((x_um >= x0) & (x_um <= x1))
        _mark(codes, ~inside, "box")
    if clip.heights_um is not None:
        low, high = clip.heights_um
        _mark(codes, (z_um < low) | (z_um > high), "height")
    if clip.least_confidence > 0:
        _mark(codes, confidence < clip.least_confidence, "confidence")
    if clip.slab is not None and clip.slab.before != "show":
        line = clip.slab.line
        _mark(codes, line.along_and_across_um(x_um, y_um)[1] < -line.width_um / 2, "slab")
    return codes


def depth_shade(z_um: NDArray[np.float32], pixel_um: float, gain: float) -> NDArray[np.float32]:
    """Return the brightness of each pixel under occlusion by its surroundings, 0.28 ... 1; `gain` scales slopes.

    z_um: heights without gaps. It does not depend on the camera, so it is baked into a tile once.
    """
    steepness = np.zeros_like(z_um)
    for radius in _RADII_PX:
        for dx, dy in _DIRECTIONS:
            higher = _shifted(z_um, round(dy * radius), round(dx * radius)) - z_um
            steepness += np.maximum(0, higher) / np.float32(radius * pixel_um * len(_DIRECTIONS))
    return np.maximum(_DARKEST, np.exp(-_PER_SLOPE * gain * steepness)).astype(np.float32)


def _mark(codes: NDArray[np.uint8], out: NDArray[np.bool_], why: LeftOut) -> None:
    codes[(codes == DRAWN) & out] = CODES[why]


def _shifted(z_um: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """Return the heights shifted by some pixels, with edge values repeated."""
    rows = np.clip(np.arange(z_um.shape[0]) + down, 0, z_um.shape[0] - 1)
    cols = np.clip(np.arange(z_um.shape[1]) + right, 0, z_um.shape[1] - 1)
    return z_um[rows[:, None], cols[None, :]]


Heights = NDArray[np.float32]

_AZIMUTH, _ALTITUDE = np.radians(315.0), np.radians(42.0)
_LIGHT = np.array([np.sin(_AZIMUTH) * np.cos(_ALTITUDE), np.cos(_AZIMUTH) * np.cos(_ALTITUDE), np.sin(_ALTITUDE)])
_UP = np.array([0.0, 0.0, 1.0])
_HALFWAY = (_LIGHT + _UP) / np.linalg.norm(_LIGHT + _UP)
_GLOSS_EXPONENT = 60
_NOISE_PX = 0.9
"""Sigma of the smoothing before differentiation, against glitter from pixel noise."""
_WIDE_PX, _NARROW_PX = 19, 7


@dataclass(frozen=True, slots=True)
class Shading:
    """Per pixel: `lambert` relative to level ground (1), `gloss` in 0 ... 1, `occlusion` in 0 ... 0.5."""

    lambert: Heights
    gloss: Heights
    occlusion: Heights


def without_gaps(z_um: Heights) -> Heights:
    """Return the heights with gaps filled from the nearest measured pixel; zeros if nothing is measured."""
    from scipy import ndimage

    gaps = ~np.isfinite(z_um)
    if not gaps.any():
        return z_um
    if gaps.all():
        return np.zeros_like(z_um)
    rows, cols = np.asarray(ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True))
    return z_um[rows, cols]


def light_gain(z_um: Heights, pixel_um: float) -> float:
    """Return the slope gain for lighting, by which a typical slope of the surface is lit as one of 0.4."""
    step_y, step_x = np.abs(np.diff(z_um, axis=0)), np.abs(np.diff(z_um, axis=1))
    slopes = np.concatenate([step_y[np.isfinite(step_y)], step_x[np.isfinite(step_x)]]) / pixel_um
    typical = float(np.sqrt(np.mean(np.minimum(slopes, 2.0) ** 2))) if slopes.size else 0.0
    return float(np.clip(0.4 / max(typical, 1e-6), 0.4, 8.0))


def shade(z_um: Heights, pixel_um: float, gain: float, span_um: float) -> Shading:
    """Return the shading of heights without gaps; `span_um` is the height range that scales the occlusion."""
    from scipy import ndimage

    smooth = ndimage.gaussian_filter(z_um, _NOISE_PX) * np.float32(gain / pixel_um)
    down, right = np.gradient(smooth)
    flat = 1 / np.sqrt(right * right + down * down + 1)
    lambert = np.clip((_LIGHT[2] - _LIGHT[0] * right + _LIGHT[1] * down) * flat, 0, None) / _LIGHT[2]
    gloss = np.clip((_HALFWAY[2] - _HALFWAY[0] * right + _HALFWAY[1] * down) * flat, 0, 1) ** _GLOSS_EXPONENT
    return Shading(lambert.astype(np.float32), gloss.astype(np.float32), _occlusion(z_um, span_um))


def _occlusion(z_um: Heights, span_um: float) -> Heights:
    """Return the depth of a pixel below its wide and narrow surroundings, relative to the height range."""
    scale = np.float32(1 / max(span_um, 1e-6))
    wide = np.clip((_mean(z_um, _WIDE_PX) - z_um) * scale * 0.66, 0, 0.28)
    narrow = np.clip((_mean(z_um, _NARROW_PX) - z_um) * scale * 0.9, 0, 0.22)
    return (wide + narrow).astype(np.float32)


def _mean(z_um: Heights, width_px: int) -> Heights:
    """Return two passes of a box filter: close to a Gaussian, with a cost independent of its width."""
    from scipy import ndimage

    once = ndimage.uniform_filter(z_um, width_px, mode="nearest")
    return np.asarray(ndimage.uniform_filter(once, width_px, mode="nearest"), np.float32)


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


def expanded_um(part: HeightMap) -> NDArray[np.float32]:
    """Return the expanded uncertainty (k = 2) of each height, NaN where it is not known."""
    return np.full_like(part.z_um, np.nan) if part.u_um is None else np.float32(2) * part.u_um


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
    "uncertainty": lambda part, light: expanded_um(part),
    "grey": lambda part, light: grey_image(part),
    "origin": lambda part, light: part.origin.astype(np.float32),
    "difference": lambda part, light: part.z_um,
}
"""Values of each quantity of `QUANTITIES` per pixel; NaN where unknown."""
PARTLY_KNOWN: tuple[Quantity, ...] = ("overlap", "uncertainty")
"""Quantities that not every height has; the others are grey."""


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
    if look.colour_by in PARTLY_KNOWN:
        measured = np.isfinite(values)
        return np.where(
            measured[..., None], _by_value(np.where(measured, values, 0), look), np.array(ELSEWHERE, np.float32)
        )
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


Layer = NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16]


def reduced(part: HeightMap, factor: int) -> HeightMap:
    """Return the map in blocks of factor x factor pixels; blocks at the right and lower edge may be partial.

    A height is the mean of the measured pixels in its block; the origin is that of the best pixel, the lowest code.
    """
    if factor <= 1:
        return part
    shift = (factor - 1) / 2 * part.pixel_um
    return dataclasses.replace(
        part,
        z_um=_mean_of_blocks(part.z_um, factor),
        z_raw_um=_mean_of_blocks(part.z_raw_um, factor),
        confidence=_mean_of_blocks(part.confidence, factor),
        all_in_focus=_mean_of_blocks(part.all_in_focus, factor).astype(part.all_in_focus.dtype),
        overlap_um=None if part.overlap_um is None else _mean_of_blocks(part.overlap_um, factor),
        u_um=None if part.u_um is None else _mean_of_blocks(part.u_um, factor),
        origin=_blocks(part.origin, factor, 255).min(axis=(1, 3)),
        pixel_um=part.pixel_um * factor,
        x0_um=part.x0_um + shift,
        y0_um=part.y0_um - shift,
    )


def _mean_of_blocks(layer: Layer, factor: int) -> NDArray[np.float32]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a block without a measured pixel stays NaN
        return np.nanmean(_blocks(layer.astype(np.float32), factor, np.nan), axis=(1, 3)).astype(np.float32)


def _blocks(layer: Layer, factor: int, outside: float) -> NDArray[Any]:
    """Return the layer as [row, factor, col, factor], padded with `outside`."""
    rows, cols = layer.shape
    padded = np.pad(layer, ((0, -rows % factor), (0, -cols % factor)), constant_values=outside)
    return padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
