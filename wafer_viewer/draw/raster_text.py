"""Text as raster images, in Pillow's built-in font, as the scene cannot draw text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from wafer_viewer.draw.colormaps import Rgb

LINE_PX = 96
"""Height of a text image."""
_LETTER_PX = 62
_PAD_PX, _MARGIN_PX = 26, 3
_FINER = 3
"""Supersampling factor of tags."""
_ATLAS_PX = 2048
_SUBSTITUTES = str.maketrans({"\u202f": " ", "\u2212": "-", "–": "-", "×": "x", "\u03bc": "µ"})


@cache
def font(size_px: float) -> ImageFont.FreeTypeFont:
    """Return Pillow's built-in scalable font, which has no µ: see `write`."""
    face = ImageFont.load_default(size_px)
    if not isinstance(face, ImageFont.FreeTypeFont):
        raise RuntimeError("Pillow was built without FreeType, letters cannot be drawn: install Pillow's wheel.")
    return face


def length_px(text: str, face: ImageFont.FreeTypeFont) -> float:
    """Return the width of a text as drawn by `write`."""
    return face.getlength(_substitute_glyphs(text))


def write(
    pen: ImageDraw.ImageDraw,
    position: tuple[float, float],
    text: str,
    face: ImageFont.FreeTypeFont,
    fill: Rgb | tuple[int, int, int, int] | int,
    *,
    align: str = "l",
    weight: float = 0.0,
) -> None:
    """Draw one line of text; `position`: mid-height of the capitals at its left end, middle or right end (l, m, r)."""
    spelled = _substitute_glyphs(text)
    x = position[0] - {"l": 0.0, "m": 0.5, "r": 1.0}[align] * face.getlength(spelled)
    baseline = position[1] + 0.36 * face.size
    pen.text((x, baseline), spelled, font=face, fill=fill, anchor="ls", stroke_width=weight, stroke_fill=fill)
    for place, letter in enumerate(text.translate(_SUBSTITUTES)):
        if letter == "µ":
            _tail(pen, x + face.getlength(spelled[:place]), baseline, face, fill, weight)


def tag(text: str, colour: Rgb, pill: Rgb | None = None, high_px: int = LINE_PX) -> NDArray[np.uint8]:
    """Return one bold line of text, rgba [high_px, any, 4], transparent or on a rounded plate of colour `pill`.

    It is supersampled and filtered down. The transparent margin has the colour of the adjacent pixels, so that edges
    stay smooth when it is drawn smaller.
    """
    scale = _FINER * high_px / LINE_PX
    face, pad, margin = font(_LETTER_PX * scale), (_PAD_PX if pill else 4) * scale, _MARGIN_PX * scale
    width_px = math.ceil((length_px(text, face) + 2 * pad) / _FINER)
    letters, plate = (Image.new("L", (width_px * _FINER, high_px * _FINER)) for _ in range(2))
    write(ImageDraw.Draw(letters), (pad, high_px * _FINER / 2), text, face, 255, weight=0.8 * scale)
    box = (margin, margin, plate.width - 1 - margin, plate.height - 1 - margin)
    ImageDraw.Draw(plate).rounded_rectangle(box, _PAD_PX * scale, fill=255)
    ink, ground = (np.asarray(m.resize((width_px, high_px), Image.Resampling.LANCZOS)) for m in (letters, plate))
    shown = np.broadcast_to(np.array(pill or colour, float), (*ink.shape, 3))
    mixed = shown + (np.array(colour, float) - shown) * (ink[..., None] / 255)
    return np.dstack([np.rint(mixed), ground if pill else ink]).astype(np.uint8)


def text_atlas(tags: Sequence[NDArray[np.uint8]]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Pack tags into one image, rgba, and return it with their texture boxes.

    The boxes are float32 [n, 4]: u0, v0, u1, v1 in 0 ... 1, v downwards.
    """
    places: list[tuple[int, int, int]] = []
    x, y = 0, 0
    for picture in tags:
        wide = picture.shape[1]
        if x and x + wide > _ATLAS_PX:
            x, y = 0, y + LINE_PX
        places.append((x, y, wide))
        x += wide
    atlas = np.zeros((y + LINE_PX, max(x + wide for x, _, wide in places), 4), np.uint8)
    for picture, (left, top, wide) in zip(tags, places, strict=True):
        atlas[top : top + LINE_PX, left : left + wide] = picture
    boxes = np.array([(x, y, x + wide, y + LINE_PX) for x, y, wide in places], np.float32)
    return atlas, boxes / np.array([atlas.shape[1], atlas.shape[0]] * 2, np.float32)


def _substitute_glyphs(text: str) -> str:
    return text.translate(_SUBSTITUTES).replace("µ", "u")


def _tail(
    pen: ImageDraw.ImageDraw,
    x: float,
    baseline: float,
    face: ImageFont.FreeTypeFont,
    fill: Rgb | tuple[int, int, int, int] | int,
    weight: float,
) -> None:
    """Draw the descender that turns the u at x into a µ."""
    stem_px = 0.085 * face.size
    left = x + 0.075 * face.size - weight
    pen.rectangle((left, baseline - 0.2 * face.size, left + stem_px + 2 * weight - 1, baseline + 0.2 * face.size), fill)
