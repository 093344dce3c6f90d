"""HTML of defects: classes, items, die map, Pareto chart, list, and the sections through one. Pure.

In a low window the style sheet reduces the bars to text, so that the list stays visible.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol, symbol_svg
from wafer_viewer.draw.charts.defect_charts import Bar, pareto
from wafer_viewer.draw.charts.die_map import DieFill, die_shapes, fills_by_count, kinds_of, look_svg
from wafer_viewer.draw.charts.wafer_map import MapViewport, Outline
from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.draw.quantities import value_texts
from wafer_viewer.gui.presenters.results import VERDICT_LOOKS, ReviewItem, Row, bounds_of
from wafer_viewer.gui.state.view_state import OF_DEFECT, SORTS, DefectListing, MapBy, ReviewFilter, listed
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Defect, Inspection, Judgement
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, DefectClass
from wafer_viewer.model.inspection.die_grid import DieStatus
from wafer_viewer.model.job import Judgement as Noted
from wafer_viewer.model.job import Verdict
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.session.state.inspection_state import InspectionState, OtherTool
from wafer_viewer.session.state.snapshot import Snapshot

TINY_PER_MM2 = 1e-3


REFERENCES = {
    "dies": "compared with the median of the dies",
    "golden": "compared with the golden die",
    "form": "compared with the fitted form",
}
JUDGED = {"open": "open", "real": "real defect", "nuisance": "not a defect"}


def sign_of(kind: DefectClass, side_px: int = 14) -> Markup:
    """Return the symbol of a class, with its colour and shape."""
    return symbol_svg(DEFECT_CLASSES[kind].shape, DEFECT_CLASSES[kind].colour, side_px)


def size_text(defect: Defect) -> str:
    """Format the length of a defect; a dash if its size is not resolved."""
    return with_unit(defect.major.value_um, 0 if defect.major.value_um >= 100 else 1) if defect.size_resolved else "—"


def below(defect: Defect) -> str:
    """Describe die, position and proposed class of a defect."""
    where = f"Die {defect.die}" if defect.die else "Outside of the dies"
    place = f"x {number(defect.center.x_um, 1)}, y {with_unit(defect.center.y_um, 1)}"
    own = defect.judged_kind is None
    by = (
        f"proposed with {number(defect.confidence, 2)}"
        if own
        else f"proposed: {DEFECT_CLASSES[defect.kind].title.lower()}"
    )
    return f"{where} · {place} · {by}"


def verdict_reason(defect: Defect) -> str:
    """Describe score and reasons of detection and classification."""
    repeats = ("on every die: compare with a golden die",) if defect.repeats else ()
    small = () if defect.size_resolved else ("detected, size not resolved",)
    score = f"{number(defect.score, 1)} times the local noise"
    return " · ".join((score, *small, *repeats, *defect.reasons))


def per_mm2(count: float | None) -> str:
    """Format an expected density per mm²; a sentence for None."""
    if count is None:
        return "not known before an inspection"
    return f"under {number(TINY_PER_MM2, 3)} per mm²" if count < TINY_PER_MM2 else f"{number(count, 3)} per mm²"


def summary(state: InspectionState) -> str:
    """Return warnings on the inspection, as HTML: failure, outdated surface, uninspected areas."""
    inspection = state.inspection
    problem = html.note("attention", "Inspection failed", state.problem) if state.problem else ""
    if inspection is None:
        return problem
    stale = (
        html.note(
            "attention",
            "The surface has been reconstructed since",
            "Inspect again: places and heights may have changed.",
        )
        if state.stale
        else ""
    )
    return problem + stale + unknown(inspection)


def facts(inspection: Inspection) -> Markup:
    """Return area, density, reference, threshold, expected false detections and notes of an inspection, as HTML."""
    return Markup("").join(
        Markup('<div class="wv-sub">{}</div>').format(html.with_micro_sign(line)) for line in _facts(inspection)
    )


def unknown(inspection: Inspection) -> Markup:
    """Return a warning on dies and areas not inspected; empty if everything was inspected."""
    blind = [die for die in inspection.dies if die.state not in ("whole", "missing")]
    causes = [f"{n} {'die' if n == 1 else 'dies'} {state}" for state, n in Counter(d.state for d in blind).items()]
    if inspection.unmeasured_mm2 > 0:
        causes.append(f"{number(inspection.unmeasured_mm2, 2)} mm² unmeasured")
    if not causes:
        return Markup()
    text = f"{', '.join(causes)}: these parts were not inspected."
    return Markup('<div class="wv-blind">{}</div>').format(html.note("attention", "Not all of it was inspected", text))


def nothing_found(inspection: Inspection) -> Markup:
    """Return the placeholder of an empty defect list."""
    if inspection.inspected_mm2 <= 0:
        return html.empty("Nothing could be inspected:", "this does not mean that the wafer is clean.")
    clean = sum(die.word == "clean" for die in inspection.dies)
    dies = "the one die" if clean == 1 else f"the {clean} dies"
    where = f"on {dies} inspected whole." if clean else f"on {number(inspection.inspected_mm2, 2)} mm²."
    return html.empty("No defect was found", where)


def judged(inspection: Inspection) -> str:
    """Return the number of judged defects; empty without defects."""
    n = sum(defect.judgement != "open" for defect in inspection.defects)
    return f"{n} of {len(inspection.defects)} judged" if inspection.defects else ""


def classes(defect: Defect) -> Markup:
    """Return the class buttons with their keys, the current class marked."""
    now = defect.seen_as
    tiles = (
        Markup(
            '<span class="{kind}" aria-pressed="{aria_pressed}" {command_pick}><kbd>{key}</kbd>{sign_of} {title}</span>'
        ).format(
            kind="on" if kind == now else "",
            aria_pressed=str(kind == now).lower(),
            command_pick=html.command_pick("defect-class", kind, "Defects judged"),
            key=look.key,
            sign_of=sign_of(kind),
            title=look.title,
        )
        for kind, look in DEFECT_CLASSES.items()
    )
    return html.head("Class", "keys 1 – 9") + Markup('<div class="wv-classes">{}</div>').format(Markup("").join(tiles))


def _facts(inspection: Inspection) -> list[str]:
    n_found, area = len(inspection.found), inspection.inspected_mm2
    density = f", {number(n_found / area, 2)} per mm²" if area > 0 else ""
    words = {True: "SIMULATED · ", False: ""}[inspection.simulated]
    return [
        f"{words}{n_found} on {number(area, 2)} mm²{density} · {REFERENCES[inspection.reference]}",
        f"Over {number(inspection.threshold_sigma, 1)} times the noise; expected to be false by noise alone: "
        f"{per_mm2(inspection.expected_false_per_mm2)}",
        *inspection.notes,
    ]


VERDICT_OF: dict[Judgement, Verdict] = {"open": "open", "real": "accepted", "nuisance": "rejected"}
JUDGEMENT_OF: dict[Verdict, Judgement] = {verdict: judgement for judgement, verdict in VERDICT_OF.items()}
"""Defect judgement by review verdict: an accepted defect is real."""
_items: dict[int, tuple[Defect, ReviewItem]] = {}
"""Cache of review items by defect number: a judgement changes one of thousands."""


def key_of(defect: Defect) -> str:
    """Return the review key of a defect."""
    return f"{OF_DEFECT}{defect.number}"


def number_of(key: str | None) -> int | None:
    """Return the defect number of a review key; None if the key is not of a defect."""
    digits = key.removeprefix(OF_DEFECT) if key is not None and key.startswith(OF_DEFECT) else ""
    return int(digits) if digits.isdecimal() else None


def chosen_defect(snapshot: Snapshot, key: str | None) -> Defect | None:
    """Return the defect of a review key; None if the key is not of a defect."""
    number = number_of(key)
    return snapshot.inspection.defect(number) if number is not None else None


def defect_items(snapshot: Snapshot, listing: DefectListing) -> tuple[ReviewItem, ...]:
    """Return the listed defects as review items, in list order."""
    return _listed(snapshot.inspection, listing)


def defect_item(snapshot: Snapshot, key: str | None) -> ReviewItem | None:
    """Return the review item of a defect, listed or not; None if there is no such defect."""
    defect = chosen_defect(snapshot, key)
    return _item(defect) if defect is not None else None


def on_show(defects: Iterable[Defect], listing: DefectListing, only: ReviewFilter) -> tuple[Defect, ...]:
    """Return the listed defects whose verdict matches the filter `only`."""
    return tuple(d for d in listed(defects, listing) if only in ("all", VERDICT_OF[d.judgement]))


@lru_cache(maxsize=8)
def _listed(state: InspectionState, listing: DefectListing) -> tuple[ReviewItem, ...]:
    return tuple(_item(defect) for defect in listed(state.defects, listing))


def _item(defect: Defect) -> ReviewItem:
    cached = _items.get(defect.number)
    if cached is None or cached[0] is not defect:
        cached = _items[defect.number] = defect, _made(defect)
    return cached[1]


def _made(defect: Defect) -> ReviewItem:
    look, height = DEFECT_CLASSES[defect.seen_as], value_texts(defect.height.quantity, signed=True)
    return ReviewItem(
        key=key_of(defect),
        sign=f"D{defect.number}",
        colour=look.colour,
        title=look.title,
        below=below(defect),
        value=Markup("<b>{}</b><small>{} {}</small>").format(size_text(defect), height[0], height[2]),
        rows=tuple(_rows(defect)),
        judgement=Noted(key=key_of(defect), verdict=VERDICT_OF[defect.judgement], note=defect.note),
        box_um=bounds_of(defect),
        show=defect.show,
        levelling=defect.levelling,
        reason=verdict_reason(defect),
        defect=defect.number,
        shape=look.shape,
    )


def _rows(defect: Defect) -> Iterator[Row]:
    """Yield the measured quantities of a defect; sizes only if they are resolved."""
    yield "Height from its surroundings", *value_texts(defect.height.quantity, signed=True)
    if defect.size_resolved:
        yield "Length", *value_texts(defect.major.quantity)
        yield "Width", *value_texts(defect.minor.quantity)
        yield "Area", *value_texts(defect.area)
        yield "Volume", *value_texts(defect.volume)


BY: dict[MapBy, str] = {"class": "class", "count": "count"}
MOST_SIGNS = 400
"""With more defects no symbols are drawn, as they would overlap: dies have the colour of their commonest class."""
CLASS_OPACITY, JUDGED_OPACITY, OTHER_HALF_PX = 0.45, 0.35, 6


def map_head(listing: DefectListing) -> Markup:
    """Return the head with the switch between colouring by class and by count."""
    ways = Markup("").join(
        Markup('<span class="{by}" aria-pressed="{aria_pressed}" {pick}>{name}</span>').format(
            by="on" if by == listing.map_by else "",
            aria_pressed=str(by == listing.map_by).lower(),
            pick=html.pick("defect-map-by", by),
            name=name,
        )
        for by, name in BY.items()
    )
    switch = Markup('<span class="wv-by" aria-label="Coloured by">{}</span>').format(ways)
    return Markup('<div class="wv-h first">Defects on the dies{}</div>').format(switch)


def map_html(
    frame: MapViewport,
    inspection: Inspection,
    defects: Sequence[Defect],
    listing: DefectListing,
    outline_um: Outline = (),
    over: str = "",
) -> Markup:
    """Return the map of dies with the defects `defects`, and its legend; the SVG `over` is drawn on top."""
    many, by_class = len(defects) > MOST_SIGNS, listing.map_by == "class"
    fills = fills_by_count(counts_of(defects)) if not by_class else fills_by_class(defects) if many else {}
    shapes = die_shapes(frame, inspection, fills, outline_um=outline_um, chosen=listing.die)
    signs = Markup("").join(_sign(frame, defect) for defect in defects) if by_class and not many else ""
    kinds = kinds_of(inspection.dies).items()
    legend = html.legend((look_svg(kind), f"{number(n, 0)} {kind}") for kind, n in kinds)
    note = "Each die has the colour of its commonest class." if by_class and many else ""
    below = Markup('<div class="wv-lab">{}</div>').format(note) if note else Markup()
    return Markup('<div class="wv-dies-and">{}{}</div>{}').format(_svg(frame, shapes + signs + over), legend, below)


def fills_by_class(defects: Sequence[Defect]) -> dict[str, DieFill]:
    """Return the fill of each die by name: the colour of its commonest defect class."""
    on: dict[str, Counter[DefectClass]] = {}
    for defect in defects:
        on.setdefault(defect.die, Counter())[defect.seen_as] += 1
    return {
        die: DieFill(DEFECT_CLASSES[max(kinds, key=kinds.__getitem__)].colour, CLASS_OPACITY)
        for die, kinds in on.items()
    }


def counts_of(defects: Sequence[Defect]) -> Counter[str]:
    """Count the defects on each die; unmeasured areas do not count."""
    return Counter(defect.die for defect in defects if defect.seen_as != "unmeasured")


def other_signs(frame: MapViewport, other: OtherTool) -> Markup:
    """Return squares at the defects of another tool; a symbol inside a square marks a match."""
    drawn: list[Markup] = []
    for defect, place in zip(other.klarf.defects, other.places, strict=True):
        (x0, y0, x1, y1), half = place.bounds_um, OTHER_HALF_PX
        x, y = frame.x((x0 + x1) / 2) - half, frame.y((y0 + y1) / 2) - half
        drawn.append(
            Markup(
                '<rect x="{x:.1f}" y="{y:.1f}" width="{width}" height="{width}" fill="none" stroke="var(--ink2)">'
                "<title>{name}: no. {number}</title></rect>"
            ).format(x=x, y=y, width=2 * half, name=other.name, number=defect.number)
        )
    return Markup('<g class="wv-other">{}</g>').format(Markup("").join(drawn))


def _sign(frame: MapViewport, defect: Defect) -> Markup:
    look, centre = DEFECT_CLASSES[defect.seen_as], (frame.x(defect.center.x_um), frame.y(defect.center.y_um))
    faint = Markup() if defect.judgement == "open" else Markup(' opacity="{}"').format(JUDGED_OPACITY)
    return Markup(
        '<g data-d="{data_d}" data-pick="review" data-k="{data_d}" class="wv-go"{faint} '
        'stroke="var(--panel)" stroke-width="1.2" paint-order="stroke"><title>D{number} · {title}, {judged}</title>'
        "{symbol}</g>"
    ).format(
        data_d=key_of(defect),
        faint=faint,
        number=defect.number,
        title=look.title,
        judged=JUDGED[defect.judgement],
        symbol=symbol(look.shape, look.colour, *centre, 3.6),
    )


def _svg(frame: MapViewport, shapes: str) -> Markup:
    w, h = round(frame.width_px), round(frame.height_px)
    return Markup(
        '<div class="wv-dies"><svg class="wv-map wv-go" width="{w}" height="{h}" viewBox="0 0 {w} {h}" role="img" '
        'aria-label="Dies of the sample with their defects" style="display:block" '
        'data-pick="defect-at" {place}>{shapes}</svg></div>'
    ).format(w=w, h=h, place=frame.place_attributes, shapes=shapes)


def chart_of(state: InspectionState, listing: DefectListing, only: ReviewFilter) -> Markup:
    """Return the chart of the listed defects, with all classes; cached."""
    return _chart(state, replace(listing, sort="size", map_by="class"), only)


@lru_cache(maxsize=8)
def _chart(state: InspectionState, listing: DefectListing, only: ReviewFilter) -> Markup:
    return pareto_html(on_show(state.defects, replace(listing, kind=""), only), listing.kind)


def pareto_html(defects: Iterable[Defect], chosen: str) -> Markup:
    """Return the Pareto chart; the operator's class overrides the proposed one, `chosen` is the filtered class.

    Unmeasured areas are no defects and have no share.
    """
    kinds: list[DefectClass] = [defect.seen_as for defect in defects]
    classes: list[DefectClass] = [kind for kind in kinds if kind != "unmeasured"]
    bars = pareto(classes)
    rows = [_class_row(bar.kind, bar.count, chosen, _bar(bar), f"{number(100 * bar.cumulated, 0)} %") for bar in bars]
    if (unmeasured := kinds.count("unmeasured")) > 0:
        rows.append(_class_row("unmeasured", unmeasured, chosen, Markup("<i></i>"), ""))
    head = Markup(
        '<div class="wv-pareto-head"><span>Class</span><span>Share</span><span>n</span><span>Sum</span></div>'
    )
    return (
        Markup('<div class="wv-pareto" aria-label="Classes">{}{}</div>').format(head, Markup("").join(rows))
        if rows
        else Markup()
    )


def _class_row(kind: DefectClass, n: int, chosen: str, bar: str, cumulated: str) -> Markup:
    on = kind == chosen
    return Markup(
        '<span class="{on}" aria-pressed="{aria_pressed}" {pick}>'
        "<span>{sign_of} {title}</span>"
        "{bar}<b>{number}</b><small>{cumulated}</small></span>"
    ).format(
        on="on" if on else "",
        aria_pressed=str(on).lower(),
        pick=html.pick("defect-kind", kind),
        sign_of=sign_of(kind),
        title=DEFECT_CLASSES[kind].title,
        bar=bar,
        number=number(n, 0),
        cumulated=cumulated,
    )


def _bar(bar: Bar) -> Markup:
    """Return the bar with the share of a class, and in a paler colour the cumulative share."""
    title = f"{number(100 * bar.share, 0)} % of all, {number(100 * bar.cumulated, 0)} % with those above"
    return Markup(
        '<i title="{title}"><i style="width:{width:.1f}%"></i>'
        '<i style="width:{width2:.1f}%;background:{colour}"></i></i>'
    ).format(title=title, width=100 * bar.cumulated, width2=100 * bar.share, colour=DEFECT_CLASSES[bar.kind].colour)


MOST_ROWS, ROWS_BEFORE = 40, 2
"""Rows shown at once, as thousands of pictures would be slow; rows before the item under review."""
JUDGED_BRIEFLY = {"open": "open", "accepted": "real", "rejected": "not a defect"}


def rows_of(items: Sequence[ReviewItem], now: ReviewItem | None) -> Sequence[ReviewItem]:
    """Return the items to show: from shortly before the one under review, which is always visible."""
    keys = [item.key for item in items]
    index = keys.index(now.key) if now is not None and now.key in keys else 0
    first = max(0, index - ROWS_BEFORE)
    return items[first : first + MOST_ROWS]


def rows(
    items: Sequence[ReviewItem], shown: Sequence[ReviewItem], now: ReviewItem | None, thumbs: Sequence[str]
) -> Markup:
    """Return the list, with links to the items before and after."""
    if not shown:
        return html.empty("No defect matches.")
    first = items.index(shown[0])
    before, after = items[:first][::-1], items[first + len(shown) :]
    body = [
        _row(item, now is not None and item.key == now.key, thumb) for item, thumb in zip(shown, thumbs, strict=True)
    ]
    more = _more(before, "before") + html.table([], body, "  n") + _more(after, "more")
    return Markup('<div class="wv-defects">{}</div><div style="height:8px"></div>').format(more)


def sorting(listing: DefectListing, inspection: Inspection) -> Markup:
    """Return the sort buttons and the active filters."""
    buttons = Markup("").join(
        Markup('<span class="{sort}" aria-pressed="{aria_pressed}" {pick}>{name}</span>').format(
            sort="on" if sort == listing.sort else "",
            aria_pressed=str(sort == listing.sort).lower(),
            pick=html.pick("defect-sort", sort),
            name=name,
        )
        for sort, (name, _) in SORTS.items()
    )
    return Markup('<div class="wv-segments" aria-label="Sort by">{}</div>{}').format(
        buttons, _alone(listing, inspection)
    )


def _alone(listing: DefectListing, inspection: Inspection) -> Markup:
    """Return the active filters with a link that clears them; empty if everything is listed."""
    state = next((die.word for die in inspection.dies if die.name == listing.die), "")
    filters = [f"Die {listing.die} ({state})" if state else f"Die {listing.die}"] if listing.die else []
    filters += [DEFECT_CLASSES[kind].title for kind in DEFECT_CLASSES if kind == listing.kind]
    filters += [f"{len(listing.numbers)} of one place on the dies"] if listing.numbers else []
    link = Markup('<span class="wv-link" {}>all</span>').format(html.pick("defect-all"))
    return (
        Markup('<div class="wv-lab wv-alone">{} alone · {}</div>').format(Markup(" · ").join(filters), link)
        if filters
        else Markup()
    )


def _more(items: Sequence[ReviewItem], word: str) -> Markup:
    if not items:
        return Markup()
    link = Markup('<span class="wv-link" {}>{} {} …</span>').format(html.pick("review", items[0].key), len(items), word)
    return Markup('<div class="wv-lab">{}</div>').format(link)


def _row(item: ReviewItem, chosen: bool, thumbs: str) -> Markup:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    title, where = item.title, item.below.split(" · ")[0].lower()
    tip = f"{item.sign}, {item.title}, {where}, {JUDGED_BRIEFLY[item.judgement.verdict]}"
    name = Markup(
        '<span class="wv-cut wv-short" title="{title}">{symbol_svg} {title}</span>'
        '<small title="{tip}"><span style="color:var(--{colour})">{icon}</span> '
        "{sign} · {value}</small>"
    ).format(
        title=title,
        symbol_svg=symbol_svg(item.shape, item.colour),
        tip=tip,
        colour=colour,
        icon=html.icon(sign, 13),
        sign=item.sign,
        value=where.removeprefix("die "),
    )
    attributes = Markup('{} aria-label="{}"').format(html.pick("review", item.key), tip)
    return html.row(
        [Markup('<div class="wv-pair">{}</div>').format(thumbs), name, item.value],
        "  n",
        attributes,
        "sel" if chosen else "",
    )


TIMES, LEAST_PX = 4.0, 160
"""Length of the line as a multiple of the defect's size, and its least length in surface pixels."""


@dataclass(frozen=True, slots=True)
class DefectCut:
    """Line through a defect, then the same line on the good die `neighbour`, if any; surface and levelling."""

    lines: tuple[Region, ...]
    neighbour: str = ""
    show: int = 0
    levelling: Levelling = Levelling()


def cut_through(defect: Defect, inspection: Inspection | None, pixel_um: float) -> DefectCut:
    """Return the section lines of a defect."""
    x0, _, x1, _ = defect.outline.bounds_um
    length_um = max(TIMES * (x1 - x0), TIMES * defect.minor.value_um, LEAST_PX * pixel_um)
    grid = inspection.grid if inspection is not None else None
    angle = grid.angle_rad if grid is not None else 0.0
    half_x, half_y = length_um / 2 * math.cos(angle), length_um / 2 * math.sin(angle)
    middle = defect.center.x_um, defect.center.y_um
    neighbour = neighbour_of(defect, inspection) if inspection is not None else None
    middles = [middle]
    if grid is not None and neighbour is not None and defect.in_die is not None:
        x_um, y_um = grid.to_stage(neighbour.col, neighbour.row, defect.in_die.x_um, defect.in_die.y_um)
        middles.append((float(x_um), float(y_um)))
    lines = tuple(Region.line(x - half_x, y - half_y, x + half_x, y + half_y) for x, y in middles)
    return DefectCut(
        lines, neighbour.name if len(lines) > 1 and neighbour is not None else "", defect.show, defect.levelling
    )


def neighbour_of(defect: Defect, inspection: Inspection) -> DieStatus | None:
    """Return the nearest fully inspected other die, preferably one without defects; None if there is none."""
    own = next((die for die in inspection.dies if die.name == defect.die), None)
    others = [die for die in inspection.dies if die.state == "whole" and die.name != defect.die]
    if own is None or not others:
        return None
    return min(others, key=lambda die: (bool(die.defects), abs(die.col - own.col) + abs(die.row - own.row), die.col))
