"""Die map of the left panel in Review: dies of the inspection coloured by class or by count.

Two drawings are stacked, because they change at different rates: the dies and symbols change with the list, the marks
of the defect under review and of the camera's view change all the time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.die_map import die_frame
from wafer_viewer.draw.charts.wafer_map import MOST_HEIGHT_PX, WIDTH_PX, MapMark, MapViewport, Outline, map_marks_svg
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters.defects import BY, chosen_defect, key_of, map_head, map_html, on_show, other_signs
from wafer_viewer.gui.state.view_state import View, listed, next_die, next_kind
from wafer_viewer.gui.widgets.command import Command, with_precondition
from wafer_viewer.gui.widgets.controls import HtmlBlock, set_prop
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.session.state.snapshot import Snapshot

TO_DIES = (("Next die with open defects", "pagedown", 1), ("Previous die with open defects", "pageup", -1))


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
        inspection = snapshot.inspection.inspection
        visible = view.step == "review" and inspection is not None and bool(inspection.grid and inspection.dies)
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
