"""The step Report: choice of sections, their contents, and the report file."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.open_and_export import save_dialog
from wafer_viewer.gui.elements.elements import Button, Buttons, Checkbox, Element, Elements, Html, Text, Toggle
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.preconditions import no_surface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model.report import (
    DIGITAL,
    LANGUAGES,
    PAGE,
    PART_TITLES,
    PARTS,
    PRINTED,
    TRANSFER,
    Holds,
    Language,
    Part,
    ReportOrder,
)
from wafer_viewer.session.files.file_jobs import REPORT, free_path, newest_report
from wafer_viewer.session.state.snapshot import Snapshot

CONTENTS, WRITING = "contents of a report", "report"
UNKNOWN = Holds("…")
TITLE_HINT = "Heading of the report; without one the dataset's name"
NUMBER_HINT = "Number on every page; without one the dataset's name and the day of the scan"
CUSTOMER_HINT = "For whom the report is made; the laboratory's own head is laboratory.toml in the data folder"
ENDINGS = ((PAGE, "HTML"), (PRINTED, "PDF"), (DIGITAL, "XML"), (TRANSFER, "DFQ"))
FOR_PROGRAMS = {
    DIGITAL: "All results with U, k and probability, as a digital calibration certificate (DCC 3.1.2).",
    TRANSFER: "Features with limits, a value for each die, and all results, for statistical process control (AQDEF).",
}
"""What a file for other programs holds; it has no sections to choose."""
LANGUAGE_HINT = "Language of the report; without a choice that of laboratory.toml in the data folder, or English"
LANGUAGE_OPTIONS = (("", "Laboratory's"), *LANGUAGES.items())
FILE_HINT = (
    "HTML for screens and printers; a PDF is printed by the Chromium, Chrome or Edge of the viewer's machine; "
    "XML and DFQ hold the results for other programs"
)
FAILED = "The report was not written"
_NONE_SELECTED = Markup('<div class="wv-why">Not yet: no section is selected.</div>')


@dataclass(frozen=True, slots=True)
class ReportChoices:
    """Choices of one browser.

    left_out: sections that a person deselected; those that are empty now are not among them, as they may fill later.
    written: dataset and path of the report that was written last.
    """

    title: str = ""
    number: str = ""
    customer: str = ""
    ending: str = PAGE
    language: Language | Literal[""] = ""
    left_out: frozenset[Part] = frozenset()
    written: tuple[Path, Path] | None = None


def report_step(here: Here[ReportChoices]) -> Elements | None:
    """Return title and sections; the button writes the report next to the dataset and offers it for download."""
    data = here.snapshot.dataset
    if here.view.step != "report" or data is None:
        here.ask.forget(CONTENTS)
        return None
    contents = _contents(here)
    chosen, for_programs = chosen_parts(here), FOR_PROGRAMS.get(here.own.ending)
    idle = bool(chosen or for_programs) and not here.ask.busy(WRITING)
    floppy, sheet = viser.Icon.DEVICE_FLOPPY, viser.Icon.FILE_TEXT
    return [
        Html(html.title("Report", "One self-contained file.")),
        Html(here.page.notes(here.snapshot)),
        Text("Title", here.own.title, lambda title: here.keep(title=title), TITLE_HINT),
        Text("Number", here.own.number, lambda number: here.keep(number=number), NUMBER_HINT),
        Text("Customer", here.own.customer, lambda customer: here.keep(customer=customer), CUSTOMER_HINT),
        Toggle("File", here.own.ending, lambda ending: here.keep(ending=ending), FILE_HINT, options=ENDINGS),
        Toggle(
            "Language",
            here.own.language,
            lambda language: here.keep(language=language),
            LANGUAGE_HINT,
            options=LANGUAGE_OPTIONS,
        ),
        Html(html.head("Contents")),
        *(
            [Html(html.remark(for_programs, "margin-bottom: 14px"))]
            if for_programs
            else (e for part in PARTS for e in _section(here, part, contents.get(part, UNKNOWN), part in chosen))
        ),
        Buttons([Button("Save report as…", lambda: ask_where(here), floppy, disabled=not idle, failed=FAILED)], 34),
        Html(_newest(_last(here.own, data.path)) if chosen or for_programs else _NONE_SELECTED),
        Button("Write report", lambda: write(here), sheet, "leading", disabled=not idle, failed=FAILED),
    ]


def report_commands(here: Here[ReportChoices]) -> list[Command]:
    """Return the commands that write the report, without and with a dialog."""
    return with_precondition(
        lambda snapshot, view: _why_not(here, snapshot, view),
        Command("Write report", None, lambda: write(here), viser.Icon.FILE_TEXT, group="Report"),
        Command("Save report as…", None, lambda: ask_where(here), viser.Icon.DEVICE_FLOPPY, group="Report"),
    )


def chosen_parts(here: Here[ReportChoices]) -> tuple[Part, ...]:
    """Return the sections to write: all that are not empty and not deselected."""
    contents = here.ask.known(CONTENTS).value or {}
    nothing = {part for part, holds in contents.items() if holds.nothing}
    return tuple(part for part in PARTS if part not in here.own.left_out and part not in nothing)


def write(here: Here[ReportChoices]) -> None:
    """Write the report next to the dataset, under an unused name, and hand it to the browser."""
    if _why_not(here, here.page.session.snapshot, here.page.view) is None:
        here.page.ask(FAILED, _begin(here, None), lambda path: _hand_out(here, path))


def ask_where(here: Here[ReportChoices]) -> None:
    """Open the dialog that saves the report."""
    snapshot = here.page.session.snapshot
    if (data := snapshot.dataset) is not None and _why_not(here, snapshot, here.page.view) is None:
        name = free_path(data.path, REPORT, here.own.ending).name
        save_dialog(here.page, "Save the report", name, lambda path: _begin(here, path), "Report saved", FAILED)


def report_address(report: Path) -> str:
    """Return the address of a report on the page's own server."""
    return f"/reports/{quote(report.name)}"


def _section(here: Here[ReportChoices], part: Part, holds: Holds, chosen: bool) -> tuple[Element, Element]:
    def tick(wanted: bool) -> None:
        here.keep(left_out=here.own.left_out - {part} if wanted else here.own.left_out | {part})

    title = PART_TITLES[part]
    hint = f"Include the section {title}"
    look = " none" if holds.nothing else "" if chosen else " off"
    return (
        Checkbox(title, chosen, tick, hint, disabled=holds.nothing),
        Html(Markup('<div class="wv-part{}">{}</div>').format(look, html.typeset(holds.words))),
    )


def _contents(here: Here[ReportChoices]) -> dict[Part, Holds]:
    """Return what is known of the sections; it is asked again when it may have changed."""
    snapshot, papers, data = here.snapshot, here.page.session.papers, here.snapshot.dataset
    stamp = (data and data.path, snapshot.findings, snapshot.notebook.book.judgements, snapshot.surface)
    stamp = (*stamp, snapshot.operating.verdict, papers.pictures_kept, here.own.written)
    return here.ask(CONTENTS, stamp, lambda: papers.contents().result(), "The contents were not read").value or {}


def _why_not(here: Here[ReportChoices], snapshot: Snapshot, view: View) -> str | None:
    if (missing := no_surface(snapshot, view)) is not None:
        return missing
    if here.ask.busy(WRITING):
        return "a report is being written."
    return None if here.own.ending in FOR_PROGRAMS or chosen_parts(here) else "no section is selected."


def _begin(here: Here[ReportChoices], path: Path | None) -> Future[Path]:
    """Start to write to a path; None writes next to the dataset."""
    data = here.page.session.snapshot.dataset

    def take(done: Future[Any]) -> None:
        if data is not None and not done.cancelled() and done.exception() is None:
            here.keep(written=(data.path, done.result()))

    own = here.own
    order = ReportOrder(
        title=own.title,
        number=own.number,
        customer=own.customer,
        language=own.language or None,
        parts=chosen_parts(here),
    )
    if path is None and data is not None:
        path = free_path(data.path, REPORT, own.ending)
    writing = here.ask.begin(WRITING, here.page.session.papers.write_report(order, path))
    writing.add_done_callback(take)
    return writing


def _hand_out(here: Here[ReportChoices], path: Path) -> None:
    here.page.client.send_file_download(path.name, path.read_bytes())


def _last(choices: ReportChoices, dataset: Path) -> Path | None:
    """Return the newest report of a dataset: written by this page, or found next to it."""
    written = choices.written[1] if choices.written is not None and choices.written[0] == dataset else None
    return written if written is not None and written.exists() else newest_report(dataset)


def _newest(path: Path | None) -> Markup:
    """Return a note with a link to the newest report, which a file for other programs has not; empty for None."""
    if path is None:
        return Markup()
    if path.suffix in FOR_PROGRAMS:
        words = Markup("<div><b>The results are written.</b><p>{}</p></div>").format(path)
        return Markup('<div class="wv-note good" role="status">{}</div>').format(words)
    link = Markup('<a class="wv-link" href="{}" target="_blank" rel="noopener">Open the report</a>').format(
        report_address(path)
    )
    words = Markup('<div><b>The report is written.</b><p>{}</p><p class="wv-foot">{}</p></div>').format(path, link)
    return Markup('<div class="wv-note good" role="status">{}</div>').format(words)
