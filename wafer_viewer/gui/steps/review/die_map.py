"""The map of dies in Review, which takes the place of the field map: clicks and keys filter the list by die or class.

Two drawings are stacked, because they change at different rates: the dies and symbols change with the list, the marks
of the defect under review and of the camera's view change all the time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol
from wafer_viewer.draw.charts.die_map import (
    DieFill,
    die_frame,
    die_shapes,
    fills_by_count,
    fills_by_number,
    kinds_of,
    look_svg,
)
from wafer_viewer.draw.charts.wafer_map import MOST_HEIGHT_PX, WIDTH_PX, MapMark, MapViewport, Outline, map_marks_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters.review import JUDGED, VERDICT_OF, chosen_defect, key_of, on_show
from wafer_viewer.gui.state.view_state import DefectListing, MapBy, ReviewFilter, View, next_die, next_kind
from wafer_viewer.gui.steps.review.judging import Review
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, ClassTable
from wafer_viewer.model.inspection.die_grid import DIE_UNITS, DieNumber
from wafer_viewer.model.quantity import Quantity, digits_of_u
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import InspectionState, OtherTool
from wafer_viewer.session.state.snapshot import Snapshot

TO_DIES = (("Next die with open defects", "pagedown", 1), ("Previous die with open defects", "pageup", -1))
CameraView = Callable[[], Outline | None]
"""Returns the ground area in the camera's view."""


def has_die_map(snapshot: Snapshot, view: View) -> bool:
    """Return whether the map shows dies."""
    inspection = snapshot.inspection.inspection
    return view.step == "review" and inspection is not None and bool(inspection.grid and inspection.dies)


def die_map(here: Here[tuple[Review, CameraView]]) -> Elements | None:
    """Return the dies with the listed defects, and the marks over them."""
    snapshot, view = here.snapshot, here.view
    inspection = snapshot.inspection.inspection
    if inspection is None or not has_die_map(snapshot, view):
        return None
    listing = replace(view.defects, sort="size")
    outline = snapshot.dataset_overview.outline_um if snapshot.dataset_overview else ()
    frame, drawn = _drawn(snapshot.inspection, outline, listing, view.review_filter, snapshot.defect_files.other)
    defect = chosen_defect(snapshot, view.review)
    marks = map_marks_svg(frame, here.own[1]() or (), [_mark(defect)] if defect is not None else ()) if frame else ""
    ways = html.segments("defect-map-by", BY.items(), view.defects.map_by, "Coloured by")
    return [
        Html(Markup('<div class="wv-h first">Defects on the dies</div>{}').format(ways)),
        Html(Markup('<div class="wv-over-map wv-dies">{}</div>').format(marks) if marks else ""),
        Html(drawn),
    ]


MAP_PICKS: Picks[tuple[Review, CameraView]] = {
    "defect-map-by": lambda here, by: here.own[0].list_by(map_by=by),
    "defect-kind": lambda here, kind: here.own[0].list_by(kind="" if here.page.view.defects.kind == kind else kind),
    "defect-all": lambda here, _: here.page.change(defects=here.page.view.defects.widened),
    "defect-at": lambda here, at: _choose_at(here.own[0], *(float(um) for um in at.split(","))),
}


def map_commands(review: Review) -> list[Command]:
    """Return the commands that step through dies and classes."""
    icon = viser.Icon
    return with_precondition(
        require_step("review"),
        *(
            Command(name, key, lambda b=by: _step_die(review, b), icon.GRID_DOTS, "alt", "Review")
            for name, key, by in TO_DIES
        ),
        Command("Show only the next class", "0", lambda: _step_kind(review), icon.FILTER, group="Review"),
        *(Command(f"Dies by {by}", None, lambda b=by: review.list_by(map_by=b), icon.MAP, group="Review") for by in BY),
    )


def _choose_at(review: Review, x_um: float, y_um: float) -> None:
    """Filter the list by the die at a place; remove the filter if that die is filtered already."""
    inspection = review.page.session.snapshot.inspection.inspection
    if die := die_at(inspection, x_um, y_um) if inspection is not None else "":
        review.list_by(die="" if die == review.page.view.defects.die else die)


def _step_die(review: Review, by: int) -> None:
    page = review.page
    if (die := next_die(page.session.snapshot.inspection.defects, page.view.defects, by)) is None:
        page.say("No die to go to", "No defect that is listed and lies on a die is open.", "attention")
    else:
        review.list_by(die=die)


def _step_kind(review: Review) -> None:
    page = review.page
    review.list_by(kind=next_kind(page.session.snapshot.inspection.defects, page.view.defects))


@lru_cache(maxsize=4)
def _drawn(
    state: InspectionState, outline: Outline, listing: DefectListing, only: ReviewFilter, other: OtherTool | None
) -> tuple[MapViewport | None, Markup]:
    inspection = state.inspection
    frame = die_frame(inspection, outline, width_px=WIDTH_PX, most_height_px=MOST_HEIGHT_PX) if inspection else None
    if inspection is None or frame is None:
        return None, Markup()
    defects = on_show(state.defects, replace(listing, die=""), only)
    over = other_signs(frame, other) if other is not None else ""
    return frame, map_html(frame, inspection, defects, listing, outline, over)


def die_at(inspection: Inspection, x_um: float, y_um: float) -> str:
    """Return the name of the die at a place; empty outside of all inspected dies."""
    if inspection.grid is None:
        return ""
    col, row, u, v = (float(one[0]) for one in inspection.grid.to_die(np.array([x_um]), np.array([y_um])))
    name = inspection.grid.name(int(col), int(row))
    on_it = 0 <= u <= inspection.grid.width_um and 0 <= v <= inspection.grid.height_um
    return name if on_it and any(die.name == name for die in inspection.dies) else ""


def _mark(defect: Defect) -> MapMark:
    look = DEFECT_CLASSES[defect.seen_as]
    name = f"D{defect.number} · {look.title}"
    return MapMark(defect.center.x_um, defect.center.y_um, look.colour, name, chosen=True, shape=look.shape)


BY: dict[MapBy, str] = {
    name: "Bright" if name == "brightness" else name.capitalize() for name in ("class", "count", *DIE_UNITS)
}
"""Short titles of what colours the dies: six stand side by side in the panel."""
MOST_DIES = 8
"""Rows of the table of dies, those that lie or shine farthest off."""
MOST_SIGNS = 400
"""With more defects no symbols are drawn, as they would overlap: dies have the colour of their commonest class."""
CLASS_OPACITY, JUDGED_OPACITY, OTHER_HALF_PX = 0.45, 0.35, 6


def map_html(
    frame: MapViewport,
    inspection: Inspection,
    defects: Sequence[Defect],
    listing: DefectListing,
    outline_um: Outline = (),
    over: str = "",
) -> Markup:
    """Return the map of dies with the defects `defects`, and its legend; the SVG `over` is drawn on top."""
    classes = inspection.recipe.class_table
    many, by_class = len(defects) > MOST_SIGNS, listing.map_by == "class"
    if listing.map_by in ("class", "count"):
        fills = fills_by_count(counts_of(defects)) if not by_class else fills_by_class(defects, classes) if many else {}
        table = Markup()
    else:
        fills, table = fills_by_number(inspection, listing.map_by), dies_table(inspection, listing.map_by)
    shapes = die_shapes(frame, inspection, fills, outline_um=outline_um, chosen=listing.die)
    signs = Markup("").join(_sign(frame, defect, classes) for defect in defects) if by_class and not many else ""
    kinds = kinds_of(inspection.dies).items()
    legend = html.legend((look_svg(kind), f"{number(n, 0)} {kind}") for kind, n in kinds)
    note = "Each die has the colour of its commonest class." if by_class and many else ""
    below = Markup('<div class="wv-lab">{}</div>').format(note) if note else Markup()
    drawn = _svg(frame, shapes + signs + over)
    return Markup('<div class="wv-dies-and">{}{}</div>{}{}').format(drawn, legend, below, table)


def dies_table(inspection: Inspection, by: DieNumber) -> Markup:
    """Return the table of the dies that are farthest off in a number, with U where it is known."""
    dies = [(die, die.measured) for die in inspection.dies if die.measured is not None]
    dies.sort(key=lambda one: -abs(one[1].value(by)))
    if not dies:
        return html.empty("No die was measured:", "inspect die to die.")
    rows = [
        html.row(
            [
                html.typeset(die.name),
                *(_with_u(one) for one in (at.tilt_x, at.tilt_y, at.offset.quantity, at.bow.quantity)),
                f"{100 * at.brightness_fraction:+.1f}",
            ],
            " nnnnn",
        )
        for die, at in dies[:MOST_DIES]
    ]
    heads = ["Die", "Tilt x, mrad", "Tilt y, mrad", "Offset, µm", "Bow, µm", "Bright, %"]
    return html.table(heads, rows, " nnnnn")


def _with_u(quantity: Quantity) -> str:
    digits = digits_of_u(quantity.expanded) if quantity.expanded else 2
    u = f" ± {quantity.expanded:.{digits}f}" if quantity.expanded else ""
    return f"{quantity.value:.{digits}f}{u}"


def fills_by_class(defects: Sequence[Defect], table: ClassTable = DEFECT_CLASSES) -> dict[str, DieFill]:
    """Return the fill of each die by name: the colour of its commonest defect class."""
    on: dict[str, Counter[str]] = {}
    for defect in defects:
        on.setdefault(defect.die, Counter())[defect.seen_as] += 1
    return {die: DieFill(table[max(kinds, key=kinds.__getitem__)].colour, CLASS_OPACITY) for die, kinds in on.items()}


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


def _sign(frame: MapViewport, defect: Defect, table: ClassTable) -> Markup:
    look, centre = table[defect.seen_as], (frame.x(defect.center.x_um), frame.y(defect.center.y_um))
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
        judged=JUDGED[VERDICT_OF[defect.judgement]],
        symbol=symbol(look.shape, look.colour, *centre, 3.6),
    )


def _svg(frame: MapViewport, shapes: str) -> Markup:
    w, h = round(frame.width_px), round(frame.height_px)
    return Markup(
        '<div class="wv-dies"><svg class="wv-map wv-go" width="{w}" height="{h}" viewBox="0 0 {w} {h}" role="img" '
        'aria-label="Dies of the sample with their defects" style="display:block" '
        'data-pick="defect-at" {place}>{shapes}</svg></div>'
    ).format(w=w, h=h, place=frame.place_attributes, shapes=shapes)
