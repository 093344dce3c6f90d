"""Bottom panel of the gauge check: run chart of the signed checks of these blocks."""

from __future__ import annotations

from wafer_viewer.draw.charts.run_chart import MOST_POINTS, run_chart_html
from wafer_viewer.draw.number_format import THIN, number, value_and_u
from wafer_viewer.gui.page.bottom_panel import BottomPanel
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.model.gauge.run_chart import RunChart
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
            self._plot.show(f'<div class="wv-below">{below(gauge.chart, serials, view.check or "")}</div>')


def below(chart: RunChart | None, serials: str, chosen: str) -> str:
    """Return the content of the panel as HTML; a placeholder if no check is signed yet."""
    if chart is None or not chart.points:
        head = '<div class="wv-dock"><b>Run chart</b></div>'
        return f'{head}<div class="wv-run-empty">{html.empty(_EMPTY)}</div>'
    warnings = "".join(
        f'<span class="wv-curve-note">{html.safe(html.with_micro_sign(text))}</span>' for text in chart.warnings
    )
    notes = f'<div class="wv-dock">{warnings}</div>' if warnings else ""
    drawn = run_chart_html(chart, lambda point: html.pick("gauge-record", point.at), chosen)
    return f"{_head(chart, serials)}{notes}{drawn}"


def _head(chart: RunChart, serials: str) -> str:
    n = len(chart.points)
    of = f"Last {MOST_POINTS} of {n} checks" if n > MOST_POINTS else f"{n} check{'' if n == 1 else 's'}"
    spread = f"<span>s <b>{number(chart.s_um, 3)}{THIN}µm</b></span>" if chart.s_um is not None else ""
    mean = f"<span>mean <b>{number(chart.mean_um, 3, signed=True)}{THIN}µm</b></span>" if n > 1 else ""
    whole = f"{of} of {html.safe(serials)}"
    limit = (
        f'<span class="wv-hint">limit ± {number(chart.limit_um, 2)}{THIN}µm · </span>'
        if chart.limit_um is not None
        else ""
    )
    return (
        f'<div class="wv-dock wv-run-head"><b>Run chart</b><span class="dim wv-cut" title="{whole}">{whole}</span>'
        f'{mean}{spread}<span class="wv-end">{limit}{_drift(chart)}</span></div>'
    )


def _drift(chart: RunChart) -> str:
    drift = chart.drift_um_per_day
    if drift is None:
        return ""
    value, u = value_and_u(drift.value_um, drift.expanded_um, 4, signed=True)
    beside = f" ± {u}" if drift.expanded_um is not None else ""
    return f"drift <b>{value}{beside}{THIN}µm per day</b>"
