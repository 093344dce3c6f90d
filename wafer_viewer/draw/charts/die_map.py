"""Die and site maps of a wafer as SVG, coloured by verdict, defects or range, for the page and for reports.

Colours are custom properties (``--fault``, ``--good`` …) of the embedding page, so one drawing serves light and dark.
Every state also has its own hatching, every verdict its own sign.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from markupsafe import Markup

from wafer_viewer.draw.charts.wafer_map import MOST_SINGLE, Box, MapViewport, Outline
from wafer_viewer.draw.colormaps import table
from wafer_viewer.draw.number_format import THIN, number
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieNumber, DieStatus
from wafer_viewer.model.job import JudgedDie
from wafer_viewer.model.measurement.measurements import Site, SiteRanges
from wafer_viewer.model.quantity import Word

Segment = tuple[tuple[float, float], tuple[float, float]]
"""Line on a die between two points, as fractions of its width and height from the lower left corner."""
_LOWER: tuple[Segment, ...] = (((0, 0.33), (0.33, 0)), ((0, 0.67), (0.67, 0)), ((0, 1), (1, 0)))
_UPPER: tuple[Segment, ...] = (((0.33, 1), (1, 0.33)), ((0.67, 1), (1, 0.67)))
_CROSS: tuple[Segment, ...] = (((0, 0), (1, 1)), ((0, 1), (1, 0)))
WITH_DEFECTS = "with defects"


@dataclass(frozen=True, slots=True)
class DieLook:
    """Drawing style of a die state: ink, fill opacity, dashes, hatch lines and their name."""

    ink: str
    opacity: float = 0.0
    dashed: bool = False
    lines: tuple[Segment, ...] = ()
    explanation: str = ""


DIE_LOOKS: dict[str, DieLook] = {
    WITH_DEFECTS: DieLook("fault", 0.08),
    "clean": DieLook("good", 0.12),
    "not inspected": DieLook("ink3"),
    "cut": DieLook("ink3", 0.06, True, (((0.4, 1), (1, 0.4)),), "a corner off"),
    "partly scanned": DieLook("ink3", 0.06, True, _LOWER, "half hatched"),
    "not scanned": DieLook("ink3", 0.0, True, (*_LOWER, *_UPPER), "hatched"),
    "missing": DieLook("ink3", 0.0, False, _CROSS, "crossed"),
}
"""Styles by die state, in the order of the legend."""


@dataclass(frozen=True, slots=True)
class DieFill:
    """Fill of a die in addition to its state: CSS colour, opacity, and label."""

    colour: str
    opacity: float
    text: str = ""


_MARGIN_SHARE, _ZOOM_UNDER = 0.03, 0.45
"""Margin as a share of the map; share of the sample below which the dies are enlarged, without its outline."""
_LEAST_FOR_NUMBER_PX, _LEAST_FOR_LINES_PX = 9, 6


def kind_of(die: DieStatus) -> str:
    """Return the state of a die: a key of `DIE_LOOKS`."""
    if die.state != "whole":
        return die.state
    return WITH_DEFECTS if die.defects else die.word.split(",")[0]  # after it: what a clean die was not looked at for


def kinds_of(dies: Sequence[DieStatus]) -> dict[str, int]:
    """Return the number of dies in each state that occurs."""
    counts = Counter(map(kind_of, dies))
    return {kind: counts[kind] for kind in DIE_LOOKS if counts[kind]}


def kinds_text(dies: Sequence[DieStatus]) -> str:
    """Return the number of dies in each state, with the name of its hatching, as text."""
    legend = ((n, kind, DIE_LOOKS[kind].explanation) for kind, n in kinds_of(dies).items())
    return ", ".join(f"{n} {kind}{f' ({how})' if how else ''}" for n, kind, how in legend)


def fills_by_count(counts: Mapping[str, int], colour: str = "var(--fault)") -> dict[str, DieFill]:
    """Return fills by die name: the opacity increases with the number of defects, which is the label."""
    most = max(counts.values(), default=0)
    return {name: DieFill(colour, 0.1 + 0.4 * n / most, f"{n}") for name, n in counts.items() if n}


def fills_by_number(inspection: Inspection, name: DieNumber) -> dict[str, DieFill]:
    """Return fills by die name: the colour has the sign of a number of the die, the opacity its size; both labelled."""
    values = {die.name: die.measured.value(name) for die in inspection.dies if die.measured is not None}
    most = max(map(abs, values.values()), default=0.0) or 1.0
    colours = {True: "var(--fault)", False: "var(--accent)"}
    return {
        die: DieFill(colours[value >= 0], 0.05 + 0.55 * abs(value) / most, f"{value:.2g}")
        for die, value in values.items()
    }


class DieLayout(Protocol):
    """Dies of an inspection, or of several on one map."""

    @property
    def grid(self) -> DieGrid | None:
        """Lattice of the dies."""
        ...

    @property
    def dies(self) -> tuple[DieStatus, ...]:
        """Status of each die."""
        ...


def die_frame(
    inspection: DieLayout, outline_um: Outline = (), *, width_px: int = 300, most_height_px: int = 300
) -> MapViewport | None:
    """Return the viewport of the die map, None without dies; it contains the sample if the dies fill most of it."""
    grid, dies = inspection.grid, inspection.dies
    if grid is None or not dies:
        return None
    x, y = _corners(grid, dies)
    box = float(x.min()), float(y.min()), float(x.max()), float(y.max())
    if outline_um and _share(box, outline_um) >= _ZOOM_UNDER:
        xs, ys = [*x.flat, *(p[0] for p in outline_um)], [*y.flat, *(p[1] for p in outline_um)]
        box = min(xs), min(ys), max(xs), max(ys)
    pad = _MARGIN_SHARE * max(box[2] - box[0], box[3] - box[1])
    box = box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad
    return MapViewport(box, width_px, min(most_height_px, max(40.0, width_px * (box[3] - box[1]) / (box[2] - box[0]))))


def die_shapes(
    frame: MapViewport,
    inspection: DieLayout,
    fills: Mapping[str, DieFill],
    *,
    outline_um: Outline = (),
    chosen: str = "",
) -> str:
    """Return the dies at their stage positions as SVG elements; the one named `chosen` has a heavy edge.

    Each has its name and state as a title. Above `MOST_SINGLE` dies, those of the same style are one shape.
    """
    grid, dies = inspection.grid, inspection.dies
    if grid is None or not dies:
        return ""
    draw = _merged_shapes if len(dies) > MOST_SINGLE else _singly
    places = _places(frame, grid, dies)
    kinds = Markup("").join(draw(_DieShape.of(frame, grid), list(zip(dies, places, strict=True)), fills))
    heavy = (place for die, place in zip(dies, places, strict=True) if die.name == chosen)
    edge = "".join(_DieShape.of(frame, grid).edge(place) for place in heavy)
    chosen_edge = Markup('<path class="wv-die-on" d="{}" fill="none" stroke="var(--ink)" stroke-width="2.4"/>').format(
        edge
    )
    return _sample(frame, outline_um) + kinds + (chosen_edge if edge else Markup())


def defect_map_svg(inspection: Inspection, *, width_px: int = 300, most_height_px: int = 300) -> Markup:
    """Return the die map coloured by defect count, for reports; empty without dies."""
    frame = die_frame(inspection, width_px=width_px, most_height_px=most_height_px)
    if frame is None:
        return Markup()
    fills = fills_by_count({die.name: die.defects or 0 for die in inspection.dies})
    return Markup(
        '<svg viewBox="0 0 {width_px} {height_px:.0f}" width="{width_px}" role="img" '
        'aria-label="Dies by their defects" style="max-width:100%">{die_shapes}</svg>'
    ).format(width_px=width_px, height_px=frame.height_px, die_shapes=die_shapes(frame, inspection, fills))


def look_svg(kind: str, side_px: int = 14) -> Markup:
    """Return the legend symbol of a die state."""
    die = _DieShape((side_px - 3.0, 0.0), (0.0, 3.0 - side_px))
    drawn = die.drawn([(1.5, side_px - 1.5)], DIE_LOOKS[kind])
    return Markup('<svg width="{}" height="{}" aria-hidden="true" style="vertical-align:-2px">{}</svg>').format(
        side_px, side_px, drawn
    )


Place = tuple[float, float]
"""Lower left corner of a die in the image, px."""


@dataclass(frozen=True, slots=True)
class _DieShape:
    """Lower and left edge vectors of the dies of a lattice in the image, px."""

    across: Place
    up: Place

    @classmethod
    def of(cls, frame: MapViewport, grid: DieGrid) -> _DieShape:
        c, s = math.cos(grid.angle_rad) * frame.scale, math.sin(grid.angle_rad) * frame.scale
        w, h = max(grid.width_um, 2 / frame.scale), max(grid.height_um, 2 / frame.scale)
        return cls((c * w, -s * w), (-s * h, -c * h))

    @property
    def room_px(self) -> float:
        return min(math.hypot(*self.across), math.hypot(*self.up))

    def at(self, place: Place, u: float, v: float) -> Place:
        return place[0] + u * self.across[0] + v * self.up[0], place[1] + u * self.across[1] + v * self.up[1]

    def edge(self, place: Place) -> str:
        (ax, ay), (ux, uy) = self.across, self.up
        return f"M{place[0]:.1f} {place[1]:.1f}l{ax:.1f} {ay:.1f}l{ux:.1f} {uy:.1f}l{-ax:.1f} {-ay:.1f}z"

    def lines(self, place: Place, segments: Sequence[Segment]) -> str:
        ends = ((self.at(place, *a), self.at(place, *b)) for a, b in segments)
        return "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in ends)

    def drawn(self, places: Sequence[Place], look: DieLook, fill: DieFill | None = None) -> Markup:
        """Return dies of one style as one shape, with hatching if there is enough space."""
        ink = f"var(--{look.ink})"
        colour, opacity = (fill.colour, fill.opacity) if fill is not None else (ink, look.opacity)
        dashes = Markup(' stroke-dasharray="3 2"') if look.dashed else Markup()
        body = Markup(
            '<path d="{map}" fill="{colour}" fill-opacity="{opacity:.2f}" '
            'stroke="{ink}" stroke-width="{stroke_width}"{dashes}/>'
        ).format(
            map=Markup("").join(map(self.edge, places)),
            colour=colour,
            opacity=opacity,
            ink=ink,
            stroke_width=1.1 if self.room_px >= _LEAST_FOR_LINES_PX else 0.5,
            dashes=dashes,
        )
        if not look.lines or self.room_px < _LEAST_FOR_LINES_PX:
            return body
        across = "".join(self.lines(place, look.lines) for place in places)
        return Markup('{}<path d="{}" fill="none" stroke="{}" stroke-width="0.9"/>').format(body, across, ink)

    def text(self, place: Place, text: str) -> Markup:
        if not text or self.room_px < _LEAST_FOR_NUMBER_PX:
            return Markup()
        (x, y), size = self.at(place, 0.5, 0.5), min(14.0, 0.6 * self.room_px)
        return Markup(
            '<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" font-size="{size:.1f}" fill="var(--ink)">{text}</text>'
        ).format(x=x, y=y + 0.35 * size, size=size, text=text)


Placed = Sequence[tuple[DieStatus, Place]]


def _singly(shape: _DieShape, dies: Placed, fills: Mapping[str, DieFill]) -> Iterator[str]:
    for die, place in dies:
        fill = fills.get(die.name)
        words = " · ".join(dict.fromkeys((die.word, die.state))) if die.state != "whole" else die.word
        yield (
            Markup('<g data-die="{name}"><title>Die {name}: {words}</title>{drawn}{text}</g>').format(
                name=die.name,
                words=words,
                drawn=shape.drawn([place], DIE_LOOKS[kind_of(die)], fill),
                text=shape.text(place, fill.text if fill else ""),
            )
        )


def _merged_shapes(shape: _DieShape, dies: Placed, fills: Mapping[str, DieFill]) -> Iterator[str]:
    groups: dict[tuple[str, DieFill | None], list[Place]] = {}
    for die, place in dies:
        groups.setdefault((kind_of(die), fills.get(die.name)), []).append(place)
    for (kind, fill), places in groups.items():
        yield shape.drawn(places, DIE_LOOKS[kind], fill)
        yield Markup("").join(shape.text(place, fill.text) for place in places if fill is not None)


def _places(frame: MapViewport, grid: DieGrid, dies: Sequence[DieStatus]) -> list[Place]:
    cols, rows = np.array([die.col for die in dies]), np.array([die.row for die in dies])
    x_um, y_um = grid.to_stage(cols, rows)
    return [(frame.x(x), frame.y(y)) for x, y in zip(x_um.tolist(), y_um.tolist(), strict=True)]


def _corners(grid: DieGrid, dies: Sequence[DieStatus]) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y, um, of the four corners of all dies."""
    u, v = grid.width_um * np.array([0, 1, 1, 0]), grid.height_um * np.array([0, 0, 1, 1])
    cols, rows = np.array([die.col for die in dies])[:, None], np.array([die.row for die in dies])[:, None]
    return grid.to_stage(cols, rows, u, v)


def _share(box: tuple[float, float, float, float], outline_um: Outline) -> float:
    """Return the larger of the fractions of width and height that a box takes of an outline."""
    xs, ys = [x for x, _ in outline_um], [y for _, y in outline_um]
    across, up = max(xs) - min(xs), max(ys) - min(ys)
    return max((box[2] - box[0]) / max(across, 1e-9), (box[3] - box[1]) / max(up, 1e-9))


def _sample(frame: MapViewport, outline_um: Outline) -> Markup:
    if len(outline_um) < 3:
        return Markup()
    points = " ".join(f"{frame.x(x):.1f},{frame.y(y):.1f}" for x, y in outline_um)
    return Markup('<polygon points="{}" fill="none" stroke="var(--ink3)" stroke-width="1"/>').format(points)


INKS: dict[Word, tuple[str, str]] = {
    "pass": ("good", ""),
    "fail": ("fault", "×"),
    "inconclusive": ("attention", "?"),
    "no verdict": ("ink3", "–"),
}
"""Colour and sign of each verdict."""
_ROUND_SHARE = 0.02
_LEAST_FOR_SIGN_PX = 9


def die_map_svg(
    dies: Sequence[JudgedDie], across_um: float = 0.0, *, width_px: int = 276, most_height_px: int = 236
) -> Markup:
    """Return the dies at their wafer positions, notch down; across_um: diameter of the wafer, 0 without outline.

    The outline is drawn if the dies take enough of it to be distinguishable.
    """
    frame = _frame(dies, across_um, width_px, most_height_px)
    outline = _outline(frame, across_um) if _shows_wafer(dies, across_um) else ""
    return Markup(
        '<svg viewBox="0 0 {width_px} {height_px:.0f}" width="{width_px}" role="img" '
        'aria-label="Dies by their word" style="max-width:100%">'
        "{outline}{die}</svg>"
    ).format(
        width_px=width_px,
        height_px=frame.height_px,
        outline=outline,
        die=Markup("").join(_die(frame, die) for die in dies),
    )


def _frame(dies: Sequence[JudgedDie], across_um: float, width_px: int, most_height_px: int) -> MapViewport:
    """Return a viewport that contains the dies, and the wafer if it is drawn."""
    half = across_um / 2 if _shows_wafer(dies, across_um) else 0.0
    x0, y0, x1, y1 = _bounds(dies)
    x0, y0, x1, y1 = (min(x0, -half), min(y0, -half), max(x1, half), max(y1, half)) if half else (x0, y0, x1, y1)
    pad = _ROUND_SHARE * max(x1 - x0, y1 - y0, 1.0)
    box = (x0 - pad, y0 - pad, x1 + pad, y1 + pad)
    height_px = min(most_height_px, max(40.0, width_px * (box[3] - box[1]) / (box[2] - box[0])))
    return MapViewport(box, width_px, height_px)


def _shows_wafer(dies: Sequence[JudgedDie], across_um: float) -> bool:
    x0, y0, x1, y1 = _bounds(dies)
    return across_um > 0 and max(x1 - x0, y1 - y0) > across_um / 4


def _bounds(dies: Sequence[JudgedDie]) -> Box:
    x0, y0 = min(die.x_um for die in dies), min(die.y_um for die in dies)
    return x0, y0, max(die.x_um + die.width_um for die in dies), max(die.y_um + die.height_um for die in dies)


def _outline(frame: MapViewport, across_um: float) -> Markup:
    x, y, r = frame.x(0.0), frame.y(0.0), across_um / 2 * frame.scale
    notch = Markup('<path d="M{:.1f} {:.1f}l4 -6l4 6z" fill="var(--ink3)"/>').format(x - 4, y + r)
    return Markup(
        '<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="var(--fill)" stroke="var(--ink3)"/>{notch}'
    ).format(x=x, y=y, radius=r, notch=notch)


def _die(frame: MapViewport, die: JudgedDie) -> Markup:
    ink, sign = INKS[die.word]
    x, y = frame.x(die.x_um), frame.y(die.y_um + die.height_um)
    w, h = max(2.0, die.width_um * frame.scale - 1), max(2.0, die.height_um * frame.scale - 1)
    size = min(16.0, 0.7 * min(w, h))
    text = (
        Markup(
            '<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" font-size="{size:.1f}" '
            'font-weight="700" fill="var(--{ink})">{sign}</text>'
        ).format(x=x + w / 2, y=y + h / 2 + 0.35 * size, size=size, ink=ink, sign=sign)
        if sign and min(w, h) >= _LEAST_FOR_SIGN_PX
        else Markup()
    )
    return Markup(
        '<g data-die="{name}"><title>Die {name}: {word}</title>'
        '<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="var(--{ink})" fill-opacity=".28" '
        'stroke="var(--{ink})"/>{text}</g>'
    ).format(name=die.name, word=die.word, x=x, y=y, w=w, h=h, ink=ink, text=text)


_WIDTH, _GAP = 360.0, 0.04
"""Width of the drawing in its own units; gap between cells as a share of the cell side."""
_WORDS_FROM = 34.0
"""Cell width from which the range is written in the cell."""
_LEAST_CONTRAST = 128
"""Luma (of 255) below which text on a cell is white."""


def site_map_svg(ranges: SiteRanges, colours: str = "mako") -> Markup:
    """Return the lattice with row 0 at the top; each cell has its position and range as a tooltip."""
    side = _WIDTH / ranges.cols
    height = side * ranges.site_height_um / ranges.site_width_um
    low, high = spread_um(ranges)
    cells = Markup("").join(
        _cell(
            site,
            (k % ranges.cols) * side,
            (k // ranges.cols) * height,
            side,
            height,
            _relative_range(site, low, high),
            colours,
        )
        for k, site in enumerate(ranges.sites)
    )
    return Markup(
        '<svg class="wv-sites" viewBox="0 0 {:g} {:.1f}" role="img" '
        'aria-label="Site ranges"><defs><pattern id="wv-no-range" width="6" height="6" patternUnits="userSpaceOnUse" '
        'patternTransform="rotate(45)"><path d="M0 0V6" stroke="var(--ink3)" stroke-width="1.4"/></pattern></defs>'
        "{}</svg>"
    ).format(_WIDTH, height * ranges.rows, cells)


def spread_um(ranges: SiteRanges) -> tuple[float, float]:
    """Return the smallest and the largest range of all sites."""
    spreads = [site.range.value_um for site in ranges.sites if site.range is not None]
    return min(spreads), max(spreads)


def _relative_range(site: Site, low: float, high: float) -> float | None:
    """Return the relative position of a range between the smallest and the largest; None without a range."""
    if site.range is None:
        return None
    return (site.range.value_um - low) / (high - low) if high > low else 0.5


def _cell(site: Site, x: float, y: float, side: float, height: float, share: float | None, colours: str) -> Markup:
    gap = _GAP * min(side, height)
    fill, ink = _inks(share, colours)
    text = f"{number(site.range.value_um, 3)}{THIN}µm" if site.range is not None else "too little of it is measured"
    where = f"x {number(site.x_um, 1)}, y {number(site.y_um, 1)}"
    box = Markup('x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}"').format(
        x=x + gap, y=y + gap, width=side - 2 * gap, height=height - 2 * gap
    )
    drawn = Markup('<rect {} rx="2" fill="{}"><title>{}</title></rect>').format(box, fill, f"{where}: {text}")
    if site.range is None or min(side, 2 * height) < _WORDS_FROM:
        return drawn
    middle = Markup('x="{:.1f}" y="{:.1f}"').format(x + side / 2, y + height / 2)
    size = min(12.0, 0.26 * side)
    words = Markup('{} fill="{}" font-size="{:.1f}" text-anchor="middle" dominant-baseline="central"').format(
        middle, ink, size
    )
    return Markup('{}<text {} pointer-events="none">{}</text>').format(drawn, words, number(site.range.value_um, 2))


def _inks(share: float | None, colours: str) -> tuple[str, str]:
    """Return the colours of a cell and of the text on it."""
    if share is None:
        return "url(#wv-no-range)", "var(--ink)"
    r, g, b = (int(v) for v in table(colours)[round(255 * share)])
    return f"rgb({r},{g},{b})", "#fff" if 0.299 * r + 0.587 * g + 0.114 * b < _LEAST_CONTRAST else "#15202B"
