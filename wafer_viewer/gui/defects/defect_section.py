"""Defect section of the left panel: inspection form, summary, and the list with thumbnails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.defects.defect_dialogs import (
    ERRANDS,
    STAYS,
    ExcludedDialog,
    OtherSection,
    area_of_defect,
    recipes_dialog,
)
from wafer_viewer.gui.defects.inspection_form import PICKS, InspectionDraft, inspection_form, save
from wafer_viewer.gui.elements.step import StepPanel
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import no_defects
from wafer_viewer.gui.presenters import defects as words
from wafer_viewer.gui.presenters.defects import chart_of, chosen_defect, rows, rows_of, sorting
from wafer_viewer.gui.presenters.inspection_form import verdict
from wafer_viewer.gui.presenters.results import Box, ReviewItem
from wafer_viewer.gui.presenters.review import chosen_item, filters, review_items
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.scenes.thumbnails import Thumbnails, framed, thumbnail
from wafer_viewer.gui.state.view_state import SORTS, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import Command, HtmlBlock, set_prop, with_precondition
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.state.snapshot import Snapshot

LAYERS = (DisplayStyle(), DisplayStyle(colour_by="grey"))
"""Display styles of the thumbnails: heights and all-in-focus picture."""
LEAST_PX = 48
"""Minimum size of a thumbnail, in pixels of the surface."""


class DefectSection:
    """Section shown in the step Review; the form is unfolded until the surface has been inspected."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._fly: Callable[[Box], object] = lambda box: None
        self._thumbnails = Thumbnails(page)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._head = HtmlBlock(page.gui)
            self._form = StepPanel(page, inspection_form, InspectionDraft(), "The form was not changed", PICKS)
            self._errands = HtmlBlock(page.gui)
            self._other = OtherSection(page, lambda box: self._fly(box))
            self._list = HtmlBlock(page.gui)
        page.on_pick("defect-form", lambda _: self.unfold())
        page.on_pick("defect-errand", self._run)
        page.on_pick("defect-excluded", lambda key: self._edit_excluded_areas(here=key == "here"))
        page.on_pick("defect-sort", lambda sort: self._list_by(sort=sort))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        visible = view.step == "review" and snapshot.surface is not None
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        state = snapshot.inspection
        if state.work:
            self._form.here.own = replace(self._form.here.own, unfolded=False)
        inspection = state.inspection
        self._head.show(
            self._top(snapshot) + words.summary(state) + (verdict(inspection) if inspection is not None else "")
        )
        self._form.show(snapshot, view)
        self._errands.show(_command_links_html() if inspection is not None else "")
        self._other.show(snapshot)
        self._list.show(self._listed(snapshot, view))

    def on_chosen(self, fly: Callable[[Box], object]) -> None:
        """Set the callback that gets the box to show when a defect of another tool is chosen."""
        self._fly = fly

    def commands(self) -> list[Command]:
        """Return the palette commands that inspect, sort and export defects."""
        icon, leave_out_here = viser.Icon, partial(self._edit_excluded_areas, here=True)
        keep_recipe = partial(save, self._form.here)
        return with_precondition(
            no_defects,
            Command("Search for defects…", None, self.unfold, icon.SEARCH, group="Review"),
            Command("Save the recipe for defects…", None, keep_recipe, icon.DEVICE_FLOPPY, group="Review"),
            Command("Excluded areas…", None, self._edit_excluded_areas, icon.CROP, group="Review"),
            Command("Exclude this place…", None, leave_out_here, icon.CROP, group="Review"),
            Command("Recipes for defects…", None, lambda: recipes_dialog(self._page), icon.LIST, group="Review"),
            *(
                Command(errand.name, None, lambda k=key: self._run(k), errand.icon, group="Review")
                for key, errand in ERRANDS.items()
            ),
            *(
                Command(
                    f"Defects by {name.lower()}", None, lambda s=sort: self._list_by(sort=s), icon.SORT_DESCENDING,
                    group="Review",
                )
                for sort, (name, _) in SORTS.items()
            ),
        )  # fmt: skip

    def unfold(self) -> None:
        """Unfold or fold the form."""
        self._page.change(step="review")
        self._form.here.keep(unfolded=not self._form.here.own.unfolded)

    # --- what a person does

    def _run(self, errand: str) -> None:
        """Open the dialog of one of the commands on all defects."""
        dialog = ERRANDS[errand]
        guarded(self._page, dialog.failed)(dialog.ask)(self._page)

    def _edit_excluded_areas(self, *, here: bool = False) -> None:
        """Open the dialog of areas to exclude on every die.

        The form then shows the areas, next to the button that inspects again.
        here: propose the area of the defect under review as well.
        """
        page = self._page
        proposed = area_of_defect(chosen_defect(page.session.snapshot, page.view.review)) if here else ()

        def keep(areas: tuple[Region, ...]) -> None:
            self._form.here.put("form.excluded", areas)
            self._form.here.keep(unfolded=True)

        guarded(page, STAYS)(ExcludedDialog)(page, self._form.here.own.form.excluded, keep, proposed)

    def _list_by(self, **changes: Any) -> None:
        self._page.change(defects=replace(self._page.view.defects, **changes))

    # --- showing

    def _top(self, snapshot: Snapshot) -> Markup:
        state = snapshot.inspection
        if state.work:
            return html.head("Defects", "being searched for")
        if state.inspection is None:
            first = html.empty("Nothing was inspected yet:", "set the sensitivity and press Inspect.")
            return html.head("Defects") + ("" if state.problem else first)
        fold = "Less" if self._form.here.own.unfolded else "Inspect again…"
        link = Markup('<span class="wv-link" {}>{}</span>').format(html.pick("defect-form"), fold)
        judged = words.judged(state.inspection)
        return Markup('<div class="wv-h">Defects<span class="wv-mid">{}</span><span>{}</span></div>').format(
            judged, link
        )

    def _listed(self, snapshot: Snapshot, view: View) -> Markup:
        inspection = snapshot.inspection.inspection
        if inspection is None:
            return Markup()
        if not inspection.defects:
            return words.nothing_found(inspection) + words.facts(inspection)
        items = [i for i in review_items(snapshot, view.review_filter, view.defects) if i.defect is not None]
        now = chosen_item(snapshot, view.review, view.defects)
        chart = chart_of(snapshot.inspection, view.defects, view.review_filter)
        shown = rows_of(items, now)
        table = rows(items, shown, now, [self._thumbs(item, snapshot) for item in shown])
        choices = filters(view) + sorting(view.defects, inspection)
        return chart + choices + table + words.facts(inspection)

    def _thumbs(self, item: ReviewItem, snapshot: Snapshot) -> Markup:
        """Return the thumbnails of a defect, heights and picture, as HTML."""
        source = source_of(snapshot, item.show)
        if source is None or item.box_um is None:
            return Markup()
        box = framed(_at_least(item.box_um, LEAST_PX * (snapshot.surface.pixel_um if snapshot.surface else 1.0)))
        requests = (RenderRequest(source, "picture", box_um=box, look=look) for look in LAYERS)
        return Markup("").join(thumbnail(self._thumbnails.painted(request)) for request in requests)


def _command_links_html() -> Markup:
    """Return the links of the commands on all defects as HTML."""
    links = (
        Markup('<span class="wv-link" {}>{}</span>').format(html.pick("defect-errand", key), e.short)
        for key, e in ERRANDS.items()
    )
    areas = Markup('<span class="wv-link" {}>Exclude…</span>').format(html.pick("defect-excluded", "here"))
    return Markup('<div class="wv-legend" style="margin:2px 0 6px">{}{}</div>').format(Markup("").join(links), areas)


def _at_least(box: Box, side_um: float) -> Box:
    """Return a box with the same centre whose sides are at least `side_um`."""
    x0, y0, x1, y1 = box
    half_x, half_y = max(x1 - x0, side_um) / 2, max(y1 - y0, side_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half_x, y - half_y, x + half_x, y + half_y
