"""Start card and guided tour: a note that points at the next button, and a card with the results.

Completed steps follow from the state of session and view, no matter how they were carried out.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import duration, number, plural, size, with_unit
from wafer_viewer.gui.dialogs.import_dialog import import_dialog
from wafer_viewer.gui.dialogs.open_and_export import open_dialog
from wafer_viewer.gui.elements.elements import Button, Elements, Html
from wafer_viewer.gui.elements.step import Here, Overlay, Picks
from wafer_viewer.gui.overlays.hud import FIRST_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import Tour, View
from wafer_viewer.gui.steps.report import report_address
from wafer_viewer.gui.steps.review.judging import JUDGEMENTS
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.session.files.file_jobs import newest_report
from wafer_viewer.session.planning.guided_tour import is_tour
from wafer_viewer.session.state.snapshot import Snapshot

N_STEPS = 7
SCAN, LOOK, MEASURE, KEEP, INSPECT, JUDGE, REPORT = range(N_STEPS)


@dataclass(frozen=True, slots=True)
class Note:
    """Note of the tour: `button` is the label of the button it points at, `at` a selector for other elements.

    `text` is trusted HTML.
    """

    title: str
    text: str
    button: str = ""
    at: str = ""


def tour_guide(here: Here[None]) -> Elements:
    """Return the note of the present step of the tour, or its results; Escape ends it."""
    page, snapshot, view = here.page, here.snapshot, here.view
    tour = view.tour
    if tour is None or not is_tour(snapshot.draft.job):
        return [Html("", padded=False)]
    report = report_of(snapshot, tour)
    step = present_step(snapshot, view, report)
    if step < N_STEPS:
        return [Html(_note_html(note_of(step, snapshot, view), step), padded=False)]
    if tour.ended_s is None:
        tour = replace(tour, ended_s=time.time())
        page.change(tour=tour)
    return [Html(end_card(snapshot, tour, report), padded=False)]


def tour_commands(page: Page) -> list[Command]:
    """Return the commands that begin and end the tour."""

    def why_not(snapshot: Snapshot, _: View) -> str | None:
        return None if snapshot.rig.simulated else "the tour is for the virtual rig, this one is real."

    icon, name = viser.Icon, "Take the tour on the virtual rig"
    running: Callable[[Snapshot, View], bool] = lambda _, view: view.tour is not None  # noqa: E731 - short
    return [
        Command(name, None, partial(begin, page), icon.PLAYER_PLAY, group="Plan", why_not=why_not),
        Command("End the tour", None, partial(end, page), icon.X, group="Page", here=running),
    ]


def begin(page: Page) -> None:
    """Fill in the plan of the tour and point at its first button."""
    failed = "The tour did not begin"

    def lead(_: object) -> None:
        page.change(step="plan", tour=Tour(since_s=time.time()), tool="none", why=None, selected=None)

    def plan(_: object = None) -> None:
        page.ask(failed, page.session.take_tour(), lead)

    if page.session.snapshot.dataset is None:
        plan()
    else:
        page.ask(failed, page.session.close_dataset(), plan)


def end(page: Page) -> None:
    """End the tour."""
    page.change(tour=None)


def _skip(page: Page, step: int) -> None:
    if (tour := page.view.tour) is not None:
        page.change(tour=replace(tour, skipped=step + 1))


def _plan_own(page: Page) -> None:
    """End the tour and create an empty plan that covers the sample."""
    failed = NO_PLAN
    end(page)

    def cover(_: object) -> None:
        page.ask(failed, page.session.cover_sample(), lambda _: page.change(step="plan"))

    page.ask(failed, page.session.edit_job(None), cover)


def _import_own(page: Page) -> None:
    end(page)
    import_dialog(page)


TOUR_PICKS: Picks[None] = {
    "tour": lambda here, _: begin(here.page),
    "tour-skip": lambda here, step: _skip(here.page, int(step)),
    "tour-end": lambda here, _: end(here.page),
    "tour-plan": lambda here, _: _plan_own(here.page),
    "tour-import": lambda here, _: _import_own(here.page),
}


def report_of(snapshot: Snapshot, tour: Tour) -> Path | None:
    """Return the report of the tour's dataset written since the tour began, or None."""
    data = snapshot.dataset
    path = newest_report(data.path) if data is not None and is_tour(data.job) else None
    return path if path is not None and path.stat().st_mtime >= tour.since_s else None


def present_step(snapshot: Snapshot, view: View, report: Path | None) -> int:
    """Return the index of the next step, from 0; `N_STEPS` when all are done.

    A saved result, inspection, judgement or report also completes the steps before it.
    """
    tour = view.tour or Tour()
    data, inspection = snapshot.dataset, snapshot.inspection
    started = data is not None and is_tour(data.job)
    finished = started and data is not None and data.finished and snapshot.surface is not None
    measured = started and any(isinstance(finding, StepHeight) for finding in snapshot.findings)
    defects = inspection.inspection.found if started and inspection.inspection is not None else None
    done = {
        SCAN: started,
        LOOK: finished and view.on_surface,
        MEASURE: finished and view.step == "measure",
        KEEP: measured,
        INSPECT: defects is not None,
        JUDGE: defects is not None and (not defects or any(defect.judgement != "open" for defect in defects)),
        REPORT: report is not None,
    }
    lasting = max((step for step in (KEEP, INSPECT, JUDGE, REPORT) if done[step]), default=-1)
    return next((k for k in range(max(lasting + 1, tour.skipped), N_STEPS) if not done[k]), N_STEPS)


def note_of(step: int, snapshot: Snapshot, view: View) -> Note:
    """Return the note of a step."""
    match step:
        case 0:
            job = snapshot.draft.job
            fields = len(job.all_fields()) if job is not None else 0
            text = Markup("{} fields of a virtual wafer are planned. Press <b>Start scan</b>.").format(
                number(fields, 0)
            )
            here = view.step == "plan"
            return Note("Scan a wafer", text, "Start scan" if here else "Plan")
        case 1:
            return _watch(snapshot, view)
        case 2:
            if view.step != "surface":
                return Note("Turn the surface", Markup("Press <b>Surface</b>."), "Surface")
            text = Markup("Drag to turn it, turn the wheel to come closer. Then press <b>Measure this surface</b>.")
            return Note("Turn the surface", text, "Measure this surface")
        case 3:
            return _measure(view)
        case 4:
            return _inspect(snapshot, view)
        case 5:
            if view.step != "review":
                return Note("Judge a defect", Markup("Press <b>Review</b>."), "Review")
            label = JUDGEMENTS[0][2]
            words = Markup("Place, reference and difference are shown. Is it real? Press <b>{}</b> or key Y.")
            text = words.format(label)
            return Note("Judge a defect", text, label)
        case _:
            if view.step != "report":
                text = Markup("Everything goes into one file. Press <b>Report</b>.")
                return Note("Write the report", text, "Report")
            text = Markup("Results, defects and the wafer map are saved in one HTML file. Press <b>Write report</b>.")
            return Note("Write the report", text, "Write report")


def _watch(snapshot: Snapshot, view: View) -> Note:
    data, title = snapshot.dataset, "Watch the surface grow"
    if data is not None and not data.finished and not snapshot.scanning and snapshot.rig.can_start:
        if view.step != "acquire":
            return Note(title, Markup("The scan is unfinished. Press <b>Acquire</b>."), "Acquire")
        return Note(title, Markup("The scan is unfinished. Press <b>Continue the scan</b>."), "Continue the scan")
    if data is None or not data.finished:
        text = "The focus sweeps through each field. Heights appear as soon as a field has all its frames."
        return Note(title, text)
    if not snapshot.surface_is_whole:
        return Note(title, "All frames are taken. The last fields are reconstructed and stitched to the others.")
    if view.step != "acquire":
        return Note(title, Markup("The fields are scanned and stitched. Press <b>Surface</b>."), "Surface")
    return Note(
        title, Markup("The fields are scanned and stitched. Press <b>Look at the surface</b>."), "Look at the surface"
    )


def _measure(view: View) -> Note:
    title = "Measure a step"
    if view.step != "measure":
        return Note(title, Markup("Press <b>Measure</b>."), "Measure")
    if view.tool != "step":
        text = Markup("Below is a profile of the surface. Press <b>Step</b> for the height of one face over another.")
        return Note(title, text, at="[data-pick=tool][data-k=step]")
    text = Markup("Two faces were found. Press <b>Keep result</b>: the height and its uncertainty go into the list.")
    return Note(title, text, "Keep result")


def _inspect(snapshot: Snapshot, view: View) -> Note:
    title, state = "Find the defects", snapshot.inspection
    if view.step != "review":
        return Note(title, Markup("Dies are compared with each other. Press <b>Review</b>."), "Review")
    if state.work:
        return Note(title, "The dies are compared with each other …")
    text = Markup(
        "Every die is compared with the others. Press <b>Inspect</b>: it finds a gel drop, a scratch and particles."
    )
    return Note(title, text, "Inspect")


def _note_html(note: Note, step: int) -> Markup:
    dashes = Markup("").join(
        Markup('<i class="{}"></i>').format("done" if k < step else "now" if k == step else "") for k in range(N_STEPS)
    )
    aim = Markup('data-button="{}" data-at="{}"').format(note.button, note.at)
    press = (
        Markup()
        if not (note.button or note.at)
        else (Markup('<span class="wv-tour-press">or <a role="button" tabindex="0">Press it for me</a></span>'))
    )
    skip = Markup('<a class="wv-tour-skip" {}>Skip</a>').format(html.pick("tour-skip", step))
    return Markup(
        '<div class="wv-tour-ring"></div>'
        '<div class="wv-tour" role="dialog" aria-label="Tour, step {aria_label} of {n_steps}" {aim}>'
        '<div class="wv-tour-arrow"></div>'
        '<div class="wv-tour-head"><span>Tour · {aria_label} of {n_steps}</span>'
        "<a {pick}>Escape ends it</a></div>"
        '<b class="wv-tour-title">{title}</b><p>{text}</p>'
        '<div class="wv-tour-foot"><span class="wv-tour-dashes">{dashes}</span>{press}'
        "{skip}</div></div>"
    ).format(
        aria_label=step + 1,
        n_steps=N_STEPS,
        aim=aim,
        pick=html.pick("tour-end"),
        title=note.title,
        text=note.text,
        dashes=dashes,
        press=press,
        skip=skip,
    )


def end_card(snapshot: Snapshot, tour: Tour, report: Path | None) -> Markup:
    """Return the final card with the results of scan, measurement, inspection and report, as HTML."""
    data = snapshot.dataset
    took = duration((tour.ended_s or tour.since_s) - tour.since_s)
    name = data.path.stem if data is not None else ""
    results = Markup("").join(
        Markup('<div class="{present}"><small>{what}</small><b>{value}</b><span>{below}</span></div>').format(
            present="" if present else "none", what=what, value=value, below=below
        )
        for what, value, below, present in (
            _scanned(snapshot),
            _stepped(snapshot),
            _inspected(snapshot),
            _written(report),
        )
    )
    link = (
        Markup('<a class="yes" href="{}" target="_blank" rel="noopener">Open the report</a>').format(
            report_address(report)
        )
        if report is not None
        else Markup()
    )
    return Markup(
        '<div class="wv-tour-end" role="dialog" aria-label="Results of the tour">'
        "<header><b>Seen, measured, reported</b><span>{n_steps} of {n_steps} · {took} in all</span></header>"
        '<div class="wv-tour-results">{results}</div>'
        '<p>All of it is <b class="wv-sim">SIMULATED</b>: no sample was there. '
        "The dataset stays in the list as <b>{name}</b>.</p>"
        '<div class="wv-tour-ways">{link}<a {pick}>Plan a scan of my own</a>'
        "<a {pick2}>Import images…</a><a {pick3}>Close</a></div></div>"
    ).format(
        n_steps=N_STEPS,
        took=took,
        results=results,
        name=name,
        link=link,
        pick=html.pick("tour-plan"),
        pick2=html.pick("tour-import"),
        pick3=html.pick("tour-end"),
    )


Result = tuple[str, str, str, bool]
"""Title, value, a line below, and whether the part was carried out."""


def _scanned(snapshot: Snapshot) -> Result:
    data, scan = snapshot.dataset, snapshot.scan
    if data is None:
        return "Scanned", "nothing", "", False
    took = f" in {duration(scan.seconds_gone)}" if scan is not None else ""
    return "Scanned", f"{number(len(data.fields), 0)} fields", f"{number(data.plan.n_frames, 0)} frames{took}", True


def _stepped(snapshot: Snapshot) -> Result:
    step = next((f for f in reversed(snapshot.findings) if isinstance(f, StepHeight)), None)
    if step is None:
        return "Step", "not measured", "skipped", False
    height = step.height
    if height.expanded_um is None:
        return "Step", with_unit(height.value_um, 2), f"{step.name}, U not evaluated", True
    value = f"{number(height.value_um, 2)} ± {with_unit(height.expanded_um, 2)}"
    return "Step", value, f"{step.name}, {height.quantity.k_text}", True


def _inspected(snapshot: Snapshot) -> Result:
    inspection = snapshot.inspection.inspection
    if inspection is None:
        return "Found", "not inspected", "skipped", False
    kinds = Counter(DEFECT_CLASSES[defect.seen_as].title.lower() for defect in inspection.found)
    n = len(inspection.found)
    below = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(3))
    return "Found", plural(n, "defect"), below or "on no die", True


def _written(report: Path | None) -> Result:
    if report is None:
        return "Report", "not written", "skipped", False
    return "Report", "1 file", f"{size(report.stat().st_size)}, not signed yet", True


WIDTH_PX, HEIGHT_PX = 380, 318
NO_PLAN = "There is no plan"
PLANS: dict[str, Any] = {"commands": True, "action": "Plan saved"}
TOUR_TIME = "about 2 min"
"""Measured by tests/bench/bench_tour.py, including reading time."""


@dataclass(frozen=True, slots=True)
class Welcome:
    """State of the card. away: it is hidden, so that the form can be used where there is no overview of the sample."""

    away: bool = False


def welcome(here: Here[Welcome]) -> Overlay | None:
    """Return the card that is shown while there is neither a plan nor a dataset."""
    page, snapshot, viewport = here.page, here.snapshot, here.page.viewport
    if here.own.away or snapshot.draft.job is not None or snapshot.dataset is not None or here.view.step != "plan":
        return None
    link = Markup('<span class="wv-link" {}>Take the tour on the virtual rig</span>, {}').format(
        html.command_pick("tour", action="Plan saved"), TOUR_TIME
    )
    link_or_wait = link if snapshot.rig.limits is not None else "The virtual rig is starting …"
    tour = Markup("No sample at hand? &ensp;{}").format(link_or_wait) if snapshot.rig.simulated else Markup()
    plan = Button("Plan a scan", partial(_plan, here), viser.Icon.LAYOUT_GRID, "filled", height_px=46, **PLANS)
    way = partial(Button, style="outlined", height_px=42, commands=True)
    card = [
        Html(Markup('<div class="wv-card"></div>'), padded=False),
        Html(_HEAD),
        plan,
        way("Open a dataset…", partial(open_dialog, page), viser.Icon.FOLDER_OPEN),
        way("Import images…", partial(import_dialog, page), viser.Icon.PHOTO_PLUS),
        Html(Markup('<div class="wv-lab" style="text-align:center;padding:4px 0 6px">{}</div>').format(tour)),
    ]
    width, height = viewport.width_px or FIRST_PX[0], viewport.height_px or FIRST_PX[1]
    return Overlay(card, max(0, (width - WIDTH_PX) // 2), max(70, (height - HEIGHT_PX) // 2), WIDTH_PX, None)


def welcome_commands(here: Here[Welcome]) -> list[Command]:
    """Return the command that plans a scan."""

    def go_and_plan() -> None:
        here.page.change(step="plan", why=None)
        _plan(here)

    return [Command("Plan a scan", None, go_and_plan, viser.Icon.LAYOUT_GRID, group="Plan")]


def _plan(here: Here[Welcome]) -> None:
    """Cover the sample in the rig's overview; without an overview hide the card."""
    if here.page.session.snapshot.overview is None:
        here.keep(away=True)
    else:
        here.page.ask(NO_PLAN, here.page.session.cover_sample())


_HEAD = Markup(
    '<div class="wv-hello"><b>Start with a sample</b>'
    "<span>Lay a field grid on it and scan, or open<br>what was measured before.</span></div>"
)
