"""Figures for print, drawn by matplotlib: the scene and profiles, with scales, units and caption.

matplotlib is imported when a figure is drawn, since it takes half a second.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from wafer_viewer.draw.charts.axes import Ends, Tick, round_ticks
from wafer_viewer.draw.charts.profile_plot import ProfileFrame, frame_of, runs, shown_curve
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, Rgb, rgb, table
from wafer_viewer.draw.number_format import length_text, round_length, with_unit
from wafer_viewer.model.measurement.sections import Section
from wafer_viewer.model.surface.height_map import LAYER_TITLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 300
_STYLE: Mapping[str, Any] = {
    "pdf.fonttype": 42,  # letters as TrueType, and in SVG as text: they can be searched and edited
    "svg.fonttype": "none",
    "svg.hashsalt": "wafer-viewer",  # the same figure is the same file
    "text.parse_math": False,  # names may have dollar signs
}
_STYLE_LOCK = threading.Lock()
"""Lock of matplotlib's settings, which are global."""


@contextmanager
def _style(settings: Mapping[str, Any]) -> Generator[None]:
    """Draw with matplotlib's defaults and the given settings, whatever the user's own are."""
    import matplotlib.style

    with _STYLE_LOCK, matplotlib.style.context(["default", {**_STYLE, **settings}]):
        yield


def _hex(colour: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _points(px: float) -> float:
    return px * 72 / DOTS_PER_INCH


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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scene = _without_empty_rows(scene)
    height, width = scene.shape[:2]
    foot_px, letter_px = round(FOOT_SHARE * width), LETTER_SHARE * width
    settings = {
        "font.size": _points(letter_px),
        "text.color": _hex(on.ink),
        "axes.edgecolor": _hex(on.second),
        "axes.linewidth": _points(letter_px / 16),
        "ytick.color": _hex(on.second),
        "ytick.labelcolor": _hex(on.ink),
    }
    with _style(settings):
        page_px = height + foot_px
        figure = Figure((width / DOTS_PER_INCH, page_px / DOTS_PER_INCH), DOTS_PER_INCH, facecolor=_hex(on.paper))
        figure.figimage(scene, 0, foot_px, origin="upper", zorder=-1)
        page = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(page_px, 0))
        page.set_axis_off()
        if key is not None:
            _colour_bar(figure, page, key, width, page_px, letter_px)
        bar_end = _scale_bar(page, on, um_per_pixel, width, height + foot_px / 2, letter_px)
        _caption(page, on, caption, bar_end + 2 * letter_px, width, height + foot_px / 2, letter_px)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def png(picture: NDArray[np.uint8], dots_per_inch: int = DOTS_PER_INCH) -> bytes:
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


def _scale_bar(page: Axes, on: Paper, um_per_pixel: float, width: int, middle: float, letter_px: float) -> float:
    """Draw a bar of a round length at the left of the strip; return its right end."""
    length_um = round_length(SCALE_BAR_SHARE * width * um_per_pixel)
    left, foot = 1.6 * letter_px, middle + 0.75 * letter_px
    right, end = left + length_um / um_per_pixel, foot - letter_px / 2
    line_px = max(2, round(letter_px / 6))
    page.plot(
        [left, left, right, right],
        [end, foot, foot, end],
        color=_hex(on.ink),
        linewidth=_points(line_px),
        solid_joinstyle="miter",
        solid_capstyle="butt",
    )
    page.text((left + right) / 2, middle + 0.1 * letter_px, length_text(length_um), ha="center")
    return right


def _caption(page: Axes, on: Paper, caption: Caption, left: float, width: int, middle: float, letter_px: float) -> None:
    baseline = middle + 0.36 * letter_px
    name = page.text(left, baseline, caption.name, weight="bold")
    page.annotate(
        "  |  ".join(caption.words),
        (1, baseline),
        (_points(letter_px), 0),
        xycoords=(name, "data"),
        textcoords="offset points",
        color=_hex(on.second),
    )
    if caption.simulated:
        plate = {"boxstyle": "round,pad=0.5,rounding_size=0.3", "facecolor": _hex(on.plate), "edgecolor": "none"}
        look: dict[str, Any] = {"ha": "right", "weight": "bold", "color": _hex(on.attention), "bbox": plate}
        page.text(width - 2.1 * letter_px, baseline, "SIMULATED", **look)


def _colour_bar(figure: Figure, page: Axes, key: ColourKey, width: int, height: int, letter_px: float) -> None:
    """Draw the colour bar, with its quantity and tick labels, at the right edge."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    right, top = width - 1.6 * letter_px, 4.2 * letter_px
    high_px, wide_px = round(BAR_HIGH * width), round(BAR_WIDE * width)
    page.text(right, 3 * letter_px, f"{key.title} {key.unit}".strip(), ha="right")
    box = figure.add_axes(((right - wide_px) / width, 1 - (top + high_px) / height, wide_px / width, high_px / height))
    colours = ScalarMappable(Normalize(key.low, key.high), ListedColormap(table(key.colours) / 255))
    figure.colorbar(colours, cax=box)
    _put_ticks(box.yaxis, round_ticks((key.low, key.high), 7, signed=key.signed))
    box.tick_params(length=_points(0.3 * letter_px), width=_points(letter_px / 10), pad=_points(0.3 * letter_px))
    beyond_px = max(label.get_window_extent().x1 for label in box.get_yticklabels()) - right
    box.set_position(box.get_position().translated(-beyond_px / width, 0))


def _put_ticks(axis: Any, ticks: Sequence[Tick]) -> None:
    axis.set_ticks([value for value, _ in ticks], [text for _, text in ticks])


WIDTH_PX, HEIGHT_PX = 2008, 1063
"""17 cm x 9 cm at 300 dots per inch: the width of a text page."""
_INK, _SOFT, _LINE, _FAULT = "#15202B", "#445463", "#DCE3EA", "#B42318"
_PROFILE_STYLE: Mapping[str, Any] = {
    "font.size": 7.5,
    "text.color": _INK,
    "axes.labelsize": 8.5,
    "axes.labelcolor": _INK,
    "axes.titlesize": 8.5,
    "axes.titlecolor": _FAULT,
    "axes.titleweight": "bold",
    "axes.edgecolor": _SOFT,
    "axes.linewidth": 0.5,
    "axes.grid": True,
    "grid.color": _LINE,
    "grid.linewidth": 0.5,
    "xtick.color": _SOFT,
    "ytick.color": _SOFT,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "legend.frameon": False,
}
_MOST_POINTS = 4000
ProfileFormat = Literal["png", "pdf", "svg"]


def profile_figure(sections: Sequence[Section], kind: ProfileFormat, span_um: Ends | None = None) -> bytes:
    """Return the plot of all curves, 17 cm x 9 cm, as the content of a file.

    Parameters
    ----------
    sections
        Curves; each has a line in the legend.
    kind
        File format: PDF and SVG are vector graphics, PNG has 300 dots per inch.
    span_um
        Range of distances, um; None for the whole length.
    """
    from matplotlib.figure import Figure

    frame = frame_of(sections, span_um)
    with _style(_PROFILE_STYLE):
        size = WIDTH_PX / DOTS_PER_INCH, HEIGHT_PX / DOTS_PER_INCH
        figure = Figure(size, DOTS_PER_INCH, layout="constrained")
        plot = figure.add_subplot(xlabel="Distance along the profile, µm", ylabel="z, µm")
        plot.set(xlim=frame.x_um, ylim=frame.z_um, axisbelow=True)
        _put_ticks(plot.xaxis, round_ticks(frame.x_um, 10))
        _put_ticks(plot.yaxis, round_ticks(frame.z_um, 6))
        for section in sections:
            _draw_curve(plot, section, frame)
        figure.legend(loc="outside upper left")
        if any(section.profile.simulated for section in sections):
            plot.set_title("SIMULATED", loc="right")
        out = io.BytesIO()
        figure.savefig(out, format=kind, metadata=_metadata(sections, kind))
        return out.getvalue()


def _draw_curve(plot: Axes, section: Section, frame: ProfileFrame) -> None:
    """Draw a curve with its gaps; a single measured point is a dot, and a compared curve is dashed and on top."""
    second = section.asked.is_second
    width, colour, order = 1.2 if second else 1.44, _colour(section), 3 if second else 2
    dashes: Any = (0, (5.2, 3.0)) if second else "-"
    curve = shown_curve(section, frame, _MOST_POINTS)
    plot.plot(*curve, color=colour, linewidth=width, linestyle=dashes, zorder=order, label=_named(section))
    dots = np.array([(x[0], z[0]) for x, z in runs(section, frame, _MOST_POINTS) if x[0] == x[-1]]).reshape(-1, 2)
    plot.plot(*dots.T, "o", color=colour, markersize=width, markeredgewidth=0, zorder=order)


def _metadata(sections: Sequence[Section], kind: ProfileFormat) -> dict[str, Any]:
    """Return the sources as metadata of the file, without the time, so that the same figure is the same file."""
    about = "; ".join(_named(section) for section in sections)
    if kind == "pdf":
        return {"Subject": about, "CreationDate": None}
    return {"Description": about, **({"Date": None} if kind == "svg" else {})}


def _colour(section: Section) -> str:
    """Return the colour of the line, mixed with the text colour for a compared curve."""
    colour, ink = rgb(PROFILE_COLOURS[section.asked.place]), rgb(_INK)
    if not section.asked.is_second:
        return _hex(colour)
    r, g, b = (round(0.45 * line + 0.55 * text) for line, text in zip(colour, ink, strict=True))
    return _hex((r, g, b))


def _named(section: Section) -> str:
    profile = section.profile
    width = f", mean over {with_unit(profile.line.width_um, 1)}" if profile.line.width_um else ""
    level = "" if section.asked.levelling.by == "stage" else f", levelled by {section.asked.levelling.by}"
    about = f"Pt {with_unit(profile.pt.value_um, 2)}, {with_unit(profile.length_um, 0)} long{width}"
    return f"{section.title}\u2003{section.source}, {LAYER_TITLES[profile.surface]}{level}\u2003{about}"
