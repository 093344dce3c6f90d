"""Header with dataset, steps of work, Stop and rig; status bar; and the note after a restart."""

from __future__ import annotations

import datetime
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, number, plural, share
from wafer_viewer.gui.dialogs.control_handover import control_question
from wafer_viewer.gui.dialogs.stop import can_stop, stop
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.work_steps import STEPS, TITLES, done, why_not
from wafer_viewer.gui.state.view_state import Step, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.job import Job
from wafer_viewer.session.rendering.render_request import Statistics
from wafer_viewer.session.state.snapshot import ControlState, RigStatus, Snapshot, StitchingInfo, SurfaceInfo

NOT_CONFIRMED, FAILED = "The sample is not confirmed", "The header was not drawn"


def header(here: Here[None]) -> Elements:
    """Return header, status bar, and the question of a browser that asks for the controls."""
    snapshot, view = here.snapshot, here.view
    key = here.page.browser.key
    bar = Markup('<div class="wv-hd">{}{}</div>').format(_mark(snapshot), _state(snapshot, view))
    parts = bar, steps_of(snapshot, view.step), stop_button(snapshot), _status(here), control_question(snapshot, key)
    return [Html(part, padded=False) for part in parts]


def confirmation(here: Here[None]) -> Elements:
    """Return the request to confirm the sample on the stage, in the steps that move the rig."""
    waits = not here.snapshot.draft.confirmed and here.view.step in ("plan", "acquire")
    return [Html(_words(here.snapshot, here.view) if waits else "")]


def go_to(page: Page, step: Step) -> None:
    """Go to a step, or notify why it is not available yet."""
    if (why := why_not(step, page.session.snapshot)) is None:
        page.change(step=step, why=None)
    else:
        page.say(TITLES[step], f"Not yet: {why}", "attention")


def switch_theme(page: Page) -> None:
    """Change between light and dark colours, whatever the system has."""
    page.change(dark=not page.view.dark, theme_chosen=True)


HEADER_PICKS: Picks[None] = {
    "step": lambda here, key: go_to(here.page, next(step for step in STEPS if step == key)),
    "stop": lambda here, _: stop(here.page),
    "theme": lambda here, _: switch_theme(here.page),
}
CONFIRMATION_PICKS: Picks[None] = {
    "confirm-sample": lambda here, _: here.page.ask(NOT_CONFIRMED, here.page.session.jobs.confirm()),
}


def steps_of(snapshot: Snapshot, current: Step) -> Markup:
    """Return the steps of work, each with its tooltip; one that is not possible yet stays focusable for it."""
    steps = Markup("").join(_step(step, snapshot, step == current) for step in STEPS)
    return Markup('<nav class="wv-nav" aria-label="Steps of work">{}</nav>').format(steps)


def _step(step: Step, snapshot: Snapshot, present: bool) -> Markup:
    why, is_done = why_not(step, snapshot), done(step, snapshot)
    state = Markup(' aria-disabled="true" class="lock"') if why is not None else Markup()
    if present:
        state = Markup(' aria-current="step"')
    elif why is None and is_done:
        state = Markup(' class="done"')
    told = f"Not yet: {why}" if why is not None else "Done." if is_done else ""
    return Markup(
        '<div><button type="button" data-pick="step" data-k="{step}" aria-describedby="wv-tip-{step}"{state}>{icon}'
        '<b>{title}</b></button><div class="wv-tip" role="tooltip" id="wv-tip-{step}"><b>{title}</b><span>{told}</span>'
        "</div></div>"
    ).format(step=step, state=state, icon=html.icon(_ICONS[step], 20), title=TITLES[step], told=told)


def stop_button(snapshot: Snapshot) -> Markup:
    """Return Stop: red while the rig moves, grey at rest, struck out without a rig."""
    look = " out" if snapshot.rig.state in ("fault", "absent") else ""
    off = Markup() if can_stop(snapshot) else Markup(" disabled")
    icon = html.icon(viser.Icon.PLAYER_STOP, 16)
    return Markup('<button type="button" class="wv-stop{}" data-pick="stop"{}>{}<b>Stop</b></button>').format(
        look, off, icon
    )


def _status(here: Here[None]) -> Markup:
    """Return the status bar with sample, rig, calibration, surface, and holder of the controls."""
    snapshot, view, page = here.snapshot, here.view, here.page
    info = snapshot.surface if view.on_surface else None
    entries = [
        sample(job_shown(snapshot, view)),
        motion(snapshot.rig),
        calibration(snapshot, view, datetime.date.today()),
        *surface(info, page.statistics, view),
        placement(info),
        SLOW_GRAPHICS if page.draws_slowly else ("", "", ""),
    ]
    items = [_item(*words) for words in entries if words[0]]
    left = Markup("").join([*items, Markup('<span class="wv-xyz">{}</span>').format(where(snapshot, view))])
    right = _controls(snapshot.control, page.browser.key)
    return Markup('<div class="wv-strip" role="contentinfo"><div>{}</div>{}</div>').format(left, right)


_ICONS: dict[Step, Any] = {
    "plan": viser.Icon.LAYOUT_GRID,
    "acquire": viser.Icon.PLAYER_RECORD,
    "surface": viser.Icon.CHART_GRID_DOTS,
    "measure": viser.Icon.RULER_MEASURE,
    "gauge": viser.Icon.CERTIFICATE,
    "review": viser.Icon.LIST_CHECK,
    "report": viser.Icon.FILE_TEXT,
}
MARK = Markup(
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
    return Markup('<div class="wv-mark">{}<div>{}</div></div>').format(MARK, words)


def _state(snapshot: Snapshot, view: View) -> Markup:
    switch = html.icon(viser.Icon.SUN if view.dark else viser.Icon.MOON, 19)
    name = "Light" if view.dark else "Dark"
    return Markup(
        '<div class="wv-state"><div>{pill_over}<div class="wv-where">{where}</div></div>'
        '<span class="wv-switch" title="{name} page" aria-label="{name} page" {pick}>{switch}</span></div>'
    ).format(
        pill_over=_pill_over(snapshot, view),
        where=where(snapshot, view),
        name=name,
        pick=html.pick("theme"),
        switch=switch,
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
    """Return the rig's pill: REAL with name, in the colour of its state; SIMULATED in amber unless it is at fault."""
    tone = _TONE[rig.state]
    colour = "simulated" if rig.simulated and tone != "fault" else tone
    name = Markup() if rig.simulated else Markup('<u title="{name}">{name} · </u>').format(name=rig.name)
    return Markup('<span class="wv-pill {}" title="{}"><i></i><span><em>{}</em> · {}{}</span></span>').format(
        colour, f"{rig.name}. {rig.message}", "SIMULATED" if rig.simulated else "REAL", name, rig.state
    )


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
SLOW_GRAPHICS: Words = (
    *("Slow graphics", ""),
    "The browser draws without a graphics card: switch hardware acceleration on in its settings.",
)


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
        return "No calibration", "fault", "Lengths are uncalibrated: no U, no verdict."
    if made.simulated:
        return "Calibrated by simulation", "", "Pixel size and scales are the simulation's: nothing real is measured."
    days = (datetime.date.fromisoformat(made.due) - today).days
    more = f"Calibrated on {made.made} against {made.against}, due on {made.due}."
    if days < 0:
        return f"Calibration overdue by {plural(-days, 'day')}", "fault", more
    if days <= SOON_DAYS:
        return f"Calibration due {'today' if days == 0 else 'in ' + plural(days, 'day')}", "attention", more
    words = f"Calibrated, due in {plural(days, 'day')}" if days <= FAR_DAYS else f"Calibrated until {made.due}"
    return words, "", more


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


def _item(words: str, tone: str, more: str) -> Markup:
    tip = f"{words}. {more}" if more else words
    return Markup('<span class="{}" title="{}">{}</span>').format(tone, html.typeset(tip), words)


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


def _words(snapshot: Snapshot, view: View) -> Markup:
    data = snapshot.dataset
    name = sample(job_shown(snapshot, view))[0] or (data.path.stem if data is not None else "an unfinished plan")
    text = f"Reopened from last time: {name}. Another sample may be on the stage now."
    yes = html.command_link("It is this sample", "confirm-sample")
    sign = html.icon(viser.Icon.ALERT_TRIANGLE, 18)
    return html.note("attention", "Nothing moves before you confirm the sample", text, yes, sign)
