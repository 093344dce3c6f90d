"""All dies stacked onto one, over the scene: places that repeat are ringed, listed and filtered by."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import viser
from markupsafe import Markup, escape

from wafer_viewer.draw.charts.axes import symbol_svg
from wafer_viewer.draw.charts.defect_charts import die_stack_svg, not_drawn, shown
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.overlays.hud import SheetRoom
from wafer_viewer.gui.page.preconditions import nothing_inspected
from wafer_viewer.gui.presenters.review import key_of, number_of
from wafer_viewer.gui.state.view_state import listed
from wafer_viewer.gui.steps.review.judging import Review
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model.inspection.defect import LEAST_DIES, Inspection, RepeatedPlace
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.spec import replace
from wafer_viewer.session.rendering.render_request import DiePicture

HEAD_PX, FOOT_PX, PAD_PX, LIST_PX = 30, 26, 12, 250
MOST_ROWS = 60
NO_DIES = "The surface was compared with its form: there are no dies to overlay."


def drawing_px(inspection: Inspection, room: SheetRoom) -> tuple[int, int]:
    """Return the width and height that the drawing can take next to the list, in pixels."""
    grid = inspection.grid
    aspect = grid.width_um / grid.height_um if grid is not None else 1.0
    width, height = room.width_px - LIST_PX - 3 * PAD_PX, room.height_px - HEAD_PX - FOOT_PX - 2 * PAD_PX
    return int(min(width, height * aspect)), int(min(height, width / aspect))


def die_stack_html(
    inspection: Inspection,
    places: Sequence[RepeatedPlace],
    picture: DiePicture | None,
    size_px: tuple[int, int],
    chosen: int | None,
    place: int | None,
) -> Markup:
    """Return the sheet as HTML."""
    if inspection.grid is None:
        return head(inspection) + html.empty(NO_DIES)
    url = f"data:image/jpeg;base64,{base64.b64encode(picture.picture).decode()}" if picture and picture.picture else ""
    drawn = die_stack_svg(
        inspection,
        places,
        url,
        width_px=size_px[0],
        most_height_px=size_px[1],
        chosen=chosen,
        place=place,
        attributes=html.pick,
    )
    side = Markup('<div class="wv-stack-list" style="max-height:{}px">{}</div>').format(
        size_px[1], _list(inspection, places, place)
    )
    foot = Markup('<div class="wv-lab" style="height:{}px;padding-top:6px">{}</div>').format(
        FOOT_PX, _foot(inspection, places, picture)
    )
    return Markup('{head}<div class="wv-stacked"><div>{drawn}</div>{side}</div>{foot}').format(
        head=head(inspection), drawn=drawn, side=side, foot=foot
    )


def head(inspection: Inspection) -> Markup:
    """Return the header with title and close link as HTML."""
    n_complete = sum(die.state == "whole" for die in inspection.dies)
    name = f"All {n_complete} whole dies overlaid" if n_complete else "All dies overlaid"
    away = html.link("Close · Esc", "sheet", "beside")
    return Markup('<div class="wv-over-head" style="height:{}px"><b>{}</b><span>{}</span></div>').format(
        HEAD_PX, name, away
    )


def place_of(numbers: tuple[int, ...], places: Sequence[RepeatedPlace]) -> int | None:
    """Return the index of the place that shares most defects with a filter; None if no place shares any.

    The numbers need not match exactly, because a defect that was rejected since is no longer part of its place.
    """
    common = [len(set(place.numbers) & set(numbers)) for place in places]
    return common.index(max(common)) if any(common) else None


def _list(inspection: Inspection, places: Sequence[RepeatedPlace], chosen: int | None) -> Markup:
    if not places:
        dies = "No two dies" if len({d.die for d in inspection.found if d.die}) < 2 else f"No {LEAST_DIES} dies"
        return html.empty("Nothing repeats.", f"{dies} have a defect at the same place.")
    rows = [_row(k, place, k == chosen) for k, place in enumerate(places[:MOST_ROWS])]
    more = (
        Markup('<div class="wv-lab">{} more</div>').format(len(places) - MOST_ROWS)
        if len(places) > MOST_ROWS
        else Markup()
    )
    return html.head("Places that repeat", f"{len(places)}", first=True) + html.table([], rows, "  n") + more


def _row(k: int, place: RepeatedPlace, chosen: bool) -> Markup:
    look, position = DEFECT_CLASSES[place.kind], place.in_die
    name = Markup("{symbol_svg} {title}<small>x {number}, y {number2}\u202fµm{chance}</small>").format(
        symbol_svg=symbol_svg(look.shape, look.colour),
        title=look.title,
        number=number(position.x_um, 1),
        number2=number(position.y_um, 1),
        chance=f" · {place.chance_words}" if place.chance_words else "",
    )
    dies = Markup("<b>{}</b><small>of {} dies</small>").format(len(place.dies), place.of_dies)
    title = f"Place {k + 1}, {look.title}, {place.words}"
    attributes = Markup('{} aria-label="{}"').format(html.pick("defect-place", k), title)
    return html.row([f"{k + 1}", name, dies], "  n", attributes, "sel" if chosen else "")


def _foot(inspection: Inspection, places: Sequence[RepeatedPlace], picture: DiePicture | None) -> Markup:
    if picture is None:
        ground = "The picture of the die is made …"
    elif picture.why_not:
        ground = picture.why_not
    else:
        ground = f"Picture: {picture.golden or f'median of {picture.dies} dies'}"
    n_hidden = not_drawn(inspection, shown(inspection, places))
    parts = [
        ground,
        f"{n_hidden} weaker ones are not drawn" if n_hidden else "",
        "Backspace: next place" if places else "",
    ]
    return escape(" · ".join(part for part in parts if part))


WAITING_PX = 120
PLACES, PICTURE, FAILED = "places that repeat", "dies overlaid", "The dies were not overlaid"


def stack_sheet(here: Here[Any], room: SheetRoom) -> tuple[Markup, int] | None:
    """Return the picture of a typical die with the defects of all, and the list of places that repeat."""
    snapshot, views = here.snapshot, here.page.session.defects.views
    inspection = snapshot.inspection.inspection
    if inspection is None or snapshot.surface is None or snapshot.dataset is None:
        return None
    about = (snapshot.dataset.path, snapshot.surface.stamp, inspection.mark, inspection.recipe)
    places = here.ask(PLACES, snapshot.inspection, views.repeats, FAILED, about).value
    none = DiePicture(why_not="No die was scanned completely.")
    picture = here.ask(PICTURE, about, lambda: views.die().result() or none, FAILED, about).value
    if places is None:
        waits = Markup('{}<div style="height:{}px">{}</div>').format(
            head(inspection), WAITING_PX, html.empty("Comparing dies …")
        )
        return waits, HEAD_PX + WAITING_PX + 2 * PAD_PX
    size_px, place = drawing_px(inspection, room), place_of(here.view.defects.numbers, places)
    chosen = number_of(here.view.review)
    content = die_stack_html(inspection, places, picture, size_px, chosen, place)
    return content, size_px[1] + HEAD_PX + FOOT_PX + 2 * PAD_PX


def stack_commands(here: Here[Any], review: Review) -> list[Command]:
    """Return the command that opens the sheet and then steps from place to place."""
    name, icon = "All dies overlaid, next place", viser.Icon.STACK_2
    return with_precondition(
        nothing_inspected, Command(name, "backspace", lambda: _go_on(here, review), icon, group="Review")
    )


def _go_on(here: Here[Any], review: Review) -> None:
    """Open the sheet; if it is open, filter by the next repeating place, and after the last one show all."""
    view, places = here.page.view, here.ask.known(PLACES).value or ()
    if view.sheet_over != "stack":
        here.page.change(sheet="stack")
    elif places:
        now = place_of(view.defects.numbers, places)
        filter_by_place(here, review, 0 if now is None else now + 1)


def filter_by_place(here: Here[Any], review: Review, k: int) -> None:
    """Filter by the defects of one place and show the first; choosing the same place again removes the filter."""
    page, places = here.page, here.ask.known(PLACES).value or ()
    new = places[k].numbers if k < len(places) else ()
    if new == page.view.defects.numbers:
        new = ()
    listing = replace(page.view.defects, numbers=new, kind="", die="")
    page.change(defects=listing)
    if new and (first := next(iter(listed(page.session.snapshot.inspection.defects, listing)), None)) is not None:
        review.go_to(key_of(first))
