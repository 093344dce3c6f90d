"""Around the scene of the gauge check: procedure and earlier checks, run chart, and the measured step."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.run_chart import MOST_POINTS, run_chart_html
from wafer_viewer.draw.number_format import THIN, number, plural, value_and_u
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here, Overlay, Picks
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.gauge import day_and_time, scene_step_label
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.gauge import GaugeCheck, GaugeRecord, RunChart
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.session.state.snapshot import Snapshot

LIVE_STEP = "step between the faces"
"""Question of the page: the step as measured now."""
MOST_ROWS = 30
NOT_TICKED = "The point was not changed"
_EMPTY = "Signed checks of these blocks are drawn here, with limits, mean and drift."
_BESIDE_TOOLS_PX = 880
"""Scene width from which the read-out has its place beside the toolbar; below the toolbar in a narrower one."""
_TOOLS_PX = 52
"""Height of the toolbar, with its distance."""


def check_list(here: Here[None]) -> Elements | None:
    """Return procedure and earlier checks; a click selects an earlier check, a second one deselects it."""
    snapshot, view = here.snapshot, here.view
    if not view.checks_blocks:
        return None
    listed = procedure(snapshot) + earlier(snapshot.gauge.records, view.check)
    return [Html(listed)]


def tick(page: Page, point: str) -> None:
    """Tick a point of the procedure, or take its tick away."""
    done = any(tick.point == point for tick in page.session.snapshot.gauge.ticks)
    page.ask(NOT_TICKED, page.session.gauge.tick(point, not done))


def _choose(here: Here[None], key: str) -> None:
    here.page.change(check=None if here.page.view.check == key else key)


CHECK_PICKS: Picks[None] = {"gauge-record": _choose, "gauge-tick": lambda here, point: tick(here.page, point)}


def run_chart_dock(here: Here[None]) -> Elements:
    """Return the run chart of the blocks under their certificate."""
    gauge = here.snapshot.gauge
    serials = " / ".join(gauge.certificate.serials) if gauge.certificate is not None else ""
    drawn = below(gauge.chart, serials, here.view.check or "")
    return [Html(Markup('<div class="wv-below">{}</div>').format(drawn))]


def step_readout(here: Here[None]) -> Overlay | None:
    """Return the mean of the repeats, an earlier check, or the live step before the first repeat, as a figure."""
    snapshot, view = here.snapshot, here.view
    if not view.checks_blocks or view.explains:
        return None
    is_narrow = 0 < here.page.viewport.width_px < _BESIDE_TOOLS_PX
    y_px = EDGE_PX + _TOOLS_PX if is_narrow else EDGE_PX
    return Overlay.of(_figure(snapshot, view, here.ask.known(LIVE_STEP).value), -EDGE_PX, y_px, 330, 88, at_right=True)


def _figure(snapshot: Snapshot, view: View, live: object) -> Markup:
    check = selected_check(snapshot, view) or snapshot.gauge.signed or snapshot.gauge.check
    if check is not None:
        source = f", {day_and_time(check.at)}" if check.at else f", mean of {check.n}" if check.n > 1 else ""
        return scene_step_label(f"Measured step{source}", check.height)
    return scene_step_label("Step between the regions, live", live.height) if isinstance(live, StepHeight) else Markup()


def selected_check(snapshot: Snapshot, view: View) -> GaugeCheck | None:
    """Return the earlier check that is selected in a view; None if it is not of these blocks."""
    return next((record.check for record in snapshot.gauge.records if record.check.at == view.check), None)


def below(chart: RunChart | None, serials: str, chosen: str) -> Markup:
    """Return the content of the panel as HTML; a note if no check is signed yet."""
    if chart is None or not chart.points:
        head = Markup('<div class="wv-dock"><b>Run chart</b></div>')
        return Markup('{}<div class="wv-run-empty">{}</div>').format(head, html.empty(_EMPTY))
    warnings = Markup("").join(
        Markup('<span class="wv-curve-note">{}</span>').format(html.typeset(text)) for text in chart.warnings
    )
    notes = Markup('<div class="wv-dock">{}</div>').format(warnings) if warnings else Markup()
    drawn = run_chart_html(chart, lambda point: html.pick("gauge-record", point.at), chosen)
    return _chart_head(chart, serials) + notes + drawn


def _chart_head(chart: RunChart, serials: str) -> Markup:
    n = len(chart.points)
    counted = f"Last {MOST_POINTS} of {n} checks" if n > MOST_POINTS else plural(n, "check")
    caption = f"{counted} of {serials}"
    mean, spread, limit = Markup(), Markup(), Markup()
    if n > 1:
        mean = Markup("<span>mean <b>{}{}µm</b></span>").format(number(chart.mean_um, 3, signed=True), THIN)
    if chart.s_um is not None:
        spread = Markup("<span>s <b>{}{}µm</b></span>").format(number(chart.s_um, 3), THIN)
    if chart.limit_um is not None:
        limit = Markup('<span class="wv-hint">limit ± {}{}µm · </span>').format(number(chart.limit_um, 2), THIN)
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


def earlier(records: tuple[GaugeRecord, ...], chosen: str | None) -> Markup:
    """Return the table of earlier checks, newest first, with date, error and verdict, as HTML."""
    head = html.head("Earlier checks", str(len(records) or ""))
    if not records:
        return head + html.empty("Signed checks of these blocks", "are listed here.")
    rows = [_earlier_row(record.check, record.check.at == chosen) for record in reversed(records[-MOST_ROWS:])]
    return head + html.table(["Check", "Error, µm", "Verdict"], rows, " n") + Markup('<div style="height:8px"></div>')


def _earlier_row(check: GaugeCheck, chosen: bool) -> Markup:
    word, sign, tone = LOOKS[check.verdict]
    verdict = Markup('<span style="color:var(--{});white-space:nowrap">{} {}</span>').format(
        tone, html.icon(sign, 15), word.lower()
    )
    title = f"{day_and_time(check.at)}, {check.verdict}, signed by {check.signed_by}"
    attributes = Markup('{} title="{}"').format(html.pick("gauge-record", check.at), title)
    error = number(check.deviation.value_um, 3, signed=True)
    return html.row([day_and_time(check.at), error, verdict], " n", attributes, "sel" if chosen else "")


PointName = Literal["clean", "warm", "scan", "faces", "sign"]
BY_HAND: tuple[PointName, ...] = ("clean", "warm")
"""Points that a person ticks; the state of the others follows from the snapshot."""
POINT_TITLES: dict[PointName, str] = {
    "clean": "Clean the blocks, wring them",
    "warm": "Warm up 20 min",
    "scan": "Scan",
    "faces": "Regions on both blocks",
    "sign": "Sign",
}


@dataclass(frozen=True, slots=True)
class ProcedurePoint:
    """One point of the procedure; at: time of completion, ISO 8601 or empty."""

    name: PointName
    title: str
    done: bool
    at: str = ""


def points(snapshot: Snapshot) -> tuple[ProcedurePoint, ...]:
    """Return all points of the current check, in order."""
    gauge, data = snapshot.gauge, snapshot.dataset
    notes = {tick.point: tick.at for tick in gauge.ticks}
    by_hand = [ProcedurePoint(name, POINT_TITLES[name], name in notes, notes.get(name, "")) for name in BY_HAND]
    scanned = snapshot.surface is not None or bool(gauge.repeats)
    taken = gauge.repeats[-1].taken if gauge.repeats else data.taken if data is not None and scanned else ""
    signed = gauge.signed is not None
    return (
        *by_hand,
        ProcedurePoint("scan", _scan_title(snapshot), scanned, taken),
        ProcedurePoint("faces", POINT_TITLES["faces"], bool(gauge.repeats) or signed),
        ProcedurePoint("sign", POINT_TITLES["sign"], signed, gauge.signed.at if gauge.signed is not None else ""),
    )


def next_point(snapshot: Snapshot) -> ProcedurePoint | None:
    """Return the first point that is not done; None if all are."""
    return next((point for point in points(snapshot) if not point.done), None)


def procedure(snapshot: Snapshot) -> Markup:
    """Return the points as a list with ticks and times."""
    now = next_point(snapshot)
    rows = Markup("").join(_point_row(point, now is not None and point.name == now.name) for point in points(snapshot))
    foot = Markup('<div class="wv-lab" style="margin-top:8px">Enter goes to the next point</div>') if now else Markup()
    return Markup('{}<div class="wv-points">{}</div>{}').format(html.head("Procedure", first=True), rows, foot)


def _scan_title(snapshot: Snapshot) -> str:
    job = snapshot.dataset.job if snapshot.dataset is not None else snapshot.draft.job
    grid = job.grid if job is not None else None
    if not grid:
        return POINT_TITLES["scan"]
    return f"Scan, {grid.rows} × {grid.cols} field{'s' if grid.rows * grid.cols > 1 else ''}"


def _point_row(point: ProcedurePoint, now: bool) -> Markup:
    sign = viser.Icon.CIRCLE_CHECK if point.done else viser.Icon.CIRCLE_DOT if now else viser.Icon.CIRCLE
    tone = "good" if point.done else "accent" if now else "ink3"
    state = "done" if point.done else "next" if now else "to do"
    moment = Markup('<span class="dim" title="{}">{}</span>').format(day_and_time(point.at), _clock(point.at))
    click = html.command_pick("gauge-tick", point.name) if point.name in BY_HAND else ""
    look = f"{'now ' if now else ''}{'go' if click else ''}"
    return Markup(
        '<div class="{look}" aria-label="{title}, {state}" {click}>'
        '<span style="color:var(--{tone})">{icon}</span><span>{title}</span>{moment}</div>'
    ).format(look=look, title=point.title, state=state, click=click, tone=tone, icon=html.icon(sign, 18), moment=moment)


def _clock(moment: str) -> str:
    try:
        return f"{datetime.fromisoformat(moment).astimezone():%H:%M}"
    except ValueError:
        return ""
