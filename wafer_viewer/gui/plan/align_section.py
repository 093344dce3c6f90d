"""Alignment of the wafer by the corners named in the job, and the operator's view of a released job."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import duration, number, with_unit
from wafer_viewer.draw.surface.pictures import greys, patch_url
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import plan
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    HtmlBlock,
    add_html,
    command_button,
    controlled,
    duo,
    in_a_row,
    set_prop,
)
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.preflight import PreflightCheck
from wafer_viewer.session.state.snapshot import Draft, Snapshot

# -------------------------------------------------------------------------------------------------------- align section


SIDE_UM = 300.0
"""Side of the picture: shows a corner, the adjacent streets, and the possible misplacement of a wafer."""
Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Square:
    """Displayed part of the overview: upper left corner on the stage, and side, in µm."""

    left_um: float
    top_um: float
    side_um: float

    def at(self, across: float, down: float) -> Place:
        """Return the stage position at fractions of the picture's width and height."""
        return self.left_um + across * self.side_um, self.top_um - down * self.side_um

    def shares(self, place_um: Place) -> tuple[float, float]:
        """Return a stage position as fractions of the picture's width and height."""
        return (place_um[0] - self.left_um) / self.side_um, (self.top_um - place_um[1]) / self.side_um


def expected_um(job: Job, marked_um: tuple[Place | None, ...], n: int) -> Place:
    """Return the expected stage position of corner n: by the alignment, else by the notch and the marked corners."""
    if job.marks is None:
        return 0.0, 0.0
    lies = job.alignment or Alignment.by_notch(job.sample.notch)
    places = [lies.to_stage(mark.x_um, mark.y_um) for mark in job.marks.places]
    if job.alignment is not None:
        return places[n]
    off = [(s[0] - p[0], s[1] - p[1]) for s, p in zip(marked_um, places, strict=True) if s is not None]
    dx, dy = (sum(d[axis] for d in off) / max(1, len(off)) for axis in (0, 1))
    return places[n][0] + dx, places[n][1] + dy


def square_round(overview: Overview, place_um: Place) -> tuple[Square, int, int, int]:
    """Return the pixel-aligned square around a position: square, row and column of its centre, side in px."""
    side_px = 2 * round(SIDE_UM / overview.pixel_um / 2)
    col = round((place_um[0] - overview.x0_um) / overview.pixel_um)
    row = round((overview.y0_um - place_um[1]) / overview.pixel_um)
    left_um = overview.x0_um + (col - side_px // 2 - 0.5) * overview.pixel_um
    top_um = overview.y0_um - (row - side_px // 2 - 0.5) * overview.pixel_um
    return Square(left_um, top_um, side_px * overview.pixel_um), row, col, side_px


def corner_picture(overview: Overview | None, job: Job, marked_um: tuple[Place | None, ...], n: int) -> Markup:
    """Return the picture with expected and marked position of the corner; a click picks ``corner-at``."""
    if overview is None or overview.image is None or job.marks is None:
        return html.empty("No picture of the stage:", "drive there and mark", "where the stage stands.")
    expected = expected_um(job, marked_um, n)
    square, row, col, side_px = square_round(overview, expected)
    url = patch_url(overview.image, row, col, side_px, greys(overview.image))
    name = f"Click corner {n + 1}: {job.marks.places[n].name}"
    key = f"{n};{square.left_um!r};{square.top_um!r};{square.side_um!r}"
    return Markup(
        '<div class="wv-corner" aria-label="{name}" title="{name}" data-at="{key}" data-where="corner" {pick}>'
        '<img src="{url}" alt="">'
        "{cross}{cross2}</div>"
    ).format(
        name=name,
        key=key,
        pick=html.command_pick("corner-at"),
        url=url,
        cross=_cross(square.shares(expected), "due"),
        cross2=_cross(square.shares(p), "seen") if (p := marked_um[n]) else "",
    )


def clicked(key: str) -> tuple[int, Place]:
    """Return the corner that a click on the picture marks, and its stage position."""
    n, left, top, side, across, down = key.split(";")
    return int(n), Square(float(left), float(top), float(side)).at(float(across), float(down))


def _cross(shares: tuple[float, float], kind: str) -> Markup:
    return Markup('<i class="{}" style="left:{:.2f}%;top:{:.2f}%"></i>').format(kind, 100 * shares[0], 100 * shares[1])


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
        if self.chosen is not None and self.chosen < len(draft.marked_um):
            return self.chosen
        return next((n for n, place in enumerate(draft.marked_um) if place is None), 0)

    def go(self) -> None:
        """Move the stage to the expected position of the corner."""
        draft = self.page.session.snapshot.draft
        if draft.job is not None:
            x_um, y_um = expected_um(draft.job, draft.marked_um, self.corner(draft))
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
            self._go = command_button(page.gui, "Go there", viser.Icon.CROSSHAIR, go)
            self._here = command_button(page.gui, "Mark here", viser.Icon.MAP_PIN, here)
            in_a_row(page.gui, [self._go, self._here])

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
        n_marked = sum(place is not None for place in draft.marked_um)
        aligned = job.alignment is not None and self._aligning.chosen is None
        self._head.show(html.head(self._title, f"{n_marked} of {len(marks.places)} corners marked"))
        corner = self._aligning.corner(draft)
        self._body.show(_fit(job) if aligned else _corner(snapshot, job, draft.marked_um, corner))
        set_prop(self._by_stage, "visible", not aligned)
        set_prop(self._go, "disabled", not snapshot.rig.can_start)
        set_prop(self._here, "disabled", snapshot.rig.state != "ready")  # a lost stage has its last place, not its own


def _fit(job: Job) -> Markup:
    """Return the residual of the alignment, with its limit."""
    fit, marks = job.alignment, job.marks
    if fit is None or marks is None:
        return Markup()
    good = fit.residual_um <= marks.limit_um
    words = f"{fit.n_marks} corners, residual {with_unit(fit.residual_um, 1)} of {with_unit(marks.limit_um, 0)}"
    again = Markup('<span class="wv-link" {}>Mark again</span>').format(html.command_pick("unmark"))
    text = "" if good else "Too large: mark the named corners again."
    sign = html.icon(viser.Icon.CIRCLE_CHECK if good else viser.Icon.HAND_STOP, 18)
    return html.note("good" if good else "fault", words, text, again, sign)


def _corner(snapshot: Snapshot, job: Job, marked_um: tuple[Any, ...], n: int) -> Markup:
    """Return the picture of a corner, the instruction, and the list of corners."""
    if job.marks is None:
        return Markup()
    chips = Markup("").join(_chip(k, n, marked_um[k] is not None) for k in range(len(job.marks.places)))
    rig = snapshot.rig
    stage = f"{number(rig.x_um / 1000, 3)}, {with_unit(rig.y_um / 1000, 3, 'mm')}"
    text = Markup(
        '<div class="wv-chips" role="group" aria-label="Corners">{}</div>'
        "<p><b>{}</b></p>"
        "<p>Click where it is. The thin cross is where it should be.</p>"
        '<p class="dim">Stage at {}</p>'
    ).format(chips, job.marks.places[n].name, stage)
    return Markup('<div class="wv-align">{}<div>{}</div></div>').format(
        corner_picture(snapshot.overview, job, marked_um, n), text
    )


def _chip(k: int, current: int, marked: bool) -> Markup:
    sign = html.icon(viser.Icon.CHECK, 13) if marked else ""
    chosen = Markup(' class="on"') if k == current else Markup()
    return Markup("<span{chosen} {pick}>{sign}Corner {k}</span>").format(
        chosen=chosen, pick=html.pick("corner", k), sign=sign, k=k + 1
    )


# -------------------------------------------------------------------------------------------------------- operator view


NOT_RENAMED = "The names were not changed"
FOCUS = Markup('<i hidden data-arrived="wafer"></i>')
"""Mark that focuses the wafer id once, so that a barcode reader (a keyboard) needs no click."""


class OperatorView:
    """First three of the four operator actions; the fourth, the verdict, follows in Acquire."""

    def __init__(self, page: Page, aligning: Aligning) -> None:
        self._page = page
        self._edits = Debouncer(self._commit, guarded(page, NOT_RENAMED))
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._title = HtmlBlock(page.gui)
            self._notes = HtmlBlock(page.gui)
            self._build_wafer()
            self._align = AlignSection(aligning, "2 · Align")
            self._checks = HtmlBlock(page.gui)
        page.on_pick("everything", lambda key: page.change(everything=key == "yes"))

    def show(self, snapshot: Snapshot, view: View, checks: tuple[PreflightCheck, ...]) -> None:
        """Update the view; it is visible only if the plan is a released job and the full form is folded."""
        job = snapshot.draft.job
        visible = view.step == "plan" and folded(snapshot, view)
        set_prop(self._folder, "visible", visible)
        self._align.show(snapshot, visible)
        if job is None or not visible:
            self._focus.show("")
            return
        self._title.show(_title(snapshot, job))
        self._notes.show(self._page.notes(snapshot))
        self._focus.show(FOCUS if not job.sample.wafer_id else "")
        if not self._edits.under_way:
            self._wafer_id.show(job.sample.wafer_id)
            self._lot.show(job.sample.lot)
            self._operator.show(job.sample.operator)
        self._checks.show(plan.section(checks, "3 · Start"))

    def _build_wafer(self) -> None:
        gui = self._page.gui
        HtmlBlock(gui, html.head("1 · Wafer", "type the id or scan its barcode"))
        add_html(gui, Markup('<div class="wv-scan"></div>'))
        self._wafer_id = self._field(gui.add_text("Wafer id", ""))
        duo(gui)
        self._lot, self._operator = self._field(gui.add_text("Lot", "")), self._field(gui.add_text("Operator", ""))
        self._focus = HtmlBlock(gui, padded=False)

    def _field(self, handle: Any) -> BoundInput[str]:
        return BoundInput(controlled(handle), lambda _: self._edits.made(), self._page, NOT_RENAMED)

    def _commit(self) -> Future[Any] | None:
        page, job = self._page, self._page.session.snapshot.draft.job
        if job is None:
            return None
        names = {"wafer_id": self._wafer_id.value, "lot": self._lot.value, "operator": self._operator.value}
        named = replace(job, sample=replace(job.sample, **{key: text.strip() for key, text in names.items()}))
        if named == job:
            page.redraw()
            return None
        answer = page.session.edit_job(named)
        page.ask(NOT_RENAMED, answer)
        return answer


def folded(snapshot: Snapshot, view: View) -> bool:
    """Return whether only the operator actions of a released job are shown."""
    job = snapshot.draft.job
    return job is not None and job.released and not view.everything


def _title(snapshot: Snapshot, job: Job) -> Markup:
    plan = snapshot.draft.plan
    n = len(job.all_fields())
    takes = f" · {duration(plan.predicted_s)}" if plan is not None else ""
    below = f"Revision {job.revision}, released · {n} field{'s' if n > 1 else ''}{takes}"
    return html.title(job.product, below, _other_job() + unfold(True))


def unfold(more: bool) -> Markup:
    """Return the link that unfolds the full panel, or folds it again."""
    name = "Show everything" if more else "Show less"
    return Markup('<span class="wv-action" {}>{}</span>').format(html.pick("everything", "yes" if more else "no"), name)


def _other_job() -> Markup:
    return Markup('<span class="wv-action" {}>Another job…</span>').format(html.command_pick("jobs"))
