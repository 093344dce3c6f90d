"""Pictures under the surface: the soft shadow with the figures of the scale, and the hatch of the unmeasured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter

from wafer_viewer.draw.colours import Rgb
from wafer_viewer.draw.text import font, write

Picture = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Figure:
    """A number beside the block: its place in mm from the picture's top left corner, which end is there (l, m, r)."""

    text: str
    x_mm: float
    y_mm: float
    height_mm: float
    align: str


def shadow(
    width_mm: float,
    height_mm: float,
    pad_mm: float,
    *,
    darkness: float,
    shade: Rgb,
    ink: Rgb = (0, 0, 0),
    figures: tuple[Figure, ...] = (),
    long_side_px: int = 1600,
) -> Picture:
    """A soft shadow round a block of width x height mm, figures drawn into it, as rgba.

    One picture, because two translucent pictures that overlap in the scene cut boxes out of each other.
    """
    px_per_mm = long_side_px / (max(width_mm, height_mm) + 2 * pad_mm)
    soft = _soft_box(width_mm, height_mm, pad_mm, px_per_mm) * darkness
    if not figures:
        return np.dstack([np.full((*soft.shape, 3), shade, np.uint8), (soft * 255).astype(np.uint8)])
    letters = _letters(soft.shape, figures, px_per_mm)
    alpha = letters + soft * (1 - letters)
    share = (letters / np.maximum(alpha, 1e-6))[..., None]
    colour = np.array(ink) * share + np.array(shade) * (1 - share)
    return np.dstack([colour.astype(np.uint8), (alpha * 255).astype(np.uint8)])


def _soft_box(width_mm: float, height_mm: float, pad_mm: float, px_per_mm: float) -> NDArray[np.float32]:
    """A blurred rectangle in 0 ... 1: blurred small and enlarged, which is the same and quick."""
    full = (round((width_mm + 2 * pad_mm) * px_per_mm), round((height_mm + 2 * pad_mm) * px_per_mm))
    small = Image.new("L", (max(8, full[0] // 8), max(8, full[1] // 8)), 0)
    pad = pad_mm * px_per_mm / 8
    ImageDraw.Draw(small).rectangle((pad, pad, small.width - 1 - pad, small.height - 1 - pad), fill=255)
    blurred = small.filter(ImageFilter.GaussianBlur(pad * 0.33)).resize(full, Image.Resampling.BILINEAR)
    return np.asarray(blurred, np.float32) / 255


def _letters(shape: tuple[int, ...], figures: tuple[Figure, ...], px_per_mm: float) -> NDArray[np.float32]:
    image = Image.new("L", (shape[1], shape[0]), 0)
    pen = ImageDraw.Draw(image)
    for figure in figures:
        face = font(figure.height_mm * px_per_mm * 0.76)
        place = (figure.x_mm * px_per_mm, figure.y_mm * px_per_mm)
        write(pen, place, figure.text, face, 255, align=figure.align)
    return np.asarray(image, np.float32) / 255


def hatch(rows: int, cols: int, *, dark: bool, pitch_px: int = 26, line_px: int = 5) -> Picture:
    """Diagonal lines, rgb: what is seen through a hole, and the legend's pattern for 'not measured'."""
    lines = np.add.outer(np.arange(rows), np.arange(cols)) % pitch_px < line_px
    ground, line = ((28, 34, 41), (110, 122, 134)) if dark else ((226, 231, 236), (120, 132, 145))
    return np.where(lines[..., None], np.array(line, np.uint8), np.array(ground, np.uint8))
