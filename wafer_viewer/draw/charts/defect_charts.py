"""Charts of defects as SVG and HTML: all dies overlaid, and the classes by count.

Colours of lines and text are custom properties (``--ink``, ``--line`` …) of the embedding page.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axis, symbol
from wafer_viewer.model.inspection.defect import Defect, Inspection, RepeatedPlace
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.region import Region

Attributes = Callable[[str, object], str]
"""Function that returns the HTML attributes of a clickable part, from its kind and its key."""
MOST_MARKS = 1500
"""Greatest number of drawn defects; those of repeated places have priority."""
_MARGIN_PX, _MARK_PX, _LEAST_RING_PX = 10.0, 3.6, 9.0


def die_stack_svg(
    inspection: Inspection,
    places: Sequence[RepeatedPlace],
    picture_url: str = "",
    *,
    width_px: int = 420,
    most_height_px: int = 420,
    chosen: int | None = None,
    place: int | None = None,
    attributes: Attributes = lambda what, key: "",
) -> Markup:
    """Return the overlay of all dies; empty without dies. chosen: a defect number, place: index in `places`."""
    grid = inspection.grid
    if grid is None:
        return Markup()
    room = width_px - 2 * _MARGIN_PX, most_height_px - 2 * _MARGIN_PX
    scale = min(room[0] / grid.width_um, room[1] / grid.height_um)
    width, height = grid.width_um * scale, grid.height_um * scale

    def to_map(u_um: float, v_um: float) -> tuple[float, float]:
        """Return the image position; marks outside the die are clamped to its margin."""
        x, y = _MARGIN_PX + u_um * scale, _MARGIN_PX + height - v_um * scale
        return min(max(x, 2.0), width + 2 * _MARGIN_PX - 2), min(max(y, 2.0), height + 2 * _MARGIN_PX - 2)

    box = Markup('x="{margin_px:g}" y="{margin_px:g}" width="{width:.1f}" height="{height:.1f}"').format(
        margin_px=_MARGIN_PX, width=width, height=height
    )
    image = (
        Markup('<image {} href="{}" preserveAspectRatio="none"/>').format(box, picture_url) if picture_url else Markup()
    )
    frame = Markup('<rect {} fill="{}" stroke="var(--ink3)"/>').format(box, "none" if picture_url else "var(--fill)")
    drawn = shown(inspection, places)
    areas = Markup("").join(_left_out(area, to_map) for area in inspection.recipe.excluded)
    marks = Markup("").join(_mark(d, to_map, d.number == chosen, attributes) for d in drawn if d.in_die is not None)
    rings = Markup("").join(_ring(k, one, to_map, scale, k == place, attributes) for k, one in enumerate(places))
    w, h = width + 2 * _MARGIN_PX, height + 2 * _MARGIN_PX
    return Markup(
        '<svg class="wv-stack" viewBox="0 0 {w:.0f} {h:.0f}" width="{w:.0f}" height="{h:.0f}" role="img" '
        'aria-label="All dies overlaid" style="max-width:100%">{image}{frame}{areas}{rings}{marks}</svg>'
    ).format(w=w, h=h, image=image, frame=frame, areas=areas, rings=rings, marks=marks)


def shown(inspection: Inspection, places: Sequence[RepeatedPlace]) -> list[Defect]:
    """Return the drawn defects, those of repeated places last, so that they are on top."""
    repeated = {number for place in places for number in place.numbers}
    on_dies = [defect for defect in inspection.found if defect.in_die is not None and defect.die]
    some = sorted(on_dies, key=lambda defect: (defect.number not in repeated, -defect.score))[:MOST_MARKS]
    return some[::-1]


def not_drawn(inspection: Inspection, drawn: Collection[Defect]) -> int:
    """Return the number of defects on dies that are not drawn."""
    return sum(bool(d.die) and d.in_die is not None for d in inspection.found) - len(drawn)


def _left_out(area: Region, to_map: Callable[[float, float], tuple[float, float]]) -> Markup:
    """Return an excluded area: a translucent fill with a dashed outline."""
    x0, y0, x1, y1 = area.bounds_um
    corners = (
        [(p.x_um, p.y_um) for p in area.points] if area.kind == "polygon" else [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    )
    (left, low), (right, high) = to_map(x0, y0), to_map(x1, y1)
    look = Markup('fill="#fff" fill-opacity=".55" stroke="#15202B" stroke-width="1.2" stroke-dasharray="4 3"')
    if area.kind == "circle":
        middle = Markup('cx="{:.1f}" cy="{:.1f}"').format((left + right) / 2, (low + high) / 2)
        shape = Markup('<ellipse {middle} rx="{rx:.1f}" ry="{ry:.1f}" {look}/>').format(
            middle=middle, rx=(right - left) / 2, ry=(low - high) / 2, look=look
        )
    else:
        shape = Markup('<polygon points="{}" {}/>').format(
            Markup(" ").join(f"{x:.1f},{y:.1f}" for x, y in (to_map(*c) for c in corners)), look
        )
    return Markup("<g><title>Left out: not searched</title>{}</g>").format(shape)


def _mark(
    defect: Defect, to_map: Callable[[float, float], tuple[float, float]], chosen: bool, attributes: Attributes
) -> Markup:
    if defect.in_die is None:
        return Markup()
    x, y = to_map(defect.in_die.x_um, defect.in_die.y_um)
    look = DEFECT_CLASSES[defect.seen_as]
    name = f"D{defect.number}, {look.title}, die {defect.die}"
    ring = (
        Markup('<circle cx="{:.1f}" cy="{:.1f}" r="8" fill="none" stroke="#15202B" stroke-width="2"/>').format(x, y)
        if chosen
        else Markup()
    )
    faint = Markup(' opacity=".35"') if defect.judgement == "nuisance" else Markup()
    return Markup(
        '<g {attributes} aria-label="{name}"{faint}><title>{name}</title>{ring}'
        '<g stroke="#fff" stroke-width="1.4" paint-order="stroke">{symbol}'
        "</g></g>"
    ).format(
        attributes=attributes("review", f"defect {defect.number}"),
        name=name,
        faint=faint,
        ring=ring,
        symbol=symbol(look.shape, look.colour, x, y, _MARK_PX),
    )


def _ring(
    k: int,
    place: RepeatedPlace,
    to_map: Callable[[float, float], tuple[float, float]],
    scale: float,
    chosen: bool,
    attributes: Attributes,
) -> Markup:
    x, y = to_map(place.in_die.x_um, place.in_die.y_um)
    radius = max(_LEAST_RING_PX, place.reach_um * scale + 6)
    name = f"Place {k + 1}, {place.words}"
    lines = Markup("").join(
        Markup(
            '<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="{ink}" stroke-width="{width}"/>'
        ).format(x=x, y=y, radius=radius, ink=ink, width=width)
        for ink, width in (("#fff", 4.5), ("#15202B", 2.6 if chosen else 1.5))
    )
    word = Markup(
        '<text x="{:.1f}" y="{:.1f}" font-size="12" font-weight="650" fill="#15202B" '
        'stroke="#fff" stroke-width="3" paint-order="stroke">{}</text>'
    ).format(x + radius + 2, y - radius + 5, k + 1)
    return Markup('<g {attributes} aria-label="{name}"><title>{name}</title>{lines}{word}</g>').format(
        attributes=attributes("defect-place", k), name=name, lines=lines, word=word
    )


_ROW_PX, _SIGN_PX, _NAME_PX, _NUMBER_PX = 20, 16, 100, 36


@dataclass(frozen=True, slots=True)
class Bar:
    """One class: count, share of all defects, and cumulative share."""

    kind: str
    count: int
    share: float
    cumulated: float


def pareto(kinds: Iterable[str]) -> tuple[Bar, ...]:
    """Return a bar for each class that occurs; classes of equal count are in order of first occurrence."""
    counts, bars, so_far = Counter(kinds), list[Bar](), 0
    total = sum(counts.values())
    for kind, n in counts.most_common():
        so_far += n
        bars.append(Bar(kind, n, n / total, so_far / total))
    return tuple(bars)


def pareto_svg(kinds: Iterable[str], *, width_px: int = 300) -> Markup:
    """Return the bars with counts and cumulative shares, for reports."""
    bars = pareto(kinds)
    most = max((bar.count for bar in bars), default=1)
    counts = Axis((0, most), (_NAME_PX, width_px - 2 * _NUMBER_PX))
    drawn = Markup("").join(_row(k * _ROW_PX, bar, counts, width_px) for k, bar in enumerate(bars))
    label = "Defects by class, the most frequent first; the share of all up to each"
    return Markup(
        '<svg viewBox="0 0 {width_px} {box}" width="{width_px}" role="img" aria-label="{label}">{drawn}</svg>'
    ).format(width_px=width_px, box=len(bars) * _ROW_PX, label=label, drawn=drawn)


def _row(y: int, bar: Bar, counts: Axis, width_px: int) -> Markup:
    look, end = DEFECT_CLASSES[bar.kind], counts.at(bar.count)
    return Markup(
        "{symbol}"
        '<text x="{sign_px}" y="{y}" font-size="12" fill="var(--ink)">{title}</text>'
        '<rect x="{name_px}" y="{y2}" width="{width:.1f}" height="{height}" fill="{colour}"/>'
        '<text x="{x:.1f}" y="{y}" font-size="12" fill="var(--ink)">{count}</text>'
        '<text x="{width_px}" y="{y}" font-size="12" text-anchor="end" fill="var(--ink3)">'
        "{cumulated:.0f} %</text>"
    ).format(
        symbol=symbol(look.shape, look.colour, 6, y + 10),
        sign_px=_SIGN_PX,
        y=y + 14,
        title=look.title,
        name_px=_NAME_PX,
        y2=y + 4,
        width=end - _NAME_PX,
        height=_ROW_PX - 8,
        colour=look.colour,
        x=end + 6,
        count=bar.count,
        width_px=width_px,
        cumulated=100 * bar.cumulated,
    )
