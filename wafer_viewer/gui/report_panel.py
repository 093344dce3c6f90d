"""The step Report: what goes in, what each part holds, and the one file that is written."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

import viser

from wafer_viewer.gui import html
from wafer_viewer.gui.commands import Command
from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.kit import Cell, button, leading, set_prop
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.view import View
from wafer_viewer.model.report import PART_TITLES, PARTS, Part, ReportOrder
from wafer_viewer.session.state import Snapshot


class ReportPanel:
    """Title and parts; the button writes the report beside the dataset and offers it for download."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._contents: dict[Part, str] = {}
        self._of: object = None
        self._written = ""
        self._writing: Future[Any] | None = None
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date."""
        set_prop(self._folder, "visible", view.step == "report")
        data = snapshot.dataset
        if view.step != "report" or data is None:
            return
        self._ask_contents(snapshot)
        self._title.show(html.title("Report", "One HTML file that stands alone and prints on A4."))
        self._notes.show(self._page.notes(snapshot))
        for part, told in self._told.items():
            told.show(_line(self._contents.get(part, "…"), self._chosen[part].value))
        self._outcome.show(self._written)
        busy = self._writing is not None and not self._writing.done()
        set_prop(self._write, "disabled", busy or not any(box.value for box in self._chosen.values()))

    def commands(self) -> list[Command]:
        """The one verb."""
        return [Command("Write report", None, self.write, viser.Icon.FILE_TEXT, group="Report")]

    def write(self) -> None:
        """Write the report."""
        page = self._page
        if page.session.snapshot.surface is None or (self._writing is not None and not self._writing.done()):
            return
        parts: tuple[Part, ...] = tuple(part for part in PARTS if self._chosen[part].value)
        self._writing = page.session.papers.write_report(ReportOrder(title=self._name.value, parts=parts))
        page.ask("The report was not written", self._writing, self._hand_out)
        page.redraw()

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        self._title, self._notes = Cell(gui), Cell(gui)
        self._name = gui.add_text("Title", "", hint="Stands over the report; without one the dataset's name does")
        Cell(gui, html.head("What goes in"))
        self._chosen: dict[Part, Any] = {}
        self._told: dict[Part, Cell] = {}
        for part in PARTS:
            box = gui.add_checkbox(
                PART_TITLES[part], True, hint=f"Whether the report has a section {PART_TITLES[part]}"
            )
            box.on_update(guarded(page, "The parts stay")(lambda _: page.redraw()))
            self._chosen[part], self._told[part] = box, Cell(gui)
        self._outcome = Cell(gui)
        self._write = button(
            gui,
            "Write report",
            viser.Icon.FILE_TEXT,
            guarded(page, "The report was not written")(lambda _: self.write()),
        )
        leading(gui, self._write)

    def _ask_contents(self, snapshot: Snapshot) -> None:
        """Have what each part holds found out when something of it may have changed."""
        data, book = snapshot.dataset, snapshot.notebook.book
        of = (data.path if data else None, snapshot.findings, book.judgements, snapshot.surface, self._written)
        if of == self._of:
            return
        self._of = of

        def found(contents: dict[Part, str]) -> None:
            self._contents = contents
            self._page.redraw()

        self._page.ask("What goes in is not known", self._page.session.papers.contents(), found)

    def _hand_out(self, path: Any) -> None:
        words = f"<div><b>The report is written.</b><p>{html.safe(path)}</p></div>"
        self._written = f'<div class="wv-note good" role="status">{words}</div>'
        self._page.redraw()
        self._page.client.send_file_download(path.name, path.read_bytes())


def _line(text: str, chosen: bool) -> str:
    return f'<div class="wv-part{"" if chosen else " off"}">{html.safe(text)}</div>'
