"""Left panel of the gauge check: points of the procedure and earlier signed checks."""

from __future__ import annotations

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.gauge import day_and_time
from wafer_viewer.gui.presenters.gauge_procedure import procedure
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.model.gauge.gauge_check import GaugeCheck, GaugeRecord
from wafer_viewer.session.state.snapshot import Snapshot

MOST_ROWS = 30


class GaugeList:
    """List shown in the gauge check; a click selects an earlier check, a second click deselects it."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._cell = HtmlBlock(page.gui)
        page.on_pick("gauge-record", self._choose)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the list up to date."""
        there = view.step == "gauge"
        self._cell.show(procedure(snapshot) + earlier(snapshot.gauge.records, view.check) if there else "")

    def _choose(self, key: str) -> None:
        self._page.change(check=None if self._page.view.check == key else key)


def selected_check(snapshot: Snapshot, view: View) -> GaugeCheck | None:
    """Return the earlier check that is selected in a view; None if it is not of these blocks."""
    return next((record.check for record in snapshot.gauge.records if record.check.at == view.check), None)


def earlier(records: tuple[GaugeRecord, ...], chosen: str | None) -> str:
    """Return the table of earlier checks, newest first, with date, error and verdict, as HTML."""
    head = html.head("Earlier checks", str(len(records) or ""))
    if not records:
        return head + html.empty("Signed checks of these blocks", "are listed here.")
    rows = [_row(record.check, record.check.at == chosen) for record in reversed(records[-MOST_ROWS:])]
    return head + html.table(["Check", "Error, µm", "Verdict"], rows, " n") + '<div style="height:8px"></div>'


def _row(check: GaugeCheck, chosen: bool) -> str:
    word, sign, tone = LOOKS[check.verdict]
    verdict = f'<span style="color:var(--{tone});white-space:nowrap">{html.icon(sign, 15)} {word.lower()}</span>'
    told = f"{day_and_time(check.at)}, {check.verdict}, signed by {check.signed_by}"
    attributes = f'{html.pick("gauge-record", check.at)} title="{html.safe(told)}"'
    error = number(check.deviation.value_um, 3, signed=True)
    return html.row([html.safe(day_and_time(check.at)), error, verdict], " n", attributes, "sel" if chosen else "")
