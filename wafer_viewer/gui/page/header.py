"""Page header: open dataset, workflow steps, rig and whether it is real."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.status_bar import where
from wafer_viewer.gui.page.stop import can_stop
from wafer_viewer.gui.state.view_state import Step, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Gui, HtmlBlock, add_html, button, set_prop
from wafer_viewer.gui.widgets.html import icon, pick
from wafer_viewer.gui.widgets.style import HEADER_PX, LEFT_PX, by_id
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.job import keys_under_review
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

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
_ICONS: dict[Step, Any] = {
    "plan": viser.Icon.LAYOUT_GRID,
    "acquire": viser.Icon.PLAYER_RECORD,
    "surface": viser.Icon.CHART_GRID_DOTS,
    "measure": viser.Icon.RULER_MEASURE,
    "gauge": viser.Icon.CERTIFICATE,
    "review": viser.Icon.LIST_CHECK,
    "report": viser.Icon.FILE_TEXT,
}
_NAMED_PX: dict[Step, int] = {
    "plan": 82,
    "acquire": 104,
    "surface": 104,
    "measure": 108,
    "gauge": 134,
    "review": 102,
    "report": 100,
}
"""Width of the current step with icon and name, in layouts where the other steps are icons."""


@dataclass(frozen=True, slots=True)
class HeaderRoom:
    """Header layout for a range of window widths: start of the steps and width of an icon, in CSS pixels."""

    media: str
    left_px: int
    icon_px: int


WIDE_PX, MIDDLE_PX = 1500, 1200
"""Window widths from which steps show their names, and from which icons are wider."""
ROOMS = (
    HeaderRoom(f"(min-width:{MIDDLE_PX}px) and (max-width:{WIDE_PX - 1}px)", LEFT_PX, 52),
    HeaderRoom(f"(max-width:{MIDDLE_PX - 1}px)", 218, 42),
)
_MARK = Markup(
    '<svg width="34" height="34" viewBox="0 0 34 34" aria-hidden="true"><g fill="none" stroke="var(--accent)">'
    '<circle cx="17" cy="17" r="15.5" stroke-width="2"/>'
    '<path d="M4 21h6l2.5-9H21l2.5 9H30" stroke-width="2.6" stroke-linejoin="round"/></g></svg>'
)
_TONE = {
    "ready": "good",
    "starting": "busy",
    "moving": "busy",
    "working": "busy",
    "scanning": "busy",
    "paused": "busy",
    "stopping": "busy",
    "fault": "fault",
    "absent": "fault",
}


def possible(step: Step, snapshot: Snapshot) -> bool:
    """Return whether a step is available."""
    data = snapshot.dataset
    match step:
        case "plan" | "gauge":
            return True
        case "acquire":
            lacks = data is not None and (not data.finished or bool(data.damaged))
            return snapshot.scanning or snapshot.scan is not None or lacks
        case "surface":
            return data is not None and (data.finished or bool(data.stamps))
        case "measure" | "review" | "report":
            return snapshot.surface is not None


def why_not(step: Step, snapshot: Snapshot) -> str | None:
    """Return why a step is not available yet, or None if it is."""
    if possible(step, snapshot):
        return None
    data = snapshot.dataset
    if step == "acquire":
        return "no scan runs, and the open dataset lacks no frame." if data is not None else "no scan runs."
    if data is None:
        return "no dataset is open."
    has_heights = bool(data.stamps)
    return "no field has heights." if step == "surface" or not has_heights else "the fields are not stitched."


def done(step: Step, snapshot: Snapshot) -> bool:
    """Return whether a step is done and has a tick."""
    data = snapshot.dataset
    return (
        data is not None
        and {
            "plan": True,
            "acquire": data.finished and not data.damaged and not snapshot.scanning,
            "surface": bool(_under_review(snapshot)),
            "measure": bool(snapshot.notebook.book.judgements),
            "gauge": any(isinstance(finding, GaugeCheck) for finding in snapshot.findings),
            "review": all_judged(snapshot),
            "report": False,
        }[step]
    )


def all_judged(snapshot: Snapshot) -> bool:
    """Return whether all results, verdict features and defects are accepted or rejected; False without any."""
    keys, defects = _under_review(snapshot), snapshot.inspection.defects
    noted = snapshot.notebook.book.judged(keys) == len(keys)
    return bool(keys or defects) and noted and all(defect.judgement != "open" for defect in defects)


def _under_review(snapshot: Snapshot) -> tuple[str, ...]:
    return keys_under_review(snapshot.operating.verdict, snapshot.findings)


class Header:
    """Header bar: logo, dataset, steps, Stop, rig. CSS places viser's buttons for steps and Stop over the bar."""

    def __init__(self, gui: Gui, go_to: Callable[[Step], None], stop: Callable[[], None]) -> None:
        self._stop = button(gui, "Stop", viser.Icon.PLAYER_STOP, lambda _: stop(), disabled=True)
        stop_at = by_id(self._stop._impl.uuid)
        self._stop_style = HtmlBlock(gui, padded=False)
        steps: dict[Step, Any] = {
            step: button(gui, TITLES[step], _ICONS[step], lambda _, s=step: go_to(s)) for step in STEPS
        }
        self._ids: dict[Step, str] = {step: handle._impl.uuid for step, handle in steps.items()}
        places = _places(stop_at, {step: by_id(uuid) for step, uuid in self._ids.items()})
        add_html(gui, html.style_sheet(places))
        self._stop_at = stop_at
        self._bar = HtmlBlock(gui, padded=False)
        self._style = HtmlBlock(gui, padded=False)
        self._tips = HtmlBlock(gui, padded=False)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the header."""
        self._bar.show(Markup('<div class="wv-hd">{}{}</div>').format(_mark(snapshot), _state(snapshot, view)))
        self._style.show(html.style_sheet(_step_style(self._ids, view.step, snapshot)))
        self._tips.show(_tips(self._ids, view.step, snapshot))
        set_prop(self._stop, "disabled", not can_stop(snapshot))
        out = f"{self._stop_at} .mantine-Button-label{{text-decoration:line-through}}"
        self._stop_style.show(html.style_sheet(out) if snapshot.rig.state in ("fault", "absent") else Markup())


def _places(stop: str, steps: dict[Step, str]) -> str:
    """Return the CSS position of Stop and the steps, independent of state; widths are variables of page.css."""
    each = ",".join(steps.values())
    return (
        f"div:has(>:is({each},{stop})){{height:0;padding:0!important;margin:0!important}}"
        f"{stop}{{position:fixed;z-index:4;right:calc(var(--stop-right) - 96px);top:9px;width:96px!important;"
        f"height:38px!important;padding:0!important;background:transparent!important;color:var(--ink3)!important;"
        f"border:1px solid var(--line)!important}}"
        f"{stop}:not([data-disabled]){{background:var(--fault-soft)!important;border-color:var(--fault)!important;"
        f"color:var(--fault)!important}}"
        f"body.wv-no-contact {stop} .mantine-Button-label{{text-decoration:line-through}}"
        f":is({each}){{position:fixed;z-index:3;top:0;height:{HEADER_PX}px!important;background:transparent!important;"
        f"border:0!important;border-radius:0!important;padding:0!important}}"
        f":is({each}):hover{{background:var(--fill)!important}}"
        f":is({each}) .mantine-Button-label{{font-size:14.5px!important}}"
        f":is({each}) .mantine-Button-section{{position:relative;font-size:20px}}"
        f"@media(min-width:{WIDE_PX}px){{:is({each}) .mantine-Button-section{{display:none}}}}"
    )


def _step_style(ids: dict[Step, str], current: Step, snapshot: Snapshot) -> str:
    """Return CSS of the steps: colours and marks by state, and positions around the current step's name."""
    rules = [_look(by_id(uuid), step, current, snapshot) for step, uuid in ids.items()]
    places = [f"left:calc({LEFT_PX}px + {k}*var(--step));width:var(--step)!important" for k in range(len(ids))]
    rules.append(f"@media(min-width:{WIDE_PX}px){{{_placed(ids, places)}}}")
    for room in ROOMS:
        widths = [_NAMED_PX[step] if step == current else room.icon_px for step in ids]
        lefts = [room.left_px + sum(widths[:k]) for k in range(len(widths))]
        places = [f"left:{left}px;width:{width}px!important" for left, width in zip(lefts, widths, strict=True)]
        rules.append(f"@media{room.media}{{{_placed(ids, places)}}}")
    return "".join(rules)


def _placed(ids: dict[Step, str], places: list[str]) -> str:
    """Return CSS that places each step, with its tooltip below."""
    each = zip(ids.items(), places, strict=True)
    return "".join(f"{by_id(uuid)}{{{place}}}#wv-tip-{step}{{{place.split(';')[0]}}}" for (step, uuid), place in each)


def _look(selector: str, step: Step, current: Step, snapshot: Snapshot) -> str:
    label, sign = f"{selector} .mantine-Button-label", f"{selector} .mantine-Button-section"
    if step == current:
        look = "color:var(--accent)!important;box-shadow:inset 0 -3px 0 var(--accent)!important"
        return f"{selector}{{{look}}}{label}{{font-weight:650!important}}"
    can = possible(step, snapshot)
    look = "color:var(--ink)!important" if can else "color:var(--ink3)!important;cursor:default"
    rules = f"{selector}{{{look}}}{label}{{font-weight:{500 if can else 400}!important}}"
    hidden = "position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)"
    rules += f"@media(max-width:{WIDE_PX - 1}px){{{label}{{{hidden}}}{sign}{{margin:0}}}}"
    mark = _LOCK if not can else _TICK if done(step, snapshot) else ""
    if not mark:
        return rules
    inline = "display:inline-block;width:13px;height:13px;margin-right:6px;vertical-align:-1px"
    corner = "position:absolute;right:-8px;top:-6px;width:12px;height:12px"
    return (
        f"{rules}@media(min-width:{WIDE_PX}px){{{label}::before{{{mark};{inline}}}}}"
        f"@media(max-width:{WIDE_PX - 1}px){{{sign}::after{{{mark};{corner}}}}}"
    )


def _mask(path: str) -> str:
    svg = (
        "%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 24 24' fill='none' stroke='%23000' stroke-width='3.4' "
        f"stroke-linecap='round' stroke-linejoin='round'%3E%3Cpath d='{path}'/%3E%3C/svg%3E"
    )
    return f"content:'';mask:url(\"data:image/svg+xml,{svg}\") center/contain no-repeat"


_LOCK = f"{_mask('M6 11h12v9H6zM8 11V8a4 4 0 0 1 8 0v3')};background:currentColor"
_TICK = f"{_mask('M4 13l5 5L20 6')};background:var(--good)"
"""Marks of a step, before its name or at the corner of its icon: not available yet, and done."""


def _tips(ids: dict[Step, str], current: Step, snapshot: Snapshot) -> Markup:
    """Return the tooltips of the steps, shown on hover and focus; accessible_names.js links them to the buttons."""
    tips, rules = "", ""
    for step, uuid in ids.items():
        why = why_not(step, snapshot)
        state = f"Not yet: {why}" if why is not None else "Done." if done(step, snapshot) else ""
        tip = f"wv-tip-{step}"
        linked = Markup('data-of="{}"{}{}').format(
            uuid,
            Markup() if why is None else Markup(' data-disabled="true"'),
            Markup(' data-current="step"') if step == current else Markup(),
        )
        tips += Markup('<div class="wv-tip" role="tooltip" id="{}" {}><b>{}</b><span>{}</span></div>').format(
            tip, linked, TITLES[step], state
        )
        rules += f"body:has({by_id(uuid)}:is(:hover,:focus-visible)) #{tip}{{visibility:visible}}"
    return html.style_sheet(rules) + tips


def _mark(snapshot: Snapshot) -> Markup:
    data = snapshot.dataset
    if data is None:
        sign, name = "", "New scan" if snapshot.draft.job else "No dataset open"
    else:
        alone = "" if snapshot.rig.simulated else " alone"  # the pill of the rig does not say it too
        sign, name = (
            Markup('<em class="wv-sim{}">SIMULATED</em>').format(alone) if data.simulated else Markup(),
            data.path.stem,
        )
    words = Markup('<b><span>Wafer Viewer</span>{}</b><small title="{}">{}</small>').format(sign, name, name)
    return Markup('<div class="wv-mark">{}<div>{}</div></div>').format(_MARK, words)


def _state(snapshot: Snapshot, view: View) -> Markup:
    rig = snapshot.rig
    switch = icon(viser.Icon.SUN if view.dark else viser.Icon.MOON, 19)
    name = "Light" if view.dark else "Dark"
    return Markup(
        '<div class="wv-state"><div>{pill_over}<div class="wv-where">{where}</div></div>'
        '<span class="wv-switch" title="{name} page" aria-label="{name} page" {pick}>{switch}</span></div>'
    ).format(pill_over=_pill_over(snapshot, view), where=where(rig), name=name, pick=pick("theme"), switch=switch)


def _pill_over(snapshot: Snapshot, view: View) -> Markup:
    """Return the status pill: of imported data if they are shown and the rig is at rest, else of the rig."""
    data, rig = snapshot.dataset, snapshot.rig
    at_rest = rig.state in ("starting", "ready", "absent")
    if data is None or not data.imported or data.simulated or not view.on_surface or not at_rest:
        return _pill(rig)
    state = f"{rig.name}{', simulated' if rig.simulated else ''}: {rig.state}"
    title = f"The data were taken elsewhere. {state}."
    return Markup(
        '<span class="wv-pill imported" title="{}"><i></i><span><em>Imported</em> · no rig</span></span>'
    ).format(title)


def _pill(rig: RigStatus) -> Markup:
    """Return the rig's pill: REAL in the colour of its state, SIMULATED in amber unless the rig is at fault."""
    tone = _TONE[rig.state]
    colour = "simulated" if rig.simulated and tone != "fault" else tone
    word = "SIMULATED" if rig.simulated else "REAL"
    return Markup(
        '<span class="wv-pill {colour}" title="{message}"><i></i><span><em>{word}</em> · '
        '<u title="{name}">{name} · </u>{state}</span></span>'
    ).format(colour=colour, message=rig.message, word=word, name=rig.name, state=rig.state)
