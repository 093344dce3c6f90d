"""Sheet over the scene with all dies overlaid, to find defects that repeat from die to die."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import viser
from markupsafe import Markup, escape

from wafer_viewer.draw.charts.defect_charts import die_stack_svg, not_drawn, shown
from wafer_viewer.draw.charts.symbols import symbol_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.overlays.hud import OverScene, SheetRoom
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import nothing_inspected
from wafer_viewer.gui.presenters.defects import key_of, number_of
from wafer_viewer.gui.state.view_state import View, listed
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callback_timing import LatestOnlyWorker
from wafer_viewer.gui.widgets.command import Command, with_precondition
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.inspection.defect import LEAST_DIES, Defect, Inspection, RepeatedPlace
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.session.rendering.render_request import DiePicture
from wafer_viewer.session.state.snapshot import Snapshot

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
    away = Markup('<span class="wv-link" {}>Close · Esc</span>').format(html.pick("sheet", "none"))
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
    name = Markup("{symbol_svg} {title}<small>x {number}, y {number2}\u202fµm</small>").format(
        symbol_svg=symbol_svg(look.shape, look.colour),
        title=look.title,
        number=number(position.x_um, 1),
        number2=number(position.y_um, 1),
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


class DefectStack:
    """Sheet whose places and picture are computed on a worker thread and cached while they are valid."""

    def __init__(self, page: Page, look_at: Callable[[str], None]) -> None:
        self._page, self._look_at = page, look_at
        self._panel = OverScene(page)
        self._worker = LatestOnlyWorker("dies overlaid")
        self._requested: tuple[Any, ...] | None = None
        self._defects: tuple[Defect, ...] = ()
        self._places: tuple[RepeatedPlace, ...] | None = None
        self._picture: DiePicture | None = None
        page.on_close(self._worker.close)
        page.on_pick("defect-place", lambda key: self._toggle_place_filter(int(key)))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the sheet up to date."""
        inspection = snapshot.inspection.inspection
        if view.sheet_over != "stack" or inspection is None or snapshot.surface is None or snapshot.dataset is None:
            self._panel.show("")
            return
        self._ask((snapshot.dataset.path, snapshot.surface.stamp, inspection.mark, inspection.recipe), inspection)
        width, height = drawing_px(inspection, self._panel.room)
        if self._places is None:
            waits = Markup('{}<div style="height:{}px">{}</div>').format(
                head(inspection), WAITING_PX, html.empty("Comparing dies …")
            )
            self._panel.show(waits, HEAD_PX + WAITING_PX + 2 * PAD_PX)
            return
        place = place_of(view.defects.numbers, self._places)
        content = die_stack_html(
            inspection, self._places, self._picture, (width, height), number_of(view.review), place
        )
        self._panel.show(content, height + HEAD_PX + FOOT_PX + 2 * PAD_PX)

    def commands(self) -> list[Command]:
        """Return the command that opens the sheet and then steps from place to place."""
        name, icon = "All dies overlaid, next place", viser.Icon.STACK_2
        return with_precondition(nothing_inspected, Command(name, "backspace", self.go_on, icon, group="Review"))

    def go_on(self) -> None:
        """Open the sheet; if it is open, filter by the next repeating place, and after the last one show all."""
        view, places = self._page.view, self._places or ()
        if view.sheet_over != "stack":
            self._page.change(sheet="stack")
        elif places:
            now = place_of(view.defects.numbers, places)
            self._toggle_place_filter(0 if now is None else now + 1)

    def _toggle_place_filter(self, k: int) -> None:
        """Filter by the defects of one place and show the first; choosing the same place again removes the filter."""
        page, places = self._page, self._places or ()
        new = places[k].numbers if k < len(places) else ()
        if new == page.view.defects.numbers:
            new = ()
        listing = replace(page.view.defects, numbers=new, kind="", die="")
        page.change(defects=listing)
        shown = listed(page.session.snapshot.inspection.defects, listing) if new else ()
        if shown:
            self._look_at(key_of(shown[0]))

    def _ask(self, request: tuple[Any, ...], inspection: Inspection) -> None:
        """Request the picture once per surface and reference, and the places whenever a defect changed."""
        if request != self._requested:
            self._requested, self._picture, self._places, self._defects = request, None, None, ()
        if inspection.defects is not self._defects or self._places is None:
            self._defects = inspection.defects
            look = guarded(self._page, "The dies were not overlaid")(self._look)
            self._worker.ask(lambda: look(request))

    def _look(self, request: tuple[Any, ...]) -> None:
        """Compute places and picture on the worker's thread; drop the result if the surface has changed by then."""
        views = self._page.session.defects.views
        places = views.repeats()
        if request == self._requested:
            self._places = places
            self._page.redraw()
        if request == self._requested and self._picture is None:
            picture = views.die().result()
            if request == self._requested:
                self._picture = picture or DiePicture(why_not="No die was scanned completely.")
                self._page.redraw()
