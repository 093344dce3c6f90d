"""The header, always in sight: what is open, the steps of the work, the rig and whether it is real."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import viser

from wafer_viewer.draw.numbers import THIN, number
from wafer_viewer.gui.html import icon, pick, safe
from wafer_viewer.gui.kit import Cell, Gui, button, set_prop
from wafer_viewer.gui.stopping import can_stop
from wafer_viewer.gui.style import HEADER_PX, LEFT_PX, NARROW_WINDOW_PX, STEP_PX, by_id
from wafer_viewer.gui.view import Step, View
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.notebook import keys_under_review
from wafer_viewer.session.state import RigStatus, Snapshot

STOP_PX, STOP_RIGHT_PX = 88, 330
STEPS: tuple[Step, ...] = get_args(Step)
TITLES: dict[Step, str] = {
    "plan": "Plan",
    "acquire": "Acquire",
    "surface": "Surface",
    "measure": "Measure",
    "gauge": "Gauge check",
    "review": "Review",
    "report": "Report",
}
NARROW_PX: dict[Step, int] = {
    "plan": 70,
    "acquire": 92,
    "surface": 92,
    "measure": 96,
    "gauge": 120,
    "review": 90,
    "report": 84,
}
"""How wide each is where there is little room: together they end before Stop in a window of 1366 px."""
SHOWN_AT_NEED: tuple[Step, ...] = ("review", "report")
"""Steps that the header leaves out as long as they have no contents."""
_MARK = (
    '<svg width="34" height="34" viewBox="0 0 34 34" aria-hidden="true"><g fill="none" stroke="var(--accent)">'
    '<circle cx="17" cy="17" r="15.5" stroke-width="2"/>'
    '<path d="M4 21h6l2.5-9H21l2.5 9H30" stroke-width="2.6" stroke-linejoin="round"/></g></svg>'
)
_TONE = {
    "ready": "good",
    "starting": "busy",
    "moving": "busy",
    "scanning": "busy",
    "paused": "busy",
    "stopping": "busy",
    "fault": "fault",
    "absent": "fault",
}


def possible(step: Step, snapshot: Snapshot) -> bool:
    """Whether there is anything to do in a step."""
    data = snapshot.dataset
    match step:
        case "plan" | "gauge":
            return True
        case "acquire":
            return snapshot.scanning or snapshot.scan is not None or (data is not None and not data.finished)
        case "surface":
            return data is not None and (data.finished or bool(data.stamps))
        case "measure" | "review" | "report":
            return snapshot.surface is not None


def done(step: Step, snapshot: Snapshot) -> bool:
    """Whether a tick stands before a step."""
    data = snapshot.dataset
    return (
        data is not None
        and {
            "plan": True,
            "acquire": data.finished and not snapshot.scanning,
            "surface": bool(_under_review(snapshot)),
            "measure": bool(snapshot.notebook.book.judgements),
            "gauge": any(isinstance(finding, GaugeCheck) for finding in snapshot.findings),
            "review": all_judged(snapshot),
            "report": False,
        }[step]
    )


def all_judged(snapshot: Snapshot) -> bool:
    """Whether every result, every feature of a verdict and every defect was accepted or rejected."""
    keys, defects = _under_review(snapshot), snapshot.inspection.defects
    noted = snapshot.notebook.book.judged(keys) == len(keys)
    return bool(keys or defects) and noted and all(defect.judgement != "open" for defect in defects)


def _under_review(snapshot: Snapshot) -> tuple[str, ...]:
    return keys_under_review(snapshot.operating.verdict, snapshot.findings)


class Header:
    """Mark, dataset, steps, Stop, rig. Steps and Stop are real buttons that style places over the header's bar."""

    def __init__(self, gui: Gui, go_to: Callable[[Step], None], stop: Callable[[], None]) -> None:
        self._stop = button(gui, "Stop", viser.Icon.PLAYER_STOP, lambda _: stop(), disabled=True)
        gui.add_html(f"<style>{_stop_rules(by_id(self._stop._impl.uuid))}</style>")
        self._steps: dict[Step, Any] = {
            step: button(gui, TITLES[step], None, lambda _, s=step: go_to(s)) for step in STEPS
        }
        self._bar = Cell(gui, padded=False)
        self._style = Cell(gui, padded=False)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the header up to date."""
        self._bar.show(f'<div class="wv-hd">{_mark(snapshot)}{_state(snapshot, view)}</div>')
        shown: list[Step] = [step for step in STEPS if possible(step, snapshot) or step not in SHOWN_AT_NEED]
        self._style.show(self._step_style(view.step, shown))
        set_prop(self._stop, "disabled", not can_stop(snapshot))
        for step, handle in self._steps.items():
            set_prop(handle, "disabled", not possible(step, snapshot))
            set_prop(handle, "visible", step in shown)
            set_prop(handle, "icon", viser.Icon.CHECK if done(step, snapshot) and step != view.step else None)

    def _step_style(self, current: Step, shown: list[Step]) -> str:
        rules = "".join(_step_rules(self._steps[step], k, step == current) for k, step in enumerate(shown))
        narrow = "".join(
            f"{by_id(self._steps[step]._impl.uuid)}{{width:{NARROW_PX[step]}px!important;"
            f"left:{LEFT_PX + sum(NARROW_PX[before] for before in shown[:k])}px}}"
            for k, step in enumerate(shown)
        )
        return f"<style>{rules}@media(max-width:{NARROW_WINDOW_PX}px){{{narrow}}}</style>"


def _step_rules(handle: Any, place: int, current: bool) -> str:
    at = by_id(handle._impl.uuid)
    ink, line, weight = ("accent", "inset 0 -3px 0 var(--accent)", 650) if current else ("ink2", "none", 500)
    return (
        f"{at}{{position:fixed;z-index:3;left:{LEFT_PX + place * STEP_PX}px;top:0;width:{STEP_PX}px!important;"
        f"height:{HEADER_PX}px!important;background:transparent!important;color:var(--{ink})!important;"
        f"border:0!important;border-radius:0!important;box-shadow:{line}!important;padding:0!important}}"
        f"{at} .mantine-Button-label{{font-size:14.5px!important;font-weight:{weight}!important}}"
        f"{at}:hover{{background:var(--fill)!important}}"
        f"{at}[data-disabled]{{color:var(--ink3)!important;opacity:.6;background:transparent!important;border:0!important}}"
        f"div:has(>{at}){{height:0;padding:0!important;margin:0!important}}"
    )


def _stop_rules(at: str) -> str:
    """Stop has its place whether it can be pressed or not, so that a hand finds it."""
    return (
        f"{at}{{position:fixed;z-index:3;right:{STOP_RIGHT_PX}px;top:11px;width:{STOP_PX}px!important;height:34px!important;"
        f"padding:0!important;background:transparent!important;border:1px solid var(--line)!important;"
        f"color:var(--ink3)!important}}"
        f"{at}:not([data-disabled]){{background:var(--fault-soft)!important;border-color:var(--fault)!important;"
        f"color:var(--fault)!important}}"
        f"div:has(>{at}){{height:0;padding:0!important;margin:0!important}}"
    )


def _mark(snapshot: Snapshot) -> str:
    data = snapshot.dataset
    if data is None:
        sign, name = "", "New scan" if snapshot.draft.job else "No dataset open"
    else:
        sign, name = '<em class="wv-sim">SIMULATED</em>' if data.simulated else "", data.path.stem
    words = f'<b>Wafer Viewer{sign}</b><small title="{safe(name)}">{safe(name)}</small>'
    return f'<div class="wv-mark">{_MARK}<div>{words}</div></div>'


def _state(snapshot: Snapshot, view: View) -> str:
    rig = snapshot.rig
    where = "".join(
        f"{axis}&nbsp;<span>{number(um / 1000, 4, signed=True)}</span> "
        for axis, um in (("X", rig.x_um), ("Y", rig.y_um), ("Z", rig.z_um))
    )
    switch = icon(viser.Icon.SUN if view.dark else viser.Icon.MOON, 19)
    name = "Light" if view.dark else "Dark"
    return (
        f'<div class="wv-state"><div>{_pill(rig)}<div class="wv-where">{where}{THIN}mm</div></div>'
        f'<span class="wv-switch" title="{name} page" aria-label="{name} page" {pick("theme")}>{switch}</span></div>'
    )


def _pill(rig: RigStatus) -> str:
    """REAL in the colour of the state; SIMULATED always amber, unless the rig is at fault."""
    tone = _TONE[rig.state]
    colour = "simulated" if rig.simulated and tone != "fault" else tone
    word = "SIMULATED" if rig.simulated else "REAL"
    return (
        f'<span class="wv-pill {colour}" title="{safe(rig.message)}"><i></i><span><em>{word}</em> · '
        f'<u title="{safe(rig.name)}">{safe(rig.name)}</u> · {safe(rig.state)}</span></span>'
    )
