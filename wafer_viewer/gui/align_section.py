"""Aligning a wafer by the corners that its job names: each is shown where it should be, and marked where it is."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.draw.numbers import number, with_unit
from wafer_viewer.gui import html
from wafer_viewer.gui.corner_picture import clicked, corner_picture, expected_um
from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.kit import Cell, button, in_a_row, set_prop
from wafer_viewer.gui.page import Page
from wafer_viewer.model.plan import Job
from wafer_viewer.session.state import Draft, Snapshot

FAILED = "The corner is not marked"


class AlignSection:
    """One corner at a time; when all are marked, how well they fit, and the way to mark them again."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._chosen: int | None = None
        self._head = Cell(page.gui)
        self._body = Cell(page.gui)
        self._by_stage = page.gui.add_folder(None, visible=False)
        with self._by_stage:
            there = self._button("Go there", viser.Icon.CROSSHAIR, self._go, "The stage did not move")
            here = self._button("Mark here", viser.Icon.MAP_PIN, self._here, FAILED)
            self._buttons = (there, here)
            in_a_row(page.gui, self._buttons)
        page.on_pick("corner", self._choose)
        page.on_pick("corner-at", self._clicked)
        page.on_pick("unmark", lambda _: self._again())

    def show(self, snapshot: Snapshot, visible: bool) -> None:
        """Bring the section up to date; without corners in the job there is nothing to do."""
        draft = snapshot.draft
        job = draft.job if visible else None
        marks = job.marks if job is not None else None
        if job is None or marks is None:
            self._head.show("")
            self._body.show("")
            set_prop(self._by_stage, "visible", False)
            return
        n_seen = sum(place is not None for place in draft.seen_um)
        aligned = job.alignment is not None and self._chosen is None
        self._head.show(html.head("2 · Align", f"{n_seen} of {len(marks.places)} corners marked"))
        self._body.show(_fit(job) if aligned else _corner(snapshot, job, draft.seen_um, self._corner(draft)))
        set_prop(self._by_stage, "visible", not aligned)
        for handle in self._buttons:
            set_prop(handle, "disabled", snapshot.rig.state != "ready")

    def _corner(self, draft: Draft) -> int:
        """The corner to be marked: the one chosen, else the first that was not seen."""
        if self._chosen is not None and self._chosen < len(draft.seen_um):
            return self._chosen
        return next((n for n, place in enumerate(draft.seen_um) if place is None), 0)

    def _button(self, name: str, icon: Any, act: Any, failed: str) -> Any:
        return button(self._page.gui, name, icon, guarded(self._page, failed)(lambda _: act()))

    def _choose(self, key: str) -> None:
        self._chosen = int(key)
        self._page.redraw()

    def _clicked(self, key: str) -> None:
        n, (x_um, y_um) = clicked(key)
        self._mark(n, x_um, y_um)

    def _here(self) -> None:
        rig = self._page.session.snapshot.rig
        self._mark(self._corner(self._page.session.snapshot.draft), rig.x_um, rig.y_um)

    def _mark(self, n: int, x_um: float, y_um: float) -> None:
        self._chosen = None
        self._page.ask(FAILED, self._page.session.jobs.mark(n, x_um, y_um))

    def _go(self) -> None:
        draft = self._page.session.snapshot.draft
        if draft.job is not None:
            x_um, y_um = expected_um(draft.job, draft.seen_um, self._corner(draft))
            self._page.ask("The stage did not move", self._page.session.move_to(x_um=x_um, y_um=y_um))

    def _again(self) -> None:
        self._chosen = None
        self._page.ask("The corners stay", self._page.session.jobs.unmark())


def _fit(job: Job) -> str:
    """How well the corners fit."""
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
    """The picture of a corner, what to do with it, and the other corners."""
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
