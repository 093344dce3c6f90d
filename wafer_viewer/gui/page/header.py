"""Header and status bar: dataset, workflow steps, rig, sample, calibration; and the note after a restart."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, number, share
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.stop import can_stop
from wafer_viewer.gui.state.view_state import Step, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Gui, HtmlBlock, add_html, button, set_prop
from wafer_viewer.gui.widgets.html import icon, pick
from wafer_viewer.gui.widgets.style import HEADER_PX, LEFT_PX, by_id
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.job import Job, keys_under_review
from wafer_viewer.session.rendering.render_request import Statistics
from wafer_viewer.session.state.snapshot import ControlState, RigStatus, Snapshot, StitchingInfo, SurfaceInfo

# ----------------------------------------------------------------------------------------------------------- status bar


SOON_DAYS = 14
"""A calibration that is due within this many days gets a warning."""
FAR_DAYS = 400
_MOTION = {
    "ready": "at rest",
    "moving": "moving",
    "working": "at work",
    "scanning": "scanning",
    "paused": "paused",
    "stopping": "stopping",
    "starting": "starting",
    "fault": "at fault",
    "absent": "not connected",
}
Words = tuple[str, str, str]
"""Text, tone ('' for none) and tooltip of an item."""


class StatusStrip:
    """Status bar with sample, rig, calibration, surface, and holder of the controls."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._strip = HtmlBlock(page.gui, padded=False)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the status bar."""
        today = datetime.date.today()
        entries = [
            sample(job_shown(snapshot, view)),
            motion(snapshot.rig),
            calibration(snapshot, view, today),
            *surface(snapshot.surface if view.on_surface else None, self._page.statistics, view),
            placement(snapshot.surface if view.on_surface else None),
        ]
        items = [_item(*words) for words in entries if words[0]]
        left = Markup("").join([*items, Markup('<span class="wv-xyz">{}</span>').format(where(snapshot, view))])
        right = _controls(snapshot.control, self._page.browser.key)
        self._strip.show(Markup('<div class="wv-strip" role="contentinfo"><div>{}</div>{}</div>').format(left, right))


def job_shown(snapshot: Snapshot, view: View) -> Job | None:
    """Return the job in view: the draft in Plan or without a dataset, else the dataset's."""
    if view.step == "plan" or snapshot.dataset is None:
        return snapshot.draft.job
    return snapshot.dataset.job


def sample(job: Job | None) -> Words:
    """Return lot, wafer and job revision; empty without a job."""
    if job is None:
        return "", "", ""
    names = [f"{word} {name}" for word, name in (("Lot", job.sample.lot), ("Wafer", job.sample.wafer_id)) if name] or [
        job.sample.name or "Unnamed sample"
    ]
    if job.product or job.revision:
        names.append(" ".join(w for w in ("Job", job.product, job.revision and f"rev. {job.revision}") if w))
    return " · ".join(names), "", "released" if job.released else "not released"


def motion(rig: RigStatus) -> Words:
    """Return homing and motion state of the rig."""
    word = _MOTION[rig.state]
    if rig.state in ("fault", "absent"):
        return f"Rig {word}", "fault", rig.message
    if rig.homed is False:
        return f"Not homed · {word}", "attention", "The axes have no reference: home them before a move."
    return (f"Homed · {word}" if rig.homed else f"Rig {word}"), "busy" if rig.state != "ready" else "", rig.message


def calibration(snapshot: Snapshot, view: View, today: datetime.date) -> Words:
    """Return the calibration state: of the dataset if it is shown and uncalibrated, else of the rig."""
    data = snapshot.dataset
    if view.on_surface and data is not None and data.calibration_problem is not None:
        return "Uncalibrated", "fault", f"Lengths have no U and no verdict: {data.calibration_problem}."
    if snapshot.rig.state in ("starting", "absent"):
        return "", "", ""
    return calibration_due(snapshot.rig.calibration, today)


def calibration_due(made: Calibration | None, today: datetime.date) -> Words:
    """Return the days until a calibration is due."""
    if made is None:
        return "No calibration", "fault", "Lengths read 'uncalibrated': no U, no verdict."
    if made.simulated:
        return "Calibrated by simulation", "", "Pixel size and scales are the simulation's: nothing real is measured."
    days = (datetime.date.fromisoformat(made.due) - today).days
    more = f"Calibrated on {made.made} against {made.against}, due on {made.due}."
    if days < 0:
        return f"Calibration overdue by {_days(-days)}", "fault", more
    if days <= SOON_DAYS:
        return f"Calibration due {'today' if days == 0 else f'in {_days(days)}'}", "attention", more
    return (f"Calibrated, due in {_days(days)}" if days <= FAR_DAYS else f"Calibrated until {made.due}"), "", more


def surface(
    info: SurfaceInfo | None, statistics: Statistics | None = None, view: View | None = None
) -> tuple[Words, Words]:
    """Return filter state and missing fraction of the heights; `statistics`: statistics of the displayed part."""
    if info is None:
        return ("", "", ""), ("", "", "")
    smooth = info.settled is not None and info.settled.levy.mode != "none"
    done = "Filtered heights" if smooth else "Measured heights"
    counted = statistics if statistics is not None else info
    if statistics is None and view is not None and view.show:
        return (done, "", f"Result {info.result}."), ("", "", "")
    filled = f", {share(counted.filled_fraction)} filled" if counted.filled_fraction else ", none filled"
    reasons = ", ".join(f"{why} {share(part)}" for why, part in counted.unmeasured)
    missing = 1.0 - counted.measured_fraction - counted.filled_fraction
    return (done + filled, "", f"Result {info.result}."), (f"{share(max(0.0, missing))} unmeasured", "", reasons)


def where(snapshot: Snapshot, view: View) -> Markup:
    """Return the stage position in mm as HTML, for the header, or for the status bar in narrow windows.

    Empty over data that were taken elsewhere.
    """
    rig = snapshot.rig
    if _taken_elsewhere(snapshot, view):
        return Markup()
    axes = (("X", rig.x_um), ("Y", rig.y_um), ("Z", rig.z_um))
    position = Markup("").join(
        Markup("{}&nbsp;<span>{}</span> ").format(axis, number(um / 1000, 4, signed=True)) for axis, um in axes
    )
    return position + f"{THIN}mm"


def placement(info: SurfaceInfo | None) -> Words:
    """Return the number of fields placed by the stage alone; empty if there are none."""
    if info is None or info.stitching is None:
        return "", "", ""
    words, reasons = by_stage(info.stitching, info.n_fields)
    return words, "attention" if words else "", reasons


def by_stage(info: StitchingInfo, n_fields: int) -> tuple[str, str]:
    """Return status text and notes on fields placed by the stage alone; both empty if there are none."""
    if not info.n_by_stage:
        return "", ""
    reasons = "; ".join(note for note in info.notes if "the stage" in note)
    if not info.n_believed:
        return "Stitched by the stage alone", reasons
    return f"{number(info.n_by_stage, 0)} of {number(n_fields, 0)} fields by the stage alone", reasons


def _days(days: int) -> str:
    return f"{days} day{'' if days == 1 else 's'}"


def _item(words: str, tone: str, more: str) -> Markup:
    tip = f"{words}. {more}" if more else words
    return Markup('<span class="{}" title="{}">{}</span>').format(tone, html.with_micro_sign(tip), words)


def _controls(control: ControlState, key: str) -> Markup:
    """Return the holder of the controls; a click opens the list of browsers."""
    if control.browser(key) is None:
        return Markup()
    watching = len([b for b in control.browsers if b.present]) - (1 if control.holder else 0)
    others = f" · {watching} watch{'es' if watching == 1 else ''}" if watching > 0 and control.holds(key) else ""
    me = f"{control.name_of(key)}, {control.role_of(key)}: you hold" if control.is_signed_in(key) else "You hold"
    who = f"{me} the controls" if control.holds(key) else (control.why_not(key) or "").rstrip(".")
    sign = html.icon(viser.Icon.HAND_STOP if control.holds(key) else viser.Icon.EYE, 14)
    look = "mine" if control.holds(key) else "theirs"
    label = Markup('title="{}: who is there, your name, and how to ask for the controls" {}').format(
        who, html.pick("hands")
    )
    return Markup('<span class="wv-hand {look}" {label}>{sign}{who}</span>').format(
        look=look, label=label, sign=sign, who=who + others
    )


class Reopened:
    """Request to confirm the sample on the stage, in the steps that move the rig."""

    def __init__(self, page: Page) -> None:
        self._note = HtmlBlock(page.gui)
        failed = "The sample is not confirmed"
        page.on_pick("confirm-sample", lambda _: page.ask(failed, page.session.jobs.confirm()))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the note until the sample is confirmed."""
        waits = not snapshot.draft.confirmed and view.step in ("plan", "acquire")
        self._note.show(_words(snapshot, view) if waits else "")


def _words(snapshot: Snapshot, view: View) -> Markup:
    data = snapshot.dataset
    name = sample(job_shown(snapshot, view))[0] or (data.path.stem if data is not None else "an unfinished plan")
    text = f"Reopened from last time: {name}. Another sample may be on the stage now."
    yes = Markup('<span class="wv-link" {}>It is this sample</span>').format(html.command_pick("confirm-sample"))
    sign = html.icon(viser.Icon.ALERT_TRIANGLE, 18)
    return html.note("attention", "Nothing moves before you confirm the sample", text, yes, sign)


# --------------------------------------------------------------------------------------------------------------- header


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
    """Header layout for a range of window widths: start of the steps and width of an icon, in CSS pixels.

    named: the current step has its name beside its icon.
    """

    media: str
    left_px: int
    icon_px: int
    named: bool = True


WIDE_PX, MIDDLE_PX, NARROW_PX = 1500, 1200, 944
"""Window widths from which steps show their names, icons are wider, and the current step its name beside its icon."""
ROOMS = (
    HeaderRoom(f"(min-width:{MIDDLE_PX}px) and (max-width:{WIDE_PX - 1}px)", LEFT_PX, 52),
    HeaderRoom(f"(min-width:{NARROW_PX}px) and (max-width:{MIDDLE_PX - 1}px)", 218, 42),
    HeaderRoom(f"(max-width:{NARROW_PX - 1}px)", 172, 36, named=False),
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
        widths = [_NAMED_PX[step] if step == current and room.named else room.icon_px for step in ids]
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
    hidden = f"{label}{{position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}}{sign}{{margin:0}}"
    if step == current:
        look = "color:var(--accent)!important;box-shadow:inset 0 -3px 0 var(--accent)!important"
        return (
            f"{selector}{{{look}}}{label}{{font-weight:650!important}}@media(max-width:{NARROW_PX - 1}px){{{hidden}}}"
        )
    can = possible(step, snapshot)
    look = "color:var(--ink)!important" if can else "color:var(--ink3)!important;cursor:default"
    rules = f"{selector}{{{look}}}{label}{{font-weight:{500 if can else 400}!important}}"
    rules += f"@media(max-width:{WIDE_PX - 1}px){{{hidden}}}"
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
    switch = icon(viser.Icon.SUN if view.dark else viser.Icon.MOON, 19)
    name = "Light" if view.dark else "Dark"
    return Markup(
        '<div class="wv-state"><div>{pill_over}<div class="wv-where">{where}</div></div>'
        '<span class="wv-switch" title="{name} page" aria-label="{name} page" {pick}>{switch}</span></div>'
    ).format(
        pill_over=_pill_over(snapshot, view), where=where(snapshot, view), name=name, pick=pick("theme"), switch=switch
    )


def _pill_over(snapshot: Snapshot, view: View) -> Markup:
    """Return the status pill: of imported data if they are shown and the rig is at rest, else of the rig."""
    rig = snapshot.rig
    if not _taken_elsewhere(snapshot, view):
        return _pill(rig)
    state = f"{rig.name}{', simulated' if rig.simulated else ''}: {rig.state}"
    title = f"The data were taken elsewhere. {state}."
    return Markup(
        '<span class="wv-pill imported" title="{}"><i></i><span><em>Imported</em> · no rig</span></span>'
    ).format(title)


def _taken_elsewhere(snapshot: Snapshot, view: View) -> bool:
    """Return whether imported data are shown while the rig is at rest."""
    data, at_rest = snapshot.dataset, snapshot.rig.state in ("starting", "ready", "absent")
    return data is not None and data.imported and not data.simulated and view.on_surface and at_rest


def _pill(rig: RigStatus) -> Markup:
    """Return the rig's pill: REAL in the colour of its state, SIMULATED in amber unless the rig is at fault."""
    tone = _TONE[rig.state]
    colour = "simulated" if rig.simulated and tone != "fault" else tone
    word = "SIMULATED" if rig.simulated else "REAL"
    return Markup(
        '<span class="wv-pill {colour}" title="{message}"><i></i><span><em>{word}</em> · '
        '<u title="{name}">{name} · </u>{state}</span></span>'
    ).format(colour=colour, message=rig.message, word=word, name=rig.name, state=rig.state)
