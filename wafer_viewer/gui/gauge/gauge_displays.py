"""Displays of the gauge check around the scene: run chart, points of the procedure, and the measured step."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.draw.charts.run_chart import MOST_POINTS, run_chart_html
from wafer_viewer.draw.number_format import THIN, number, value_and_u
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel
from wafer_viewer.gui.presenters.gauge import day_and_time, procedure, scene_step_label
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import FloatingPanel, HtmlBlock
from wafer_viewer.model.gauge import GaugeCheck, GaugeRecord, RunChart
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.session.state.snapshot import Snapshot

_EMPTY = "Signed checks of these blocks are drawn here, with limits, mean and drift."


class GaugeDock:
    """Header with mean, s and drift, warnings, and the chart."""

    def __init__(self, page: Page) -> None:
        self._panel = BottomPanel(page, "gauge")
        with self._panel.tab:
            self._plot = HtmlBlock(page.gui)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the chart up to date."""
        if self._panel.show(view):
            gauge = snapshot.gauge
            serials = " / ".join(gauge.certificate.serials) if gauge.certificate is not None else ""
            self._plot.show(
                Markup('<div class="wv-below">{}</div>').format(below(gauge.chart, serials, view.check or ""))
            )


def below(chart: RunChart | None, serials: str, chosen: str) -> Markup:
    """Return the content of the panel as HTML; a note if no check is signed yet."""
    if chart is None or not chart.points:
        head = Markup('<div class="wv-dock"><b>Run chart</b></div>')
        return Markup('{}<div class="wv-run-empty">{}</div>').format(head, html.empty(_EMPTY))
    warnings = Markup("").join(
        Markup('<span class="wv-curve-note">{}</span>').format(html.with_micro_sign(text)) for text in chart.warnings
    )
    notes = Markup('<div class="wv-dock">{}</div>').format(warnings) if warnings else Markup()
    drawn = run_chart_html(chart, lambda point: html.pick("gauge-record", point.at), chosen)
    return _head(chart, serials) + notes + drawn


def _head(chart: RunChart, serials: str) -> Markup:
    n = len(chart.points)
    counted = f"Last {MOST_POINTS} of {n} checks" if n > MOST_POINTS else f"{n} check{'' if n == 1 else 's'}"
    spread = (
        Markup("<span>s <b>{}{}µm</b></span>").format(number(chart.s_um, 3), THIN)
        if chart.s_um is not None
        else Markup()
    )
    mean = (
        Markup("<span>mean <b>{}{}µm</b></span>").format(number(chart.mean_um, 3, signed=True), THIN)
        if n > 1
        else Markup()
    )
    caption = f"{counted} of {serials}"
    limit = (
        Markup('<span class="wv-hint">limit ± {}{}µm · </span>').format(number(chart.limit_um, 2), THIN)
        if chart.limit_um is not None
        else Markup()
    )
    return Markup(
        '<div class="wv-dock wv-run-head"><b>Run chart</b><span class="dim wv-cut" title="{caption}">{caption}</span>'
        '{mean}{spread}<span class="wv-end">{limit}{drift}</span></div>'
    ).format(caption=caption, mean=mean, spread=spread, limit=limit, drift=_drift(chart))


def _drift(chart: RunChart) -> Markup:
    drift = chart.drift_um_per_day
    if drift is None:
        return Markup()
    value, u = value_and_u(drift.value_um, drift.expanded_um, 4, signed=True)
    uncertainty = f" ± {u}" if drift.expanded_um is not None else ""
    return Markup("drift <b>{}{}{}µm per day</b>").format(value, uncertainty, THIN)


MOST_ROWS = 30


class GaugeList:
    """List shown in the gauge check; a click selects an earlier check, a second click deselects it."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._cell = HtmlBlock(page.gui)
        page.on_pick("gauge-record", self._choose)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the list up to date."""
        visible = view.checks_blocks
        self._cell.show(procedure(snapshot) + earlier(snapshot.gauge.records, view.check) if visible else "")

    def _choose(self, key: str) -> None:
        self._page.change(check=None if self._page.view.check == key else key)


def selected_check(snapshot: Snapshot, view: View) -> GaugeCheck | None:
    """Return the earlier check that is selected in a view; None if it is not of these blocks."""
    return next((record.check for record in snapshot.gauge.records if record.check.at == view.check), None)


def earlier(records: tuple[GaugeRecord, ...], chosen: str | None) -> Markup:
    """Return the table of earlier checks, newest first, with date, error and verdict, as HTML."""
    head = html.head("Earlier checks", str(len(records) or ""))
    if not records:
        return head + html.empty("Signed checks of these blocks", "are listed here.")
    rows = [_row(record.check, record.check.at == chosen) for record in reversed(records[-MOST_ROWS:])]
    return head + html.table(["Check", "Error, µm", "Verdict"], rows, " n") + Markup('<div style="height:8px"></div>')


def _row(check: GaugeCheck, chosen: bool) -> Markup:
    word, sign, tone = LOOKS[check.verdict]
    verdict = Markup('<span style="color:var(--{});white-space:nowrap">{} {}</span>').format(
        tone, html.icon(sign, 15), word.lower()
    )
    title = f"{day_and_time(check.at)}, {check.verdict}, signed by {check.signed_by}"
    attributes = Markup('{} title="{}"').format(html.pick("gauge-record", check.at), title)
    error = number(check.deviation.value_um, 3, signed=True)
    return html.row([day_and_time(check.at), error, verdict], " n", attributes, "sel" if chosen else "")


LIVE_STEP = "step between the faces"
"""Question of the page: the step as measured now."""
_BESIDE_TOOLS_PX = 880
"""Scene width from which the read-out has its place beside the toolbar; below the toolbar in a narrower one."""
_TOOLS_PX = 52
"""Height of the toolbar, with its distance."""


class StepReadout:
    """Read-out of the mean of the repeats, of an earlier check, or of the live step before the first repeat."""

    def __init__(self, page: Page) -> None:
        self._answers, self._viewport = page.answers, page.viewport
        self._panel = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, 330, 88, align="right")

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the figure up to date."""
        is_narrow = 0 < self._viewport.width_px < _BESIDE_TOOLS_PX
        content = self._content(snapshot, view) if view.checks_blocks and not view.explains else ""
        self._panel.show(content, y_px=EDGE_PX + _TOOLS_PX if is_narrow else EDGE_PX)

    def _content(self, snapshot: Snapshot, view: View) -> Markup:
        earlier = selected_check(snapshot, view)
        check = earlier or snapshot.gauge.signed or snapshot.gauge.check
        if check is not None:
            source = f", {day_and_time(check.at)}" if check.at else f", mean of {check.n}" if check.n > 1 else ""
            return scene_step_label(f"Measured step{source}", check.height)
        step = self._answers.known(LIVE_STEP).value
        return (
            scene_step_label("Step between the regions, live", step.height)
            if isinstance(step, StepHeight)
            else Markup()
        )
