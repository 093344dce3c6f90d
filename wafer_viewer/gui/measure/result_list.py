"""Result list of the left panel: select and fly to, rename, delete, undo and redo, CSV."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import rename_dialog
from wafer_viewer.gui.page.import_export_dialogs import save_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.measurement import REGION_COLOUR, list_text, sign_colour, surface_name, symbol
from wafer_viewer.gui.presenters.results import Box, bounds_of
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, command_button, in_a_row, set_prop
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.session.state.snapshot import Snapshot

ROUND_PLACES = 2.4
"""Size of the area shown around a result, relative to its regions."""
LEAST_SHOWN_PX = 120
"""Minimum size of the area shown, in pixels of the surface; closer views add no detail."""


class ResultList:
    """List of saved results with thumbnail, value and uncertainty."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._thumbnails = Thumbnails(page)
        self._fly: Callable[[Box], object] = lambda box: None
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._list = HtmlBlock(gui)
            self._csv = button(gui, "CSV…", viser.Icon.TABLE_EXPORT, self._on("Export failed", self._export))
            self._rename = command_button(
                gui, "Rename", viser.Icon.PENCIL, self._on("The name was not changed", self._ask_name)
            )
            self._delete = command_button(
                gui, "Delete", viser.Icon.TRASH, self._on("The result was not changed", self._delete_it)
            )
            in_a_row(gui, [self._csv, self._rename, self._delete], 30)
            self._undo = command_button(
                gui, "Undo", viser.Icon.ARROW_BACK_UP, self._on("Nothing was undone", self.undo)
            )
            self._redo = command_button(
                gui, "Redo", viser.Icon.ARROW_FORWARD_UP, self._on("Nothing was redone", self.redo)
            )
            in_a_row(gui, [self._undo, self._redo], 30)
        page.on_pick("finding", lambda key: self.choose(int(key)))

    def on_chosen(self, fly: Callable[[Box], object]) -> None:
        """Set the callback that gets the box to show when a result is selected."""
        self._fly = fly

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the list up to date."""
        set_prop(self._folder, "visible", view.step == "measure")
        if view.step != "measure":
            return
        self._list.show(html.head("Results", str(len(snapshot.findings) or "")) + self._rows(snapshot, view))
        chosen = self._chosen(snapshot, view) is not None
        for act in (self._csv, self._rename, self._delete):
            set_prop(act, "visible", bool(snapshot.findings))
        for act in (self._undo, self._redo):
            set_prop(act, "visible", bool(snapshot.findings or snapshot.findings_undo or snapshot.findings_redo))
        set_prop(self._rename, "disabled", not chosen)
        set_prop(self._delete, "disabled", not chosen)
        set_prop(self._undo, "disabled", not snapshot.findings_undo)
        set_prop(self._redo, "disabled", not snapshot.findings_redo)

    def choose(self, number: int) -> None:
        """Show a result on its surface with its tool and regions; a second click deselects it."""
        page = self._page
        finding = next((f for f in page.session.snapshot.findings if f.number == number), None)
        if finding is None or page.view.selected == number:
            page.change(selected=None)
            return
        page.change(selected=number, **_as_measured(finding, page.view))
        info = page.session.snapshot.surface
        self._fly(_round(bounds_of(finding), LEAST_SHOWN_PX * info.pixel_um if info else 0.0))

    def undo(self) -> None:
        """Undo the last change to the list."""
        self._page.ask("Nothing was undone", self._page.session.undo_findings())

    def redo(self) -> None:
        """Redo the change that was undone last."""
        self._page.ask("Nothing was redone", self._page.session.redo_findings())

    def _on(self, name: str, act: Any) -> Any:
        return guarded(self._page, name)(lambda _: act())

    def _chosen(self, snapshot: Snapshot, view: View) -> AnyResult | None:
        return next((f for f in snapshot.findings if f.number == view.selected), None)

    def _ask_name(self) -> None:
        finding = self._chosen(self._page.session.snapshot, self._page.view)
        if finding is not None:
            rename_dialog(self._page, finding.number, finding.name)

    def _delete_it(self) -> None:
        page, number = self._page, self._page.view.selected
        if number is not None:
            page.ask("The result was not changed", page.session.delete(number), lambda _: page.change(selected=None))

    def _export(self) -> None:
        page, data = self._page, self._page.session.snapshot.dataset
        if data is not None:
            name = f"{data.path.stem}-results.csv"
            save_dialog(
                page, "Save the results", name, page.session.export_findings, "Results exported", "Export failed"
            )

    def _rows(self, snapshot: Snapshot, view: View) -> Markup:
        if not snapshot.findings:
            return html.empty("What you keep is listed here.") + Markup('<div style="height:8px"></div>')
        rows = [_row(f, view, self._thumbnails.of(f, snapshot)) for f in snapshot.findings]
        return html.table(["", "Result", "k = 2"], rows, "  n") + Markup('<div style="height:6px"></div>')


def _row(finding: AnyResult, view: View, thumbnail: str) -> Markup:
    colour = sign_colour(finding)
    sign = html.chip(symbol(finding), "" if colour == REGION_COLOUR else colour)
    name = Markup('<span class="wv-cut wv-short" title="{}">{}</span>').format(finding.name, finding.name)
    elsewhere = " · ".join(_source_differences(finding, view))
    detail = Markup('<small class="wv-cut wv-short" title="{}">{}</small>').format(elsewhere, elsewhere)
    return html.row(
        [
            thumbnail,
            Markup('<div class="wv-result">{}<div>{}{}</div></div>').format(sign, name, detail if elsewhere else ""),
            list_text(finding),
        ],
        "  n",
        html.pick("finding", finding.number),
        "sel" if finding.number == view.selected else "",
    )


def _source_differences(finding: AnyResult, view: View) -> list[str]:
    """Return the surface and levelling of a result, each only if it differs from the displayed one."""
    notes = [surface_name(finding)] if finding.show != view.show else []
    return notes + ([f"zero: {finding.levelling.by}"] if finding.levelling != view.levelling else [])


def _as_measured(finding: AnyResult, view: View) -> dict[str, Any]:
    """Return the view changes that show a result as it was measured."""
    tool = TOOL_OF_RESULT.get(type(finding))
    changes: dict[str, Any] = {"why": None}
    if tool is not None:
        changes["tool"] = tool.name
        changes |= {"lines": finding.inputs, "line": 0} if tool.name == "profile" else {"places": finding.inputs}
    if (finding.show, finding.levelling) != (view.show, view.levelling):
        changes |= {"show": finding.show, "levelling": finding.levelling, "range_um": None}
        changes |= {"frame_k": None, "slice_z_um": None}
    return changes


def _round(bounds: Box, least_um: float) -> Box:
    """Return the box to show for regions within bounds."""
    x0, y0, x1, y1 = bounds
    half = max(ROUND_PLACES * max(x1 - x0, y1 - y0), least_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half
