"""Start card and guided tour: a note that points at the next button, and a card with the results.

Completed steps follow from the state of session and view, no matter how they were carried out.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import duration, number, size, with_unit
from wafer_viewer.gui.dialogs.import_dialog import import_dialog
from wafer_viewer.gui.dialogs.open_and_export import open_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import Tour, View
from wafer_viewer.gui.steps.report import report_address
from wafer_viewer.gui.steps.review.judging import JUDGEMENTS
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import Command, HtmlBlock, add_html, command_button, leading, outlined, set_prop
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


class TourGuide:
    """Note of the present step; Escape ends the tour."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._cell = HtmlBlock(page.gui, padded=False)
        page.on_pick("tour", lambda _: self.begin())
        page.on_pick("tour-skip", lambda step: self._skip(int(step)))
        page.on_pick("tour-end", lambda _: self.end())
        page.on_pick("tour-plan", lambda _: self._plan())
        page.on_pick("tour-import", lambda _: self._import())

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the note of the present step, or the results."""
        tour = view.tour
        if tour is None or not is_tour(snapshot.draft.job):
            self._cell.show("")
            return
        report = report_of(snapshot, tour)
        step = present_step(snapshot, view, report)
        if step < N_STEPS:
            self._cell.show(_note_html(note_of(step, snapshot, view), step))
            return
        if tour.ended_s is None:
            tour = replace(tour, ended_s=time.time())
            self._page.change(tour=tour)
        self._cell.show(end_card(snapshot, tour, report))

    def commands(self) -> list[Command]:
        """Return the commands that begin and end the tour."""

        def why_not(snapshot: Snapshot, _: View) -> str | None:
            return None if snapshot.rig.simulated else "the tour is for the virtual rig, this one is real."

        def running(_: Snapshot, view: View) -> bool:
            return view.tour is not None

        icon, name = viser.Icon.PLAYER_PLAY, "Take the tour on the virtual rig"
        return [
            Command(name, None, self.begin, icon, group="Plan", why_not=why_not),
            Command("End the tour", None, self.end, viser.Icon.X, group="Page", here=running),
        ]

    def begin(self) -> None:
        """Fill in the plan of the tour and point at its first button."""
        page, failed = self._page, "The tour did not begin"

        def lead(_: object) -> None:
            page.change(step="plan", tour=Tour(since_s=time.time()), tool="none", why=None, selected=None)

        def plan(_: object = None) -> None:
            page.ask(failed, page.session.take_tour(), lead)

        if page.session.snapshot.dataset is None:
            plan()
        else:
            page.ask(failed, page.session.close_dataset(), plan)

    def end(self) -> None:
        """End the tour."""
        self._page.change(tour=None)

    def _skip(self, step: int) -> None:
        if (tour := self._page.view.tour) is not None:
            self._page.change(tour=replace(tour, skipped=step + 1))

    def _plan(self) -> None:
        """End the tour and create an empty plan that covers the sample."""
        page, failed = self._page, "There is no plan"
        self.end()

        def cover(_: object) -> None:
            page.ask(failed, page.session.cover_sample(), lambda _: page.change(step="plan"))

        page.ask(failed, page.session.edit_job(None), cover)

    def _import(self) -> None:
        self.end()
        guarded(self._page, "Nothing was imported")(import_dialog)(self._page)


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
                text = Markup("All of it goes into one file. Press <b>Report</b>.")
                return Note("Write the report", text, "Report")
            text = Markup("Results, defects and the wafer map stand in one HTML file. Press <b>Write report</b>.")
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
        return Note(title, Markup("Every die can be compared with the others. Press <b>Review</b>."), "Review")
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
    return "Found", f"{number(n, 0)} defect{'' if n == 1 else 's'}", below or "on no die", True


def _written(report: Path | None) -> Result:
    if report is None:
        return "Report", "not written", "skipped", False
    return "Report", "1 file", f"{size(report.stat().st_size)}, not signed yet", True


WIDTH_PX, HEIGHT_PX = 380, 318
TOUR_TIME = "about 2 min"
"""Measured by tests/bench/bench_tour.py, including reading time."""


class Welcome:
    """Card shown while there is neither a plan nor a dataset."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._place = (0, 0)
        self._away = False
        gui = page.gui
        self._panel = gui.add_panel(visible=False)
        with self._panel.add_tab("Start"):
            add_html(gui, Markup('<div class="wv-card"></div>'))
            HtmlBlock(gui, _HEAD)
            begin = guarded(page, "There is no plan")(lambda _: self._plan())
            plan = command_button(gui, "Plan a scan", viser.Icon.LAYOUT_GRID, begin, action="Plan saved")
            leading(gui, plan, 46, sticky=False)
            outlined(
                gui, command_button(gui, "Open a dataset…", viser.Icon.FOLDER_OPEN, lambda _: open_dialog(page)), 42
            )
            outlined(
                gui, command_button(gui, "Import images…", viser.Icon.PHOTO_PLUS, lambda _: import_dialog(page)), 42
            )
            self._tour = HtmlBlock(gui)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show or hide the card."""
        first = snapshot.draft.job is None and snapshot.dataset is None and view.step == "plan" and not self._away
        set_prop(self._panel, "visible", first)
        if not first:
            return
        self._centre()
        link = Markup('<span class="wv-link" {}>Take the tour on the virtual rig</span>, {}').format(
            html.command_pick("tour", action="Plan saved"), TOUR_TIME
        )
        link_or_wait = link if snapshot.rig.limits is not None else "The virtual rig is starting …"
        tour = Markup("No sample at hand? &ensp;{}").format(link_or_wait) if snapshot.rig.simulated else Markup()
        self._tour.show(Markup('<div class="wv-lab" style="text-align:center;padding:4px 0 6px">{}</div>').format(tour))

    def commands(self) -> list[Command]:
        """Return the command that plans a scan."""
        icon = viser.Icon
        return [Command("Plan a scan", None, self._go_and_plan, icon.LAYOUT_GRID, group="Plan")]

    def _go_and_plan(self) -> None:
        self._page.change(step="plan", why=None)
        self._plan()

    def _plan(self) -> None:
        """Cover the sample in the rig's overview; without an overview, hide the card so that the form can be used."""
        if self._page.session.snapshot.overview is None:
            self._away = True
            self._page.redraw()
        else:
            self._page.ask("There is no plan", self._page.session.cover_sample())

    def _centre(self) -> None:
        viewport = self._page.viewport
        place = ((viewport.width_px - WIDTH_PX) // 2, max(70, (viewport.height_px - HEIGHT_PX) // 2))
        if place != self._place and viewport.width_px > 0:
            self._place = place
            self._panel.float(x=max(0, place[0]), y=place[1], width=WIDTH_PX)


_HEAD = Markup(
    '<div class="wv-hello"><b>Start with a sample</b>'
    "<span>Lay a field grid on it and scan, or open<br>what was measured before.</span></div>"
)
