"""Steps of the gauge check procedure with their state and time. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import viser

from wafer_viewer.gui.presenters.gauge import day_and_time
from wafer_viewer.gui.widgets import html
from wafer_viewer.session.state.snapshot import Snapshot

PointName = Literal["clean", "warm", "scan", "faces", "sign"]
BY_HAND: tuple[PointName, ...] = ("clean", "warm")
"""Points that a person ticks; the state of the others follows from the snapshot."""
TITLES: dict[PointName, str] = {
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
    said = {tick.point: tick.at for tick in gauge.ticks}
    by_hand = [ProcedurePoint(name, TITLES[name], name in said, said.get(name, "")) for name in BY_HAND]
    scanned = snapshot.surface is not None or bool(gauge.repeats)
    taken = gauge.repeats[-1].taken if gauge.repeats else data.taken if data is not None and scanned else ""
    signed = gauge.signed is not None
    return (
        *by_hand,
        ProcedurePoint("scan", _scan_title(snapshot), scanned, taken),
        ProcedurePoint("faces", TITLES["faces"], bool(gauge.repeats) or signed),
        ProcedurePoint("sign", TITLES["sign"], signed, gauge.signed.at if gauge.signed is not None else ""),
    )


def next_point(snapshot: Snapshot) -> ProcedurePoint | None:
    """Return the first point that is not done; None if all are."""
    return next((point for point in points(snapshot) if not point.done), None)


def procedure(snapshot: Snapshot) -> str:
    """Return the points as a list with ticks and times."""
    now = next_point(snapshot)
    rows = "".join(_row(point, now is not None and point.name == now.name) for point in points(snapshot))
    foot = '<div class="wv-lab" style="margin-top:8px">Enter goes to the next point</div>' if now is not None else ""
    return f'{html.head("Procedure", first=True)}<div class="wv-points">{rows}</div>{foot}'


def _scan_title(snapshot: Snapshot) -> str:
    job = snapshot.dataset.job if snapshot.dataset is not None else snapshot.draft.job
    grid = job.grid if job is not None else None
    return (
        f"Scan, {grid.rows} × {grid.cols} field{'s' if grid.rows * grid.cols > 1 else ''}" if grid else TITLES["scan"]
    )


def _row(point: ProcedurePoint, now: bool) -> str:
    sign = viser.Icon.CIRCLE_CHECK if point.done else viser.Icon.CIRCLE_DOT if now else viser.Icon.CIRCLE
    tone = "good" if point.done else "accent" if now else "ink3"
    state = "done" if point.done else "next" if now else "to do"
    at = f'<span class="dim" title="{html.safe(day_and_time(point.at))}">{_clock(point.at)}</span>'
    click = html.pick("gauge-tick", point.name) if point.name in BY_HAND else ""
    look = f"{'now ' if now else ''}{'go' if click else ''}"
    return (
        f'<div class="{look}" aria-label="{html.safe(point.title)}, {state}" {click}>'
        f'<span style="color:var(--{tone})">{html.icon(sign, 18)}</span><span>{html.safe(point.title)}</span>{at}</div>'
    )


def _clock(at: str) -> str:
    try:
        return f"{datetime.fromisoformat(at).astimezone():%H:%M}"
    except ValueError:
        return ""
