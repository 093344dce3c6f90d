"""Wafer alignment by the corners named in the job: expected position shown, actual position marked."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.alignment_picture import clicked, corner_picture, expected_um
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, in_a_row, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.job.job import Job
from wafer_viewer.session.state.snapshot import Draft, Snapshot

FAILED = "The corner was not marked"


class Aligning:
    """State and commands of the alignment in this browser; one per page, shared by all sections."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.chosen: int | None = None
        page.on_pick("corner", self._choose)
        page.on_pick("corner-at", self._clicked)
        page.on_pick("unmark", lambda _: self._again())

    def corner(self, draft: Draft) -> int:
        """Return the index of the corner to mark: the chosen one, else the first unmarked."""
        if self.chosen is not None and self.chosen < len(draft.seen_um):
            return self.chosen
        return next((n for n, place in enumerate(draft.seen_um) if place is None), 0)

    def go(self) -> None:
        """Move the stage to the expected position of the corner."""
        draft = self.page.session.snapshot.draft
        if draft.job is not None:
            x_um, y_um = expected_um(draft.job, draft.seen_um, self.corner(draft))
            self.page.ask("The stage did not move", self.page.session.move_to(x_um=x_um, y_um=y_um))

    def here(self) -> None:
        """Mark the corner at the current stage position."""
        now = self.page.session.snapshot
        self._mark(self.corner(now.draft), now.rig.x_um, now.rig.y_um)

    def _choose(self, key: str) -> None:
        self.chosen = int(key)
        self.page.redraw()

    def _clicked(self, key: str) -> None:
        n, (x_um, y_um) = clicked(key)
        self._mark(n, x_um, y_um)

    def _mark(self, n: int, x_um: float, y_um: float) -> None:
        self.chosen = None
        self.page.ask(FAILED, self.page.session.jobs.mark(n, x_um, y_um))

    def _again(self) -> None:
        self.chosen = None
        self.page.ask("The corners were not changed", self.page.session.jobs.unmark())


class AlignSection:
    """Section to mark one corner at a time; when all are marked, residual and a link to mark them again."""

    def __init__(self, aligning: Aligning, title: str) -> None:
        self._aligning, self._title = aligning, title
        page = aligning.page
        self._head = HtmlBlock(page.gui)
        self._body = HtmlBlock(page.gui)
        self._by_stage = page.gui.add_folder(None, visible=False)
        with self._by_stage:
            go = guarded(page, "The stage did not move")(lambda _: aligning.go())
            here = guarded(page, FAILED)(lambda _: aligning.here())
            self._buttons = (
                button(page.gui, "Go there", viser.Icon.CROSSHAIR, go),
                button(page.gui, "Mark here", viser.Icon.MAP_PIN, here),
            )
            in_a_row(page.gui, self._buttons)

    def show(self, snapshot: Snapshot, visible: bool) -> None:
        """Update the section; it is empty if the job names no corners."""
        draft = snapshot.draft
        job = draft.job if visible else None
        marks = job.marks if job is not None else None
        if job is None or marks is None:
            self._head.show("")
            self._body.show("")
            set_prop(self._by_stage, "visible", False)
            return
        n_seen = sum(place is not None for place in draft.seen_um)
        aligned = job.alignment is not None and self._aligning.chosen is None
        self._head.show(html.head(self._title, f"{n_seen} of {len(marks.places)} corners marked"))
        corner = self._aligning.corner(draft)
        self._body.show(_fit(job) if aligned else _corner(snapshot, job, draft.seen_um, corner))
        set_prop(self._by_stage, "visible", not aligned)
        for handle in self._buttons:
            set_prop(handle, "disabled", snapshot.rig.state != "ready")


def _fit(job: Job) -> str:
    """Return the residual of the alignment, with its limit."""
    found, marks = job.alignment, job.marks
    if found is None or marks is None:
        return ""
    good = found.residual_um <= marks.limit_um
    words = f"{found.n_marks} corners, residual {with_unit(found.residual_um, 1)} of {with_unit(marks.limit_um, 0)}"
    again = f'<span class="wv-link" {html.pick("unmark")}>Mark again</span>'
    text = "" if good else "Too large: mark the named corners again."
    sign = html.icon(viser.Icon.CIRCLE_CHECK if good else viser.Icon.HAND_STOP, 18)
    return html.note("good" if good else "fault", words, text, again, sign)


def _corner(snapshot: Snapshot, job: Job, seen_um: tuple[Any, ...], n: int) -> str:
    """Return the picture of a corner, the instruction, and the list of corners."""
    if job.marks is None:
        return ""
    chips = "".join(_chip(k, n, seen_um[k] is not None) for k in range(len(job.marks.places)))
    rig = snapshot.rig
    stage = f"{number(rig.x_um / 1000, 3)}, {with_unit(rig.y_um / 1000, 3, 'mm')}"
    text = (
        f'<div class="wv-chips" role="group" aria-label="Corners">{chips}</div>'
        f"<p><b>{html.safe(job.marks.places[n].name)}</b></p>"
        "<p>Click where it is. The thin cross is where it should be.</p>"
        f'<p class="dim">Stage at {stage}</p>'
    )
    return f'<div class="wv-align">{corner_picture(snapshot.overview, job, seen_um, n)}<div>{text}</div></div>'


def _chip(k: int, current: int, seen: bool) -> str:
    sign = html.icon(viser.Icon.CHECK, 13) if seen else ""
    chosen = ' class="on"' if k == current else ""
    return f"<span{chosen} {html.pick('corner', k)}>{sign}Corner {k + 1}</span>"
