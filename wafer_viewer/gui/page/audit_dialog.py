"""Dialog of the audit log: who scanned, released, changed, judged and signed what in the data folder."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import Dialog, format_time
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.model.audit import AuditEntry
from wafer_viewer.model.errors import WaferViewerError

SHOWN = 200
"""Newest entries that are shown; the command line lists all."""


def audit_dialog(page: Page) -> None:
    """Show the newest entries of the audit log, or why it cannot be read."""
    dialog = Dialog(page, "Audit log", "What changed something in this folder, signed entry by entry.")
    try:
        shown = audit_table(page.session.recorded_actions(), datetime.now().astimezone())
    except WaferViewerError as fault:
        shown = Markup('<div class="wv-note fault">{}</div>').format(fault)
    with dialog.modal:
        HtmlBlock(page.gui, shown)
    dialog.close_button("Close")


def audit_table(entries: Sequence[AuditEntry], now: datetime) -> Markup:
    """Return the newest entries as a table, the newest first."""
    if not entries:
        return html.empty("Nothing was recorded yet: a scan, a release or a kept result is the first entry.")
    rows = [_row(entry, now) for entry in reversed(entries[-SHOWN:])]
    more = len(entries) - len(rows)
    rest = html.empty(f"{more} earlier entries: wafer-viewer log FOLDER lists them.") if more else Markup()
    table = html.table(["When", "Who", "What", "Of"], rows, widths_px=(124, 130, None, 220))
    return Markup('<div class="wv-audit">{}{}</div>').format(table, rest)


def _row(entry: AuditEntry, now: datetime) -> Markup:
    who = Markup("{}<small>{}</small>").format(entry.by, "" if entry.through == "page" else f" {entry.through}")
    what = Markup("{}<small>{}</small>").format(entry.action, entry.detail and f" {entry.detail}")
    return html.row([format_time(entry.at, now), who, what, entry.subject])
