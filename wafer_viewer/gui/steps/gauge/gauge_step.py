"""The step Gauge check: verdict, evidence and terms of a check against gauge blocks, and the way to its signature."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, Literal

import viser
from markupsafe import Markup

from wafer_viewer.gui.elements.elements import PAUSE_S, Button, Buttons, Elements, Html, Stack
from wafer_viewer.gui.elements.form import form
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.measure.live_measurement import live_measurement
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters import gauge as words
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.gauge.gauge_check import BY_HAND, LIVE_STEP, next_point, selected_check, tick
from wafer_viewer.gui.steps.gauge.gauge_dialogs import (
    NO_CERTIFICATE,
    NOT_CORRECTED,
    NOT_SIGNED,
    certificate_dialog,
    correct_dialog,
    sign_check_dialog,
)
from wafer_viewer.gui.steps.gauge.gauge_study import STUDY_FAILED, study_dialog
from wafer_viewer.gui.tools.region_tools import default_faces, in_scene
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model import spec
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.model.region import Region
from wafer_viewer.session.state.snapshot import Snapshot

FACES = "faces of the blocks"
ICON = viser.Icon
FAILED, TERMS_FAILED = "The check was not changed", "The terms of the check were not changed"
NOT_FOUND, NOT_MEASURED, NOT_DROPPED = (
    "The faces were not found",
    "The step was not measured",
    "The repeat was not changed",
)
NO_SURFACE = "No surface of the blocks yet.", "Wring them and scan them, or open their dataset."
DRAG = "Drag the regions onto the two faces, then measure."
STUDY = "Share of the variation that comes from the gauge, by AIAG."
Surface = tuple[Path, int, int]
"""Dataset path, displayed field (0 for the stitched surface) and stamp of the surface."""
Lead = Literal["certificate", "measure", "sign", "new"]
"""Command of the leading (filled) button."""


@dataclass(frozen=True, slots=True)
class CheckInputs:
    """searched: surface whose faces were looked for, or were there. studies: result of the last study."""

    searched: Surface | None = None
    studies: Markup = Markup()


def gauge_step(here: Here[CheckInputs]) -> Elements | None:
    """Return the present check or the selected earlier one; find the faces, and measure again if they moved."""
    page, snapshot, view = here.page, here.snapshot, here.view
    if not view.checks_blocks or view.explains:
        return None
    _follow_surface(here)
    live = live_measurement(page, LIVE_STEP, snapshot, in_scene(view))
    earlier, gauge = selected_check(snapshot, view), snapshot.gauge
    check = earlier or gauge.signed or gauge.check
    own = earlier is None
    step = live.value if isinstance(live.value, StepHeight) and own else None
    state = _state(here, live.problem if step is None else "") if own else Markup()
    verdict = words.verdict_card(check) + words.result(check) if check is not None else Markup()
    taken = gauge.repeats if earlier is None else earlier.repeats
    paper = gauge.certificate if earlier is None else earlier.certificate
    offered, icon = gauge.correction if own else None, ICON.ARROWS_VERTICAL
    correct = Button(
        "Correct the z scale…",
        partial(correct_scale, page),
        icon,
        commands=True,
        action="Scale of z corrected",
        failed=NOT_CORRECTED,
    )
    return [
        Html(_title(earlier)),
        Html(page.notes(snapshot)),
        Html(state),
        Html(verdict),
        Html(words.repeats(taken, check, own and bool(taken)) + words.certificate(paper, date.today())),
        Stack(_terms(here), failed=TERMS_FAILED) if own else None,
        Html(_sums(snapshot, view, check, step, own=own)),
        Html(words.correction(offered)),
        Buttons([correct]) if offered is not None else None,
        Html(html.head("Repeatability and reproducibility") + (here.own.studies or _WAITS)),
        Buttons([Button("Gauge R&R study…", lambda: ask_study(here), ICON.TABLE_IMPORT, failed=STUDY_FAILED)]),
        Html(Markup('<div style="height:10px"></div>')),
        Stack(_verbs(page, snapshot, view)) if own else None,
    ]


_WAITS = Markup('<div class="wv-lab" style="margin-bottom:6px">{}</div>').format(STUDY)


def gauge_commands(here: Here[CheckInputs]) -> list[Command]:
    """Return the commands of a check with their keys."""
    page = here.page

    def shown(_: Snapshot, view: View) -> bool:
        return view.checks_blocks

    def command(name: str, act: Callable[[], None], icon: Any) -> Command:
        return Command(name, None, act, icon, group="Gauge check")

    go_on = Command(
        "Next point of the check", "enter", partial(next_of, page), ICON.ARROW_RIGHT, group="Gauge check", here=shown
    )
    return [
        go_on,
        *with_precondition(
            require_step("gauge"),
            command("Measure the step", partial(measure, page), ICON.RULER_MEASURE),
            command("Find the faces", partial(find_again, here), ICON.SEARCH),
            command("Sign the check…", partial(sign, page), ICON.SIGNATURE),
            command("Certificate…", partial(certificate_dialog, page), ICON.CERTIFICATE),
            command("Begin a new check", partial(begin_anew, page), ICON.PLUS),
        ),
    ]


# --- the faces


def _follow_surface(here: Here[CheckInputs]) -> None:
    """Look for the faces on a surface that has none of its dataset yet."""
    surface, before = _surface(here.snapshot, here.view), here.own.searched
    if surface is None or surface == before:
        return
    here.own = replace(here.own, searched=surface)
    of_another = before is not None and before[0] != surface[0]
    if of_another or not here.view.faces:
        search_faces(here)


def _surface(snapshot: Snapshot, view: View) -> Surface | None:
    """Return the key of the displayed surface; None without one, or during a scan."""
    data = snapshot.dataset
    if data is None or snapshot.surface is None or snapshot.scanning:
        return None
    return data.path, max(0, view.show), snapshot.surface.stamp


def search_faces(here: Here[Any]) -> None:
    """Look for the two faces, which replace the present regions."""
    page = here.page

    def find() -> tuple[Region, ...]:
        faces = page.session.gauge.find_faces(max(0, page.view.show))
        page.change(faces=faces)
        return faces

    here.ask(FACES, object(), find, NOT_FOUND)


def find_again(here: Here[CheckInputs]) -> None:
    """Look for the faces of the displayed surface again."""
    surface = _surface(here.page.session.snapshot, here.page.view)
    if surface is not None:
        here.own = replace(here.own, searched=surface)
        search_faces(here)
        here.page.redraw()


def _place_by_hand(page: Page) -> None:
    """Place the regions at default positions, to be dragged by hand."""
    if (info := page.session.snapshot.surface) is not None:
        page.change(faces=default_faces(info))


# --- what a person does


def next_of(page: Page) -> None:
    """Carry out the next point of the procedure, or ask for the certificate if it is missing."""
    snapshot = page.session.snapshot
    point = next_point(snapshot)
    if point is None:
        begin_anew(page)
    elif point.name in BY_HAND:
        tick(page, point.name)
    elif point.name == "scan":
        page.change(step="plan")
    elif snapshot.gauge.certificate is None:
        certificate_dialog(page)
    elif point.name == "faces":
        measure(page)
    else:
        sign(page)


def measure(page: Page) -> None:
    """Measure the step between the regions and add it as a repeat."""
    view = page.view
    upper, lower = view.faces or (None, None)
    taken = page.session.gauge.add_repeat(upper, lower, max(0, view.show))
    page.ask(NOT_MEASURED, taken, lambda _: page.change(check=None))


def sign(page: Page) -> None:
    """Show the present check, and open the dialog that signs it."""
    if (check := page.session.snapshot.gauge.check) is not None:
        page.change(check=None)
        sign_check_dialog(page, check)


def correct_scale(page: Page) -> None:
    """Open the dialog that corrects the z scale, if a correction is proposed."""
    if (offered := page.session.snapshot.gauge.correction) is not None:
        correct_dialog(page, offered)


def begin_anew(page: Page) -> None:
    """Start a new check of the same blocks."""
    page.ask(FAILED, page.session.gauge.clear(), lambda _: page.change(check=None))


def ask_study(here: Here[CheckInputs]) -> None:
    """Open the dialog that reads a study."""
    study_dialog(here.page, lambda studies: here.keep(studies=studies))


def _drop(here: Here[CheckInputs], number: str) -> None:
    here.page.ask(NOT_DROPPED, here.page.session.gauge.drop_repeat(int(number)))


GAUGE_PICKS: Picks[CheckInputs] = {"gauge-drop": _drop, "gauge-lay": lambda here, _: _place_by_hand(here.page)}


def leading_verb(snapshot: Snapshot) -> Lead:
    """Return the command of the leading button."""
    gauge = snapshot.gauge
    if gauge.signed is not None:
        return "new"
    if gauge.check is not None:
        return "sign"
    return "certificate" if gauge.certificate is None else "measure"


def why_not(snapshot: Snapshot, view: View, verb: Lead) -> str | None:
    """Return the reason why a command is not possible now, to follow "Not yet:"; None if it is."""
    gauge, data = snapshot.gauge, snapshot.dataset
    if verb == "measure":
        if gauge.busy:
            return "a repeat is being measured."
        if snapshot.surface is None:
            return "there is no surface to measure on."
        return gauge.refusal or (None if view.faces else "the regions do not lie on the faces yet.")
    if verb == "sign" and data is not None and data.read_only is not None:
        return data.read_only
    return None


# --- what is shown


def _title(earlier: GaugeCheck | None) -> Markup:
    if earlier is None:
        return html.title("Gauge check", "Two gauge blocks, step against the certificate.")
    back = Markup('<span class="wv-action" {}>Back to this check</span>').format(html.pick("gauge-record", earlier.at))
    return html.title("Earlier check", f"Signed by {earlier.signed_by}, {words.day_and_time(earlier.at)}.", back)


def _state(here: Here[CheckInputs], problem: str) -> Markup:
    """Return what keeps the check from its next step; `problem`: why the step between the faces is not measured."""
    gauge, faces, found = here.snapshot.gauge, here.view.faces, here.ask.known(FACES)
    if gauge.refusal is not None:
        return words.rejected_scan_note(gauge.refusal, bool(gauge.repeats))
    if here.snapshot.surface is None and not gauge.repeats:
        return html.empty(*NO_SURFACE)
    if found.computing:
        return html.empty("Finding the two faces.")
    if found.problem and not faces:
        return html.note("attention", NOT_FOUND, found.problem, html.link("Place the regions by hand", "gauge-lay"))
    if faces and problem:
        return html.note("attention", "Nothing is measured there", problem)
    return html.empty(DRAG) if gauge.check is None and gauge.signed is None and faces else Markup()


def _terms(here: Here[CheckInputs]) -> Elements:
    page, terms = here.page, here.snapshot.gauge.terms

    def put(field: str, value: Any) -> Future[Any]:
        changed = page.session.gauge.set_terms(spec.replace(page.session.snapshot.gauge.terms, **{field: value}))
        page.ask(TERMS_FAILED, changed)
        return changed

    fields = "limit_um", "least_repeats", "temperature_c", "tolerance_um", "interval_days"
    return [Html(html.head("Terms")), *form(terms, put, *fields, commands=True, pause_s=PAUSE_S)]


def _sums(snapshot: Snapshot, view: View, check: GaugeCheck | None, step: StepHeight | None, *, own: bool) -> Markup:
    upper, lower = (check.upper, check.lower) if check is not None else view.faces or (None, None)
    shown = words.conditions(step, check, upper, lower)
    if check is not None:
        shown += words.budget(check) + words.not_evaluated(check)
    return shown + (words.capability(snapshot.gauge.capability) if own else Markup())


def _verbs(page: Page, snapshot: Snapshot, view: View) -> Elements:
    """Return the buttons at the foot, with the reason above them why the leading one is not possible."""
    lead = leading_verb(snapshot)
    why = why_not(snapshot, view, lead)
    may_measure = bool(snapshot.gauge.repeats) and why_not(snapshot, view, "measure") is None
    leads: dict[Lead, tuple[str, Callable[[], None], Any, str]] = {
        "certificate": ("Load the certificate…", partial(certificate_dialog, page), ICON.CERTIFICATE, NO_CERTIFICATE),
        "measure": ("Measure the step", partial(measure, page), ICON.RULER_MEASURE, NOT_MEASURED),
        "sign": ("Sign and save", partial(sign, page), ICON.SIGNATURE, NOT_SIGNED),
        "new": ("New check", partial(begin_anew, page), ICON.PLUS, FAILED),
    }
    label, act, icon, failed = leads[lead]
    again = Button("Measure again", partial(measure, page), ICON.REFRESH, disabled=not may_measure, commands=True)
    other = Button(
        "Certificate…", partial(certificate_dialog, page), ICON.CERTIFICATE, commands=True, failed=NO_CERTIFICATE
    )
    return [
        Html(html.why_not(why)),
        Buttons([again, other], 34, at_foot=True),
        Button(label, act, icon, "leading", disabled=why is not None, commands=True, failed=failed, key=lead),
    ]
