"""Dialogs of released jobs: selection, alignment corners, trial, release."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import preflight
from wafer_viewer.gui.presenters.revision_trial import before_release
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.model.acquisition.alignment import AlignmentMark, Marks
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.preflight import PreflightCheck
from wafer_viewer.session.state.operator_state import JobEntry
from wafer_viewer.session.state.snapshot import Snapshot

BY_HAND = "as typed below"


def jobs_dialog(page: Page) -> None:
    """Open the dialog that loads a released job."""
    snapshot = page.session.snapshot
    dialog = Dialog(page, "Released jobs", f"In {snapshot.data_folder / 'jobs'}, or a file elsewhere.")
    with dialog.modal:
        HtmlBlock(page.gui, job_table(snapshot.operating.jobs, "job-in-dialog"))
        files = FileList(dialog, "job", rows=5)

    def listed(key: str) -> None:
        dialog.close()
        load_job(page, Path(key))

    def typed() -> None:
        if files.is_empty:
            raise PlanError("No job is chosen: click one, or its file.")
        load_job(page, files.path())

    page.on_pick("job-in-dialog", listed)
    dialog.answers("Use this job", viser.Icon.FOLDER_OPEN, typed, "The job was not loaded")


def load_job(page: Page, path: Path) -> None:
    """Load a released job for the next wafer."""
    page.ask("The job was not loaded", page.session.jobs.take_up(path), lambda _: page.change(everything=False))


def job_table(entries: tuple[JobEntry, ...], what: str) -> str:
    """Return the table of released jobs; a click on one picks `what`."""
    if not entries:
        return html.empty("No job is released yet.")

    def line(entry: JobEntry) -> str:
        name = f"{html.safe(entry.product)}<small>revision {html.safe(entry.revision)}</small>"
        return html.row([name, str(entry.n_fields), str(entry.n_features)], " nn", html.pick(what, entry.path))

    return html.table(["Released job", "Fields", "Features"], [line(entry) for entry in entries], " nn")


def start_dialog(page: Page, checks: tuple[PreflightCheck, ...], start: Callable[[], None]) -> None:
    """Ask for confirmation of the open preflight checks before the scan starts."""
    open_ones = tuple(check for check in checks if check.state != "ok")
    dialog = Dialog(page, "Start anyway?", "The scan can start, but this needs attention:")
    with dialog.modal:
        HtmlBlock(page.gui, preflight.lines(open_ones))
    dialog.answers("Start", viser.Icon.PLAYER_PLAY, start, "The scan did not start")


def corners_dialog(page: Page) -> None:
    """Open the dialog that names the two alignment corners of this product."""
    job = required_job(page)
    marks = job.marks or suggested_marks(page.session.snapshot.overview)
    below = "Corners of dies, far apart, in wafer µm: the middle of the wafer is (0, 0), its notch points down."
    dialog, gui = Dialog(page, "Corners to align by", below), page.gui
    with dialog.modal:
        rows = [
            (gui.add_text(f"Corner {n + 1}", mark.name), gui.add_vector2("x, y, µm", (mark.x_um, mark.y_um), step=0.1))
            for n, mark in enumerate(marks.places)
        ]
        limit = gui.add_number("Limit, µm", marks.limit_um, min=0.1, step=0.5)

    def keep() -> None:
        places = tuple(AlignmentMark(name=name.value.strip(), x_um=at.value[0], y_um=at.value[1]) for name, at in rows)
        edit(page, marks=Marks(places=places, limit_um=limit.value), alignment=None)

    dialog.answers("Keep", viser.Icon.CHECK, keep, "The corners were not changed")


def trial_dialog(page: Page) -> None:
    """Open the dialog that applies the plan to stored wafers and lists changed verdicts; nothing is released."""
    required_job(page)
    below = "Shows which verdicts would change, and why. Nothing stored is overwritten; a changed recipe takes longer."
    dialog = Dialog(page, "Try on stored wafers", below)
    with dialog.modal:
        files = FileList(dialog, "wafers", rows=7)
        files.field.value = str(page.session.snapshot.data_folder)
        result = page.gui.add_text("Reconstruction", DEFAULT_RESULT)

    def begin() -> None:
        paths = (files.path(),)
        page.ask("The trial failed", page.session.trials.begin(paths, result.value.strip() or DEFAULT_RESULT))

    dialog.answers("Try it", viser.Icon.HISTORY, begin, "The trial failed")


def release_dialog(page: Page) -> None:
    """Open the dialog that releases the plan under a product and a revision; it is then immutable."""
    job = required_job(page)
    below = "Operators run it with four actions. It cannot be changed afterwards; a change is a new revision."
    dialog, now = Dialog(page, "Release the job", below), page.session.snapshot
    with dialog.modal:
        HtmlBlock(page.gui, before_release(now.operating, trial_is_old(now)))
        product = page.gui.add_text("Product", job.product or job.sample.product)
        revision = page.gui.add_text("Revision", job.revision)

    def release() -> None:
        if not (product.value.strip() and revision.value.strip()):
            raise PlanError("Product and revision both need a name: an operator chooses by them.")
        edit(page, then=write, product=product.value.strip(), revision=revision.value.strip())

    def write(_: Any) -> None:
        told = "The job was not released"
        page.ask(told, page.session.jobs.release(), lambda path: page.say("Released", str(path)))

    dialog.answers("Release", viser.Icon.LOCK, release, "The job was not released")


def trial_is_old(now: Snapshot) -> bool:
    """Return whether the plan differs from the one tried; product and revision are ignored."""
    tried, job = now.operating.trial_of, now.draft.job
    if tried is None or job is None or now.operating.trial is None:
        return False
    return replace(tried, product=job.product, revision=job.revision) != job


def edit(page: Page, then: Callable[[Any], None] | None = None, **changes: Any) -> None:
    """Change fields of the plan."""
    page.ask("The plan was not changed", page.session.edit_job(replace(required_job(page), **changes)), then)


def required_job(page: Page) -> Job:
    """Return the plan. Raises PlanError if there is none."""
    if (job := page.session.snapshot.draft.job) is None:
        raise PlanError("There is no plan yet: lay a field grid over the sample first.")
    return job


def suggested_marks(overview: Overview | None) -> Marks:
    """Return the outer lower corners of leftmost and rightmost die, nearest to y = 0; zeros for fewer than two dies."""
    dies = overview.dies_um if overview is not None else ()
    if len(dies) < 2:
        return Marks(places=(AlignmentMark(name="", x_um=0.0, y_um=0.0), AlignmentMark(name="", x_um=0.0, y_um=0.0)))
    boxes = [Region.polygon(*die).bounds_um for die in dies]
    left = min(boxes, key=lambda b: (round(b[0]), abs(b[1] + b[3])))
    right = max(boxes, key=lambda b: (round(b[2]), -abs(b[1] + b[3])))
    return Marks(
        places=(
            AlignmentMark(name="leftmost die, lower left corner", x_um=round(left[0], 1), y_um=round(left[1], 1)),
            AlignmentMark(name="rightmost die, lower right corner", x_um=round(right[2], 1), y_um=round(right[1], 1)),
        )
    )
