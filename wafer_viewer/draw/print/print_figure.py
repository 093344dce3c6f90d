"""Print figure of the scene, with scale bar, colour bar and caption drawn in."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from wafer_viewer.draw.colormaps import Rgb, rgb, table
from wafer_viewer.draw.number_format import number
from wafer_viewer.draw.raster_text import font, length_px, write
from wafer_viewer.draw.ticks import length_text, round_length, tick_digits, ticks

FOOT_SHARE, LETTER_SHARE = 0.042, 0.0125
"""Height of the caption strip and of its text, as shares of the image width."""
SCALE_BAR_SHARE = 0.14
BAR_HIGH, BAR_WIDE = 0.24, 0.014
MARGIN_SHARE, LEAST_HIGH = 0.03, 0.34
"""Margin above and below the drawn content, and least scene height, as shares of the width."""


@dataclass(frozen=True, slots=True)
class Paper:
    """Colours of the page, of its text, and of the SIMULATED label."""

    paper: Rgb
    ink: Rgb
    second: Rgb
    attention: Rgb
    plate: Rgb


LIGHT = Paper((255, 255, 255), rgb("15202B"), rgb("445463"), rgb("8A5300"), rgb("FFF1D6"))
DARK = Paper(rgb("161B21"), rgb("E9EEF3"), rgb("B2BECA"), rgb("F0B45B"), rgb("352508"))
"""Page colours follow the theme, because the text within the scene is drawn for a light or a dark page."""


@dataclass(frozen=True, slots=True)
class ColourKey:
    """Colour bar: quantity, unit, range and colour map."""

    title: str
    unit: str
    low: float
    high: float
    colours: str
    signed: bool = True


@dataclass(frozen=True, slots=True)
class Caption:
    """Caption below the scene: dataset name in bold, further text, and whether it is simulated."""

    name: str
    words: tuple[str, ...]
    simulated: bool


def print_picture(
    scene: NDArray[np.uint8], um_per_pixel: float, caption: Caption, key: ColourKey | None, on: Paper = LIGHT
) -> NDArray[np.uint8]:
    """Return the scene uint8 [h, w, 4] on paper, with scale bar, colour bar and caption: uint8 [rows, w, 3].

    Empty rows above and below the drawn content are cropped. um_per_pixel is that of the image at the focal point of
    the view.
    """
    scene = _without_empty_rows(scene)
    height, width = scene.shape[:2]
    foot_px, letter_px = round(FOOT_SHARE * width), LETTER_SHARE * width
    page = Image.new("RGB", (width, height + foot_px), on.paper)
    above = Image.fromarray(scene)
    page.paste(above, (0, 0), above)
    pen = ImageDraw.Draw(page)
    if key is not None:
        _colour_bar(pen, on, key, width, letter_px)
    bar_end = _scale_bar(pen, on, um_per_pixel, width, height + foot_px / 2, letter_px)
    _caption(pen, on, caption, bar_end + 2 * letter_px, width, height + foot_px / 2, letter_px)
    return np.asarray(page)


def png(picture: NDArray[np.uint8], dots_per_inch: int = 300) -> bytes:
    """Return the bytes of a PNG file."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "PNG", dpi=(dots_per_inch, dots_per_inch), compress_level=4)
    return out.getvalue()


def _without_empty_rows(scene: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the rows with drawn content, with a margin, and at least as many as the colour bar needs."""
    height, width = scene.shape[:2]
    drawn = np.flatnonzero((scene[..., 3] > 0).any(axis=1))
    if drawn.size == 0:
        return scene
    margin = round(MARGIN_SHARE * width)
    first, last = max(0, int(drawn[0]) - margin), min(height, int(drawn[-1]) + 1 + margin)
    spare = max(0, round(LEAST_HIGH * width) - (last - first))
    first = max(0, first - spare // 2)
    return scene[first : min(height, max(last, first + round(LEAST_HIGH * width)))]


def _scale_bar(
    pen: ImageDraw.ImageDraw, on: Paper, um_per_pixel: float, width: int, middle: float, letter_px: float
) -> float:
    """Draw a bar of a round length at the left of the strip; return its right end."""
    length_um = round_length(SCALE_BAR_SHARE * width * um_per_pixel)
    left, line_px = 1.6 * letter_px, max(2, round(letter_px / 6))
    right = left + length_um / um_per_pixel
    foot = middle + 0.75 * letter_px
    pen.line(
        [(left, foot - letter_px / 2), (left, foot), (right, foot), (right, foot - letter_px / 2)], on.ink, line_px
    )
    write(
        pen, ((left + right) / 2, middle - 0.3 * letter_px), length_text(length_um), font(letter_px), on.ink, align="m"
    )
    return right


def _caption(
    pen: ImageDraw.ImageDraw, on: Paper, caption: Caption, left: float, width: int, middle: float, letter_px: float
) -> None:
    face = font(letter_px)
    write(pen, (left, middle), caption.name, face, on.ink, weight=letter_px / 40)
    after = left + length_px(caption.name, face) + letter_px
    write(pen, (after, middle), "  |  ".join(caption.words), face, on.second)
    if caption.simulated:
        word, pad = "SIMULATED", 0.6 * letter_px
        wide, right = length_px(word, face), width - 1.6 * letter_px
        plate = (right - wide - 2 * pad, middle - letter_px, right, middle + letter_px)
        pen.rounded_rectangle(plate, letter_px / 3, fill=on.plate)
        write(pen, (right - pad, middle), word, face, on.attention, align="r", weight=letter_px / 40)


def _colour_bar(pen: ImageDraw.ImageDraw, on: Paper, key: ColourKey, width: int, letter_px: float) -> None:
    """Draw the colour bar at the right edge, with its quantity and tick labels."""
    face = font(letter_px)
    high_px, wide_px = round(BAR_HIGH * width), round(BAR_WIDE * width)
    values = ticks(key.low, key.high, 7)
    labels = [number(value, tick_digits(values), signed=key.signed) for value in values]
    room = max(length_px(label, face) for label in labels)
    left, top = width - 2.4 * letter_px - room - wide_px, 4.2 * letter_px
    write(pen, (width - 1.6 * letter_px, 2.6 * letter_px), f"{key.title} {key.unit}".strip(), face, on.ink, align="r")
    colours = table(key.colours)[np.linspace(255, 0, high_px).round().astype(int)]
    for k, colour in enumerate(colours.tolist()):
        pen.line([(left, top + k), (left + wide_px, top + k)], tuple(colour))
    pen.rectangle((left, top, left + wide_px, top + high_px), outline=on.second, width=max(1, round(letter_px / 16)))
    for value, label in zip(values, labels, strict=True):
        y = top + high_px * (1 - (value - key.low) / max(key.high - key.low, 1e-12))
        pen.line([(left + wide_px, y), (left + wide_px + 0.3 * letter_px, y)], on.second, max(1, round(letter_px / 10)))
        write(pen, (left + wide_px + 0.6 * letter_px, y), label, face, on.ink)
