"""Textures around the surface: soft shadow with scale labels, hatch of unmeasured areas, block sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.draw.raster_text import font, write

Picture = NDArray[np.uint8]


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
