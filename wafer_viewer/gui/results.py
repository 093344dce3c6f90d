"""The list of results in the left panel: choose, rename, delete, undo, CSV."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui import html
from wafer_viewer.gui.dialogs import rename_dialog
from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.kit import Cell, button, in_a_row, set_prop
from wafer_viewer.gui.measure_words import length_text, letter, sign_colour
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.view import View
from wafer_viewer.model.findings import AnyFinding, Profile, StepHeight
from wafer_viewer.session.state import Snapshot


class ResultList:
    """What was kept, each with its value and its uncertainty."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._list = Cell(gui)
            self._csv = button(gui, "CSV", viser.Icon.TABLE_EXPORT, self._on("Export stopped", self._export))
            self._rename = button(gui, "Rename", viser.Icon.PENCIL, self._on("The name stays", self._ask_name))
            self._delete = button(gui, "Delete", viser.Icon.TRASH, self._on("The result stays", self._delete_it))
            in_a_row(gui, [self._csv, self._rename, self._delete], 30)
            self._undo = button(gui, "Undo", viser.Icon.ARROW_BACK_UP, self._on("Nothing was undone", self.undo))
            in_a_row(gui, [self._undo], 30)
        page.on_pick("finding", lambda key: self.choose(int(key)))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the list up to date."""
        set_prop(self._folder, "visible", view.step == "measure")
        if view.step != "measure":
            return
        self._list.show(html.head("Results", str(len(snapshot.findings) or "")) + _rows(snapshot, view))
        chosen = self._chosen(snapshot, view) is not None
        set_prop(self._csv, "disabled", not snapshot.findings)
        set_prop(self._rename, "disabled", not chosen)
        set_prop(self._delete, "disabled", not chosen)
        set_prop(self._undo, "disabled", not snapshot.findings_undo)

    def choose(self, number: int) -> None:
        """Show a result with the places it was measured at; a second click goes back to measuring."""
        page = self._page
        if page.view.selected == number:
            page.change(selected=None)
            return
        match next((f for f in page.session.snapshot.findings if f.number == number), None):
            case Profile() as profile:
                page.change(selected=number, tool="profile", lines=(profile.line,), line=0)
            case StepHeight() as step:
                page.change(selected=number, tool="step", upper=step.upper, lower=step.lower)
            case _:
                page.change(selected=number)

    def undo(self) -> None:
        """Take back the last change to the list."""
        self._page.ask("Nothing was undone", self._page.session.undo_findings())

    def _on(self, name: str, act: Any) -> Any:
        return guarded(self._page, name)(lambda _: act())

    def _chosen(self, snapshot: Snapshot, view: View) -> AnyFinding | None:
        return next((f for f in snapshot.findings if f.number == view.selected), None)

    def _ask_name(self) -> None:
        finding = self._chosen(self._page.session.snapshot, self._page.view)
        if finding is not None:
            rename_dialog(self._page, finding.number, finding.name)

    def _delete_it(self) -> None:
        page, number = self._page, self._page.view.selected
        if number is not None:
            page.ask("The result stays", page.session.delete(number), lambda _: page.change(selected=None))

    def _export(self) -> None:
        page, data = self._page, self._page.session.snapshot.dataset
        if data is not None:
            target = page.session.snapshot.data_folder / f"{data.path.stem}-results.csv"
            done = page.session.export_findings(target)
            page.ask("Export stopped", done, lambda path: page.say("Results exported", str(path)))


def _rows(snapshot: Snapshot, view: View) -> str:
    if not snapshot.findings:
        return html.empty("What you keep is listed here.") + '<div style="height:8px"></div>'
    rows = [
        html.row(
            [
                html.chip(letter(f), sign_colour(f)),
                f'<span class="wv-cut wv-short" title="{html.safe(f.name)}">{html.safe(f.name)}</span>',
                length_text(f),
            ],
            "  n",
            html.pick("finding", f.number),
            "sel" if f.number == view.selected else "",
        )
        for f in snapshot.findings
    ]
    return html.table(["", "Result", "µm, k = 2"], rows, "  n") + '<div style="height:6px"></div>'
