"""Panel of the step Report: choice of sections, their contents, and the report file."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any
from urllib.parse import quote

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.import_export_dialogs import save_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import no_surface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    Command,
    HtmlBlock,
    button,
    in_a_row,
    leading,
    set_prop,
    with_precondition,
)
from wafer_viewer.model.report import PART_TITLES, PARTS, Contents, Holds, Part, ReportOrder
from wafer_viewer.session.files.file_jobs import REPORT, free_path, newest_report
from wafer_viewer.session.state.snapshot import Snapshot

UNKNOWN = Holds("…")


class ReportPanel:
    """Title and sections; the button writes the report next to the dataset and offers it for download."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._contents: Contents = {}
        self._left_out: set[Part] = set()
        """Sections that the user deselected; sections that are empty now are not among them, as they may fill later."""
        self._shown_for: object = None
        self._written: tuple[Path, Path] | None = None
        """Dataset and path of the report written last."""
        self._writing: Future[Any] | None = None
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the panel."""
        set_prop(self._folder, "visible", view.step == "report")
        data = snapshot.dataset
        if view.step != "report" or data is None:
            self._shown_for = None
            return
        self._ask_contents(snapshot)
        self._title.show(html.title("Report", "A self-contained HTML file that prints on A4."))
        self._notes.show(self._page.notes(snapshot))
        chosen = self._chosen()
        for part, summary in self._summaries.items():
            holds = self._contents.get(part, UNKNOWN)
            self._boxes[part].show(part in chosen)
            self._boxes[part].enable(not holds.nothing)
            summary.show(_line(holds, part in chosen))
        self._outcome.show(
            _newest(self._last(data.path))
            if chosen
            else Markup('<div class="wv-why">Not yet: no section is selected.</div>')
        )
        for act in (self._elsewhere, self._write):
            set_prop(act, "disabled", self._busy or not chosen)

    def commands(self) -> list[Command]:
        """Return the commands that write the report, without and with a dialog."""
        write = Command("Write report", None, self.write, viser.Icon.FILE_TEXT, group="Report")
        ask = Command("Save report as…", None, self.ask_where, viser.Icon.DEVICE_FLOPPY, group="Report")
        return with_precondition(self._why_not, write, ask)

    def _why_not(self, snapshot: Snapshot, view: View) -> str | None:
        if (missing := no_surface(snapshot, view)) is not None:
            return missing
        if self._busy:
            return "a report is being written."
        return None if self._chosen() else "no section is selected."

    def write(self) -> None:
        """Write the report next to the dataset, under an unused name."""
        page = self._page
        if self._why_not(page.session.snapshot, page.view) is None:
            page.ask("The report was not written", self._begin(None), self._hand_out)

    def ask_where(self) -> None:
        """Open the dialog that saves the report."""
        page, data = self._page, self._page.session.snapshot.dataset
        if data is not None and self._why_not(page.session.snapshot, page.view) is None:
            name = free_path(data.path, REPORT, ".html").name
            save_dialog(page, "Save the report", name, self._begin, "Report saved", "The report was not written")

    def _begin(self, path: Path | None) -> Future[Path]:
        """Start to write to a path; None writes next to the dataset."""
        page, data = self._page, self._page.session.snapshot.dataset
        order = ReportOrder(title=self._name.value, parts=self._chosen())
        self._writing = page.session.papers.write_report(order, path)
        self._writing.add_done_callback(lambda done: self._take(data.path if data is not None else None, done))
        page.redraw()
        return self._writing

    def _take(self, dataset: Path | None, done: Future[Path]) -> None:
        if dataset is not None and not done.cancelled() and done.exception() is None:
            self._written = dataset, done.result()
        self._page.redraw()

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        self._title, self._notes = HtmlBlock(gui), HtmlBlock(gui)
        self._name = gui.add_text("Title", "", hint="Heading of the report; without one the dataset's name")
        HtmlBlock(gui, html.head("Contents"))
        self._boxes: dict[Part, BoundInput[bool]] = {}
        self._summaries: dict[Part, HtmlBlock] = {}
        for part in PARTS:
            hint = f"Include the section {PART_TITLES[part]}"
            box = gui.add_checkbox(PART_TITLES[part], True, hint=hint)
            self._boxes[part] = BoundInput(
                box, lambda event, p=part: self._tick(p, event.target.value), page, "The report was not changed"
            )
            self._summaries[part] = HtmlBlock(gui)
        failed = guarded(page, "The report was not written")
        self._elsewhere = button(gui, "Save report as…", viser.Icon.DEVICE_FLOPPY, failed(lambda _: self.ask_where()))
        in_a_row(gui, [self._elsewhere], 34)
        self._outcome = HtmlBlock(gui)
        self._write = button(
            gui,
            "Write report",
            viser.Icon.FILE_TEXT,
            failed(lambda _: self.write()),
        )
        leading(gui, self._write)

    @property
    def _busy(self) -> bool:
        return self._writing is not None and not self._writing.done()

    def _chosen(self) -> tuple[Part, ...]:
        """Return the sections to write: all that are not empty and not deselected."""
        nothing = {part for part, holds in self._contents.items() if holds.nothing}
        return tuple(part for part in PARTS if part not in self._left_out and part not in nothing)

    def _tick(self, part: Part, wanted: bool) -> None:
        (self._left_out.discard if wanted else self._left_out.add)(part)
        self._page.redraw()

    def _ask_contents(self, snapshot: Snapshot) -> None:
        """Request the contents of the sections if they may have changed."""
        data, book = snapshot.dataset, snapshot.notebook.book
        papers, verdict = self._page.session.papers, snapshot.operating.verdict
        sources = (data.path if data else None, snapshot.findings, book.judgements, snapshot.surface, verdict)
        sources = (*sources, papers.pictures_kept, self._written)
        if sources == self._shown_for:
            return
        self._shown_for = sources

        def listed(contents: Contents) -> None:
            self._contents = contents
            self._page.redraw()

        self._page.ask("The contents were not read", papers.contents(), listed)

    def _last(self, dataset: Path) -> Path | None:
        """Return the newest report of a dataset: written by this page, or found next to it."""
        written = self._written[1] if self._written is not None and self._written[0] == dataset else None
        return written if written is not None and written.exists() else newest_report(dataset)

    def _hand_out(self, path: Path) -> None:
        self._page.client.send_file_download(path.name, path.read_bytes())


def report_address(report: Path) -> str:
    """Return the address of a report on the page's own server."""
    return f"/reports/{quote(report.name)}"


def _newest(path: Path | None) -> Markup:
    """Return a note with a link to the newest report; empty for None."""
    if path is None:
        return Markup()
    link = Markup('<a class="wv-link" href="{}" target="_blank" rel="noopener">Open the report</a>').format(
        report_address(path)
    )
    words = Markup('<div><b>The report is written.</b><p>{}</p><p class="wv-foot">{}</p></div>').format(path, link)
    return Markup('<div class="wv-note good" role="status">{}</div>').format(words)


def _line(holds: Holds, chosen: bool) -> Markup:
    look = " none" if holds.nothing else "" if chosen else " off"
    return Markup('<div class="wv-part{}">{}</div>').format(look, html.with_micro_sign(holds.words))
