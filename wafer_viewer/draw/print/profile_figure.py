"""Profile figure for print: axes with units, coloured curves, a legend, SIMULATED if applicable."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from wafer_viewer.draw.charts.profile_axes import Ends, ProfileFrame, digits, frame_of, runs
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, Rgb, rgb
from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.draw.raster_text import font, length_px, write
from wafer_viewer.model.measurement.sections import Section
from wafer_viewer.model.surface.height_map import LAYER_TITLES

DOTS_PER_INCH = 300
WIDTH_PX, HEIGHT_PX = 2008, 1063
"""17 cm x 9 cm, the width of a text page."""
_LEFT, _RIGHT, _TOP, _FOOT = 190, 50, 40, 150
_ROW_PX = 52
_TEXT_PX, _SMALL_PX = 36, 32
_INK: Rgb = (21, 32, 43)
_SOFT: Rgb = (68, 84, 99)
_LINE: Rgb = (220, 227, 234)
_FAULT: Rgb = (180, 35, 24)
_PAPER: Rgb = (255, 255, 255)
_MOST_POINTS = 4000
_SMOOTH = 2
"""Supersampling factor of the curves, because Pillow does not antialias lines."""


@dataclass(frozen=True, slots=True)
class _Area:
    """Plot area in pixels."""

    left: int
    top: int
    width: int
    height: int

    def x(self, across: float) -> float:
        return self.left + across * self.width

    def y(self, down: float) -> float:
        return self.top + down * self.height


def profile_picture(sections: Sequence[Section], span_um: Ends | None = None) -> Image.Image:
    """Return the plot of all curves, rgb, 17 cm x 9 cm at 300 dpi, with a legend line for each curve above it."""
    frame = frame_of(sections, span_um)
    top = _TOP + _ROW_PX * len(sections) + 24
    area = _Area(_LEFT, top, WIDTH_PX - _LEFT - _RIGHT, HEIGHT_PX - top - _FOOT)
    image = Image.new("RGB", (WIDTH_PX, HEIGHT_PX), _PAPER)
    pen = ImageDraw.Draw(image)
    _axes(pen, frame, area)
    for section in sorted(sections, key=lambda s: s.asked.is_second):
        _curve(image, section, frame, area)
    for k, section in enumerate(sections):
        _legend(pen, section, _TOP + _ROW_PX * k + _ROW_PX / 2)
    if any(section.profile.simulated for section in sections):
        write(pen, (WIDTH_PX - _RIGHT, _TOP + _ROW_PX / 2), "SIMULATED", font(_TEXT_PX), _FAULT, align="r", weight=0.8)
    return image


def profile_png(sections: Sequence[Section], span_um: Ends | None = None) -> bytes:
    """Return the same as PNG bytes, with resolution and sources as metadata."""
    from PIL.PngImagePlugin import PngInfo

    about = PngInfo()
    about.add_text("Description", "; ".join(_named(section) for section in sections))
    out = io.BytesIO()
    profile_picture(sections, span_um).save(out, "PNG", dpi=(DOTS_PER_INCH, DOTS_PER_INCH), pnginfo=about)
    return out.getvalue()


def _axes(pen: ImageDraw.ImageDraw, frame: ProfileFrame, area: _Area) -> None:
    face, xs, zs = font(_SMALL_PX), frame.x_ticks(10), frame.z_ticks(6)
    for x, across in zip(xs, frame.across(np.array(xs)).tolist(), strict=True):
        pen.line([(area.x(across), area.top), (area.x(across), area.top + area.height)], _LINE, 2)
        write(pen, (area.x(across), area.top + area.height + 30), number(x, digits(xs)), face, _SOFT, align="m")
    for z, down in zip(zs, frame.down(np.array(zs)).tolist(), strict=True):
        pen.line([(area.left, area.y(down)), (area.left + area.width, area.y(down))], _LINE, 2)
        write(pen, (area.left - 16, area.y(down)), number(z, digits(zs)), face, _SOFT, align="r")
    box = (area.left, area.top, area.left + area.width, area.top + area.height)
    pen.rectangle(box, outline=_SOFT, width=2)
    middle = (area.left + area.width / 2, area.top + area.height + 88)
    write(pen, middle, "Distance along the profile, µm", font(_TEXT_PX), _INK, align="m")
    _upright(pen, "z, µm", (48, area.top + area.height / 2))


def _upright(pen: ImageDraw.ImageDraw, text: str, middle: tuple[float, float]) -> None:
    """Draw text rotated to read from bottom to top."""
    face = font(_TEXT_PX)
    word = Image.new("L", (round(length_px(text, face)) + 8, 2 * _TEXT_PX), 0)
    write(ImageDraw.Draw(word), (4, _TEXT_PX), text, face, 255)
    turned = word.rotate(90, expand=True)
    pen.bitmap((round(middle[0] - turned.width / 2), round(middle[1] - turned.height / 2)), turned, _INK)


def _curve(image: Image.Image, section: Section, frame: ProfileFrame, area: _Area) -> None:
    """Draw one curve within the plot area."""
    mask = Image.new("L", (area.width * _SMOOTH, area.height * _SMOOTH), 0)
    pen = ImageDraw.Draw(mask)
    second = section.asked.is_second
    for across, down in runs(section, frame, _MOST_POINTS):
        points = np.column_stack([across * mask.width, down * mask.height])
        for piece in _dashes(points, 26 * _SMOOTH, 15 * _SMOOTH) if second else [points]:
            _stroke(pen, piece, (5 if second else 6) * _SMOOTH)
    colour = Image.new("RGB", (area.width, area.height), _colour(section))
    image.paste(colour, (area.left, area.top), mask.resize(colour.size, Image.Resampling.BOX))


def _stroke(pen: ImageDraw.ImageDraw, points: np.ndarray[tuple[int, int], np.dtype[np.float64]], width: int) -> None:
    if len(points) > 1:
        pen.line([(x, y) for x, y in points.tolist()], 255, width, joint="curve")
    else:
        x, y = points[0].tolist()
        pen.ellipse((x - width / 2, y - width / 2, x + width / 2, y + width / 2), 255)


def _dashes(
    points: np.ndarray[tuple[int, int], np.dtype[np.float64]], dash: float, gap: float
) -> list[np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    """Split a line into dashes by the distance along the axis."""
    number_of = np.floor((points[:, 0] - points[0, 0]) / (dash + gap))
    inked = (points[:, 0] - points[0, 0]) % (dash + gap) <= dash
    return [points[(number_of == k) & inked] for k in np.unique(number_of[inked])]


def _legend(pen: ImageDraw.ImageDraw, section: Section, y: float) -> None:
    colour, second = _colour(section), section.asked.is_second
    for start in (0, 32) if second else (0,):
        pen.line([(_LEFT + start, y), (_LEFT + (start + 20 if second else 52), y)], colour, 8)
    write(pen, (_LEFT + 70, y), _named(section), font(_SMALL_PX), _INK)


def _colour(section: Section) -> Rgb:
    """Return the colour of the line, mixed with the text colour for a compared curve."""
    r, g, b = rgb(PROFILE_COLOURS[section.asked.place][1:])
    if not section.asked.is_second:
        return r, g, b
    return round(0.45 * r + 0.55 * _INK[0]), round(0.45 * g + 0.55 * _INK[1]), round(0.45 * b + 0.55 * _INK[2])


def _named(section: Section) -> str:
    profile = section.profile
    width = f", mean over {with_unit(profile.line.width_um, 1)}" if profile.line.width_um else ""
    level = "" if section.asked.levelling.by == "stage" else f", levelled by {section.asked.levelling.by}"
    about = f"Pt {with_unit(profile.pt.value_um, 2)}, {with_unit(profile.length_um, 0)} long{width}"
    return f"{section.title}   {section.source}, {LAYER_TITLES[profile.surface]}{level}   {about}"
