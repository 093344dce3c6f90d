"""Alignment of the wafer by the corners named in the job, and the operator's view of a released job."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import duration, number, plural, with_unit
from wafer_viewer.draw.surface.pictures import greys, patch_url
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, Stack
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.panels import unfold
from wafer_viewer.gui.steps.plan_form import PlanState, plan_inputs
from wafer_viewer.gui.steps.preflight_lines import section
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.sample import Alignment, Marks
from wafer_viewer.model.job import Job
from wafer_viewer.session.planning.preflight import PreflightCheck
from wafer_viewer.session.state.snapshot import Draft, Snapshot

SIDE_UM = 300.0
"""Side of the picture: shows a corner, the adjacent streets, and the possible misplacement of a wafer."""
NOT_MARKED = "The corner was not marked"
FOCUS = Markup('<i hidden data-arrived="wafer"></i>')
"""Mark that focuses the wafer id once, so that a barcode reader (a keyboard) needs no click."""
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
        return html.empty("No picture of the stage:", "drive to the corner and", "mark the stage position.")
    expected = expected_um(job, marked_um, n)
    square, row, col, side_px = square_round(overview, expected)
    name = f"Click corner {n + 1}: {job.marks.places[n].name}"
    key = f"{n};{square.left_um!r};{square.top_um!r};{square.side_um!r}"
    marked = marked_um[n]
    return Markup(
        '<div class="wv-corner" aria-label="{name}" title="{name}" data-at="{key}" data-where="corner" {pick}>'
        '<img src="{url}" alt="">{due}{seen}</div>'
    ).format(
        name=name,
        key=key,
        pick=html.command_pick("corner-at"),
        url=patch_url(overview.image, row, col, side_px, greys(overview.image)),
        due=_cross(square.shares(expected), "due"),
        seen=_cross(square.shares(marked), "seen") if marked else "",
    )


def clicked(key: str) -> tuple[int, Place]:
    """Return the corner that a click on the picture marks, and its stage position."""
    n, left, top, side, across, down = key.split(";")
    return int(n), Square(float(left), float(top), float(side)).at(float(across), float(down))


def _cross(shares: tuple[float, float], kind: str) -> Markup:
    return Markup('<i class="{}" style="left:{:.2f}%;top:{:.2f}%"></i>').format(kind, 100 * shares[0], 100 * shares[1])


def _corner(here: Here[PlanState], draft: Draft) -> int:
    """Return the index of the corner to mark: the chosen one, else the first unmarked."""
    chosen = here.own.corner
    if chosen is not None and chosen < len(draft.marked_um):
        return chosen
    return next((n for n, place in enumerate(draft.marked_um) if place is None), 0)


def _mark(here: Here[PlanState], n: int, place_um: Place) -> None:
    here.keep(corner=None)
    here.page.ask(NOT_MARKED, here.page.session.jobs.mark(n, *place_um))


def _unmark(here: Here[PlanState], _: str) -> None:
    here.keep(corner=None)
    here.page.ask("The corners were not changed", here.page.session.jobs.unmark())


ALIGN_PICKS: dict[str, Callable[[Here[PlanState], str], None]] = {
    "corner": lambda here, key: here.keep(corner=int(key)),
    "corner-at": lambda here, key: _mark(here, *clicked(key)),
    "unmark": _unmark,
}
"""What clicks in the section do."""


def align_section(here: Here[PlanState], title: str) -> Elements:
    """Return the section to mark one corner at a time; the residual when all are; nothing for a job without corners."""
    snapshot, draft = here.snapshot, here.snapshot.draft
    job = draft.job
    if job is None or job.marks is None:
        return []
    n_marked = sum(place is not None for place in draft.marked_um)
    head = Html(html.head(title, f"{n_marked} of {len(job.marks.places)} corners marked"))
    if job.alignment is not None and here.own.corner is None:
        return [head, Html(_fit(job.alignment, job.marks))]
    corner = _corner(here, draft)

    def go() -> Future[Any]:
        x_um, y_um = expected_um(job, draft.marked_um, corner)
        return here.page.session.move_to(x_um=x_um, y_um=y_um)

    def mark_here() -> None:
        rig = here.page.session.snapshot.rig
        _mark(here, corner, (rig.x_um, rig.y_um))

    lost = snapshot.rig.state != "ready"  # a lost stage has its last place, not its own
    still = not snapshot.rig.can_start
    icon = viser.Icon
    return [
        head,
        Html(_to_mark(snapshot, job, job.marks, corner)),
        Buttons(
            [
                Button("Go there", go, icon.CROSSHAIR, disabled=still, commands=True, failed="The stage did not move"),
                Button("Mark here", mark_here, icon.MAP_PIN, disabled=lost, commands=True, failed=NOT_MARKED),
            ]
        ),
    ]


def _fit(fit: Alignment, marks: Marks) -> Markup:
    """Return the residual of the alignment, with its limit."""
    good = fit.residual_um <= marks.limit_um
    words = f"{fit.n_marks} corners, residual {with_unit(fit.residual_um, 1)} of {with_unit(marks.limit_um, 0)}"
    text = "" if good else "Too large: mark the named corners again."
    sign = html.icon(viser.Icon.CIRCLE_CHECK if good else viser.Icon.HAND_STOP, 18)
    return html.note("good" if good else "fault", words, text, html.command_link("Mark again", "unmark"), sign)


def _to_mark(snapshot: Snapshot, job: Job, marks: Marks, n: int) -> Markup:
    """Return the picture of a corner, the instruction, and the list of corners."""
    marked_um, rig = snapshot.draft.marked_um, snapshot.rig
    chips = Markup("").join(_chip(k, n, marked_um[k] is not None) for k in range(len(marks.places)))
    stage = f"{number(rig.x_um / 1000, 3)}, {with_unit(rig.y_um / 1000, 3, 'mm')}"
    text = Markup(
        '<div class="wv-chips" role="group" aria-label="Corners">{}</div>'
        "<p><b>{}</b></p>"
        "<p>Click where it is. The thin cross is where it should be.</p>"
        '<p class="dim">Stage at {}</p>'
    ).format(chips, marks.places[n].name, stage)
    picture = corner_picture(snapshot.overview, job, marked_um, n)
    return Markup('<div class="wv-align">{}<div>{}</div></div>').format(picture, text)


def _chip(k: int, current: int, marked: bool) -> Markup:
    sign = html.icon(viser.Icon.CHECK, 13) if marked else ""
    chosen = Markup(' class="on"') if k == current else Markup()
    return Markup("<span{} {}>{}Corner {}</span>").format(chosen, html.pick("corner", k), sign, k + 1)


def operator_view(here: Here[PlanState], checks: tuple[PreflightCheck, ...]) -> Elements:
    """Return the first three of the four operator actions; the fourth, the verdict, follows in Acquire."""
    snapshot = here.snapshot
    job = snapshot.draft.job
    if job is None:
        return []
    inputs = plan_inputs(here)
    return [
        Html(_title(snapshot, job)),
        Html(here.page.notes(snapshot)),
        Html(html.head("1 · Wafer", "type the id or scan its barcode")),
        Html(Markup('<div class="wv-scan"></div>'), padded=False),
        *inputs("sample.wafer_id"),
        Stack(inputs("sample.lot", "sample.operator"), side_by_side=True),
        Html(FOCUS if not job.sample.wafer_id else "", padded=False),
        Stack(align_section(here, "2 · Align")),
        Html(section(checks, "3 · Start")),
    ]


def _title(snapshot: Snapshot, job: Job) -> Markup:
    plan, n = snapshot.draft.plan, len(job.all_fields())
    takes = f" · {duration(plan.predicted_s)}" if plan is not None else ""
    below = f"Revision {job.revision}, released · {plural(n, 'field')}{takes}"
    return html.title(
        job.product, below, html.title_action("Another job…", html.command_pick("jobs")) + unfold(more=True)
    )
