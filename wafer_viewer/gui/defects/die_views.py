"""Views of all dies: the map in the left panel, and the sheet with all dies overlaid.

Two drawings are stacked, because they change at different rates: the dies and symbols change with the list, the marks
of the defect under review and of the camera's view change all the time.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import viser
from markupsafe import Markup, escape

from wafer_viewer.draw.charts.axes import symbol_svg
from wafer_viewer.draw.charts.defect_charts import die_stack_svg, not_drawn, shown
from wafer_viewer.draw.charts.die_map import die_frame
from wafer_viewer.draw.charts.wafer_map import MOST_HEIGHT_PX, WIDTH_PX, MapMark, MapViewport, Outline, map_marks_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.overlays.hud import OverScene, SheetRoom
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import nothing_inspected, require_step
from wafer_viewer.gui.presenters.defects import (
    BY,
    chosen_defect,
    key_of,
    map_head,
    map_html,
    number_of,
    on_show,
    other_signs,
)
from wafer_viewer.gui.state.view_state import View, listed, next_die, next_kind
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import Command, HtmlBlock, set_prop, with_precondition
from wafer_viewer.model.inspection.defect import LEAST_DIES, Defect, Inspection, RepeatedPlace
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.session.rendering.render_request import DiePicture
from wafer_viewer.session.state.snapshot import Snapshot

# -------------------------------------------------------------------------------------------------------------- die map


TO_DIES = (("Next die with open defects", "pagedown", 1), ("Previous die with open defects", "pageup", -1))


def has_die_map(snapshot: Snapshot, view: View) -> bool:
    """Return whether the map of the dies is shown in place of the field map."""
    inspection = snapshot.inspection.inspection
    return view.step == "review" and inspection is not None and bool(inspection.grid and inspection.dies)


class DefectMap:
    """Map shown in Review in place of the field map, if the inspection has dies.

    Clicks and keys on it filter the list by die or by class.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._head, self._over, self._map = (HtmlBlock(page.gui) for _ in range(3))
        self._camera_view: Callable[[], Outline | None] = lambda: None
        self._go_to: Callable[[str], Any] = lambda _: None
        self._drawn: tuple[object, ...] | None = None
        self._frame: MapViewport | None = None
        page.on_pick("defect-map-by", lambda by: self._list_by(map_by=by))
        page.on_pick("defect-kind", lambda kind: self._list_by(kind="" if page.view.defects.kind == kind else kind))
        page.on_pick("defect-all", lambda _: page.change(defects=page.view.defects.widened))
        page.on_pick("defect-at", lambda at: self._choose_at(*(float(um) for um in at.split(","))))

    def on_camera_view(self, view_um: Callable[[], Outline | None]) -> None:
        """Set the function that returns the ground area in the camera's view."""
        self._camera_view = view_um

    def on_chosen(self, go_to: Callable[[str], Any]) -> None:
        """Set the callback that shows the first defect of a new filter, given its key."""
        self._go_to = go_to

    def show(self, snapshot: Snapshot, view: View) -> bool:
        """Bring the map up to date; return whether it is visible."""
        inspection, visible = snapshot.inspection.inspection, has_die_map(snapshot, view)
        set_prop(self._folder, "visible", visible)
        if inspection is None or not visible:
            return False
        listing = replace(view.defects, sort="size")
        sources = inspection, snapshot.dataset_overview, listing, view.review_filter, snapshot.defect_files.other
        if self._drawn is None or any(a is not b and a != b for a, b in zip(sources, self._drawn, strict=True)):
            self._drawn = sources
            self._draw(snapshot, view, inspection)
        self._overlay(snapshot, view)
        return True

    def commands(self) -> list[Command]:
        """Return the commands that step through dies and classes."""
        icon = viser.Icon
        return with_precondition(
            require_step("review"),
            *(
                Command(name, key, lambda b=by: self._step_die(b), icon.GRID_DOTS, "alt", "Review")
                for name, key, by in TO_DIES
            ),
            Command("Show only the next class", "0", self._step_kind, icon.FILTER, group="Review"),
            *(
                Command(f"Dies by {name}", None, lambda b=by: self._list_by(map_by=b), icon.MAP, group="Review")
                for by, name in BY.items()
            ),
        )  # fmt: skip

    # --- what a person does

    def _choose_at(self, x_um: float, y_um: float) -> None:
        """Filter the list by the die at a place; remove the filter if that die is filtered already."""
        inspection = self._page.session.snapshot.inspection.inspection
        die = die_at(inspection, x_um, y_um) if inspection is not None else ""
        if die:
            self._list_by(die="" if die == self._page.view.defects.die else die)

    def _step_die(self, by: int) -> None:
        page = self._page
        die = next_die(page.session.snapshot.inspection.defects, page.view.defects, by)
        if die is None:
            page.say("No die to go to", "No defect that is listed and lies on a die is open.", "attention")
        else:
            self._list_by(die=die)

    def _step_kind(self) -> None:
        view = self._page.view
        self._list_by(kind=next_kind(self._page.session.snapshot.inspection.defects, view.defects))

    def _list_by(self, **changes: Any) -> None:
        """Change the filter; the review moves to the first open defect only if its defect is filtered out."""
        page = self._page
        page.change(defects=replace(page.view.defects, **changes))
        now = listed(page.session.snapshot.inspection.defects, page.view.defects)
        here = chosen_defect(page.session.snapshot, page.view.review)
        if here not in now and (ahead := next((d for d in now if d.judgement == "open"), next(iter(now), None))):
            self._go_to(key_of(ahead))

    # --- showing

    def _draw(self, snapshot: Snapshot, view: View, inspection: Inspection) -> None:
        overview = snapshot.dataset_overview
        outline = overview.outline_um if overview else ()
        self._head.show(map_head(view.defects))
        self._frame = die_frame(inspection, outline, width_px=WIDTH_PX, most_height_px=MOST_HEIGHT_PX)
        if self._frame is not None:
            other = snapshot.defect_files.other
            over = other_signs(self._frame, other) if other is not None else ""
            self._map.show(map_html(self._frame, inspection, _on_map(snapshot, view), view.defects, outline, over))

    def _overlay(self, snapshot: Snapshot, view: View) -> None:
        if self._frame is None:
            return
        here = chosen_defect(snapshot, view.review)
        drawing = map_marks_svg(self._frame, self._camera_view() or (), [_mark(here)] if here is not None else ())
        self._over.show(drawing and Markup('<div class="wv-over-map wv-dies">{}</div>').format(drawing))


def die_at(inspection: Inspection, x_um: float, y_um: float) -> str:
    """Return the name of the die at a place; empty outside of all inspected dies."""
    if inspection.grid is None:
        return ""
    col, row, u, v = (float(one[0]) for one in inspection.grid.to_die(np.array([x_um]), np.array([y_um])))
    name = inspection.grid.name(int(col), int(row))
    on_it = 0 <= u <= inspection.grid.width_um and 0 <= v <= inspection.grid.height_um
    return name if on_it and any(die.name == name for die in inspection.dies) else ""


def _on_map(snapshot: Snapshot, view: View) -> tuple[Defect, ...]:
    """Return the defects that pass the filters other than the die."""
    return on_show(snapshot.inspection.defects, replace(view.defects, die=""), view.review_filter)


def _mark(defect: Defect) -> MapMark:
    look = DEFECT_CLASSES[defect.seen_as]
    name = f"D{defect.number} · {look.title}"
    return MapMark(defect.center.x_um, defect.center.y_um, look.colour, name, chosen=True, shape=look.shape)


# ------------------------------------------------------------------------------------------------------- die stack view


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
