"""The left panel's part for defects: how they are searched for, what was found, and the list with its thumbnails."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import viser

from wafer_viewer.draw.look import Look
from wafer_viewer.gui import defect_words as words
from wafer_viewer.gui import html
from wafer_viewer.gui.commands import Command, unless
from wafer_viewer.gui.defect_listing import SORTS
from wafer_viewer.gui.defect_rows import rows, rows_of, sorting
from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.kept_places import Box
from wafer_viewer.gui.kit import Cell, button, in_a_row, set_prop
from wafer_viewer.gui.obstacles import no_defects
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.review_item import ReviewItem
from wafer_viewer.gui.review_items import chosen_item, review_items
from wafer_viewer.gui.review_words import filters
from wafer_viewer.gui.surface_scene import source_of
from wafer_viewer.gui.thumbnails import Thumbnails, framed, thumbnail
from wafer_viewer.gui.view import View
from wafer_viewer.model.defects import DefectRecipe, Evidence, threshold_of
from wafer_viewer.session.defect_work import Against
from wafer_viewer.session.paint_request import PaintRequest
from wafer_viewer.session.state import Snapshot

AGAINST: dict[str, Against] = {"Die with die": "dies", "With the fitted form": "form"}
EVIDENCE: dict[str, Evidence] = {"Height and picture": "both", "Height": "height", "Picture": "picture"}
DIAL = "0 finds only what is plain, 1 all that might be something"
LAYERS = (Look(), Look(colour_by="grey"))
"""Of the thumbnails: heights, and the all-in-focus picture."""
LEAST_PX = 48
"""A thumbnail shows at least so many pixels of the surface."""


class DefectSection:
    """In sight in the step Review; the form is unfolded where nothing was inspected yet."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._unfolded = False
        self._recipe: DefectRecipe | None = None
        self._thumbnails = Thumbnails(page)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()
        page.on_pick("defect-form", lambda _: self.unfold())
        page.on_pick("defect-sort", lambda sort: self._list_by(sort=sort))
        page.on_pick("defect-kind", self._only_kind)
        page.on_pick("defect-die", self._only_die)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        there = view.step == "review" and snapshot.surface is not None
        set_prop(self._folder, "visible", there)
        if not there:
            return
        state = snapshot.inspection
        self._take_up(state.inspection.recipe if state.inspection is not None else None)
        unfolded = self._unfolded or state.inspection is None
        self._head.show(self._top(snapshot) + words.summary(state))
        set_prop(self._form, "visible", unfolded and not state.work)
        why = _why_not(snapshot)
        set_prop(self._begin, "disabled", bool(why))
        self._expected.show(
            self._expectation(snapshot) + (f'<div class="wv-lab">{html.safe(why)}</div>' if why else "")
        )
        self._list.show(self._listed(snapshot, view))

    def commands(self) -> list[Command]:
        """Searching and sorting, from the palette."""
        icon = viser.Icon
        return unless(
            no_defects,
            Command("Search for defects…", None, self.unfold, icon.SEARCH, group="Review"),
            *(
                Command(
                    f"Defects by {name.lower()}", None, lambda s=sort: self._list_by(sort=s), icon.SORT_DESCENDING,
                    group="Review",
                )
                for sort, (name, _) in SORTS.items()
            ),
        )  # fmt: skip

    def unfold(self) -> None:
        """Show the form, or fold it away again."""
        self._unfolded = not self._unfolded
        self._page.change(step="review")
        self._page.redraw()

    # --- building

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        self._head = Cell(gui)
        self._form = gui.add_folder(None, visible=False)
        with self._form:
            self._dial = gui.add_slider("Sensitivity", 0.0, 1.0, 0.05, DefectRecipe().sensitivity, hint=DIAL)
            self._dial.on_update(guarded(page, "The dial stays")(lambda _: page.redraw()))
            self._against = gui.add_dropdown("Compare", tuple(AGAINST), hint="A surface of one die has no others")
            self._evidence = gui.add_dropdown("Look at", tuple(EVIDENCE), hint="Where a defect may show")
            self._product = gui.add_text("Product", "", hint="A golden die of another product is refused")
            self._golden = gui.add_text(
                "Golden die", "", hint="Its name; empty: the dies of this wafer among themselves"
            )
            self._expected = Cell(gui)
            begin = guarded(page, "Nothing was inspected")(lambda _: self._inspect())
            self._begin = button(gui, "Inspect", viser.Icon.SEARCH, begin)
            in_a_row(gui, [self._begin], 34)
        self._list = Cell(gui)

    def _take_up(self, recipe: DefectRecipe | None) -> None:
        """Let the form stand as the inspection was made, once."""
        if recipe is None or recipe == self._recipe:
            return
        self._recipe = recipe
        self._dial.value = recipe.sensitivity
        self._evidence.value = next(name for name, evidence in EVIDENCE.items() if evidence == recipe.evidence)
        self._product.value, self._golden.value = recipe.product, recipe.golden

    # --- what a person does

    def _inspect(self) -> None:
        page = self._page
        recipe = DefectRecipe(
            sensitivity=float(self._dial.value),
            evidence=EVIDENCE[self._evidence.value],
            product=self._product.value.strip(),
            golden=self._golden.value.strip(),
        )
        self._unfolded = False
        page.ask("Nothing was inspected", page.session.defects.inspect(recipe, None, AGAINST[self._against.value]))
        page.redraw()

    def _list_by(self, **changes: Any) -> None:
        self._page.change(defects=replace(self._page.view.defects, **changes))

    def _only_kind(self, kind: str) -> None:
        self._list_by(kind="" if self._page.view.defects.kind == kind else kind)

    def _only_die(self, die: str) -> None:
        self._list_by(die="" if self._page.view.defects.die == die else die)

    # --- showing

    def _top(self, snapshot: Snapshot) -> str:
        state = snapshot.inspection
        if state.work:
            return html.head("Defects", "being searched for")
        if state.inspection is None:
            first = html.empty("Nothing was inspected yet:", "set the dial and press Inspect.")
            return html.head("Defects") + ("" if state.problem else first)
        fold = "Less" if self._unfolded else "Inspect again…"
        link = f'<span class="wv-link" {html.pick("defect-form")}>{fold}</span>'
        return f'<div class="wv-h">Defects<span>{link}</span></div>'

    def _expectation(self, snapshot: Snapshot) -> str:
        dial, inspection = float(self._dial.value), snapshot.inspection.inspection
        expected = inspection.expected_false_at(dial) if inspection is not None else None
        said = f"From {threshold_of(dial):.1f} times the noise; expected to be false: {words.per_mm2(expected)}"
        return f'<div class="wv-lab">{html.safe(said)}</div>'

    def _listed(self, snapshot: Snapshot, view: View) -> str:
        inspection = snapshot.inspection.inspection
        if inspection is None:
            return ""
        if not inspection.defects:
            return words.nothing_found(inspection) + words.facts(inspection)
        items = [i for i in review_items(snapshot, view.review_filter, view.defects) if i.defect is not None]
        now = chosen_item(snapshot, view.review, view.defects)
        judged = sum(defect.judgement != "open" for defect in inspection.defects)
        head = html.head("Found", f"{judged} of {len(inspection.defects)} judged")
        choices = words.counts(inspection.defects, view.defects.kind) + filters(view) + sorting(view.defects)
        shown = rows_of(items, now)
        there = rows(items, shown, now, [self._thumbs(item, snapshot) for item in shown])
        return head + choices + there + words.facts(inspection)

    def _thumbs(self, item: ReviewItem, snapshot: Snapshot) -> str:
        """Heights and picture of a defect."""
        source = source_of(snapshot, item.show)
        if source is None or item.box_um is None:
            return ""
        box = framed(_at_least(item.box_um, LEAST_PX * (snapshot.surface.pixel_um if snapshot.surface else 1.0)))
        requests = (PaintRequest(source, "picture", box_um=box, look=look) for look in LAYERS)
        return "".join(thumbnail(self._thumbnails.painted(request)) for request in requests)


def _why_not(snapshot: Snapshot) -> str:
    """Why nothing can be inspected now; empty where it can."""
    data = snapshot.dataset
    if data is None or snapshot.inspection.work:
        return ""
    if data.read_only is not None:
        return f"Not possible: {data.read_only}"
    return "Not yet: the surface still grows." if snapshot.scanning else ""


def _at_least(box: Box, side_um: float) -> Box:
    """A box round the same middle, no smaller than so."""
    x0, y0, x1, y1 = box
    half_x, half_y = max(x1 - x0, side_um) / 2, max(y1 - y0, side_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half_x, y - half_y, x + half_x, y + half_y
