"""Figures for print: the scene and profiles, with scales, units and caption drawn in."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from wafer_viewer.draw.charts.profile_plot import Ends, ProfileFrame, digits, frame_of, runs
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, Rgb, rgb, table
from wafer_viewer.draw.number_format import length_text, number, round_length, tick_digits, ticks, with_unit
from wafer_viewer.draw.raster_text import font, length_px, write
from wafer_viewer.model.measurement.sections import Section
from wafer_viewer.model.surface.height_map import LAYER_TITLES

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
