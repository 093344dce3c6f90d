"""Status bar, and the note after a restart that asks to confirm the sample."""

from __future__ import annotations

import datetime

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, number, share
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import surface as stitching
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.job import Job
from wafer_viewer.session.rendering.render_request import Statistics
from wafer_viewer.session.state.snapshot import ControlState, RigStatus, Snapshot, SurfaceInfo

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
        left = Markup("").join([*items, Markup('<span class="wv-xyz">{}</span>').format(where(snapshot.rig))])
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


def where(rig: RigStatus) -> Markup:
    """Return the stage position in mm as HTML, for the header, or for the status bar in narrow windows."""
    axes = (("X", rig.x_um), ("Y", rig.y_um), ("Z", rig.z_um))
    position = Markup("").join(
        Markup("{}&nbsp;<span>{}</span> ").format(axis, number(um / 1000, 4, signed=True)) for axis, um in axes
    )
    return position + f"{THIN}mm"


def placement(info: SurfaceInfo | None) -> Words:
    """Return the number of fields placed by the stage alone; empty if there are none."""
    if info is None or info.stitching is None:
        return "", "", ""
    words, reasons = stitching.by_stage(info.stitching, info.n_fields)
    return words, "attention" if words else "", reasons


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
