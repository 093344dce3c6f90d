"""The step Plan: sample, field grid, focus sweep, and cost of each scan strategy; a released job's operator actions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, duration, number, plural, share, size, with_unit
from wafer_viewer.gui.dialogs.open_and_export import load_plan_dialog, save_dialog
from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Elements,
    Html,
    Input,
    Stack,
)
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import unfold
from wafer_viewer.gui.steps.align import ALIGN_PICKS, align_section, operator_view
from wafer_viewer.gui.steps.follow import follow_section
from wafer_viewer.gui.steps.job_dialogs import (
    edit,
    feature_dialog,
    job_table,
    jobs_dialog,
    load_job,
    required_job,
    start_dialog,
)
from wafer_viewer.gui.steps.plan_form import NOT_CHANGED, PlanState, plan_inputs
from wafer_viewer.gui.steps.preflight_lines import section
from wafer_viewer.gui.steps.release import drop_feature, release_section
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.plan import Price
from wafer_viewer.model.acquisition.procedure import FoundExposure
from wafer_viewer.model.job import Job
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.planning.plan_editor import PLAN_ENDING, suggested_name
from wafer_viewer.session.planning.preflight import PreflightCheck, preflight_of_snapshot, stops
from wafer_viewer.session.state.snapshot import Draft, Snapshot

GRID_FAILED, EXPOSURE_FAILED = "The grid was not changed", "The exposure was not found"
NOT_STARTED, NOT_SAVED = "The scan did not start", "The plan was not saved"
ICON = viser.Icon
_GAP = Markup('<div style="height:8px"></div>')


def plan_step(here: Here[PlanState]) -> Elements | None:
    """Return the whole plan with its form; for a released job the operator's actions, unless all is unfolded."""
    snapshot, view = here.snapshot, here.view
    if view.step != "plan" or view.live:
        return None
    checks = _checks(here, snapshot)
    why = _why_not(snapshot, checks)
    job = snapshot.draft.job
    operating = job is not None and job.released and not view.everything
    begin = partial(start, here)
    return [  # each view has places of its own: what is hidden must not come between neighbours
        Stack(operator_view(here, checks), failed=NOT_CHANGED) if operating else None,
        Stack(_whole_plan(here, checks), failed=NOT_CHANGED) if not operating else None,
        Html("" if operating and stops(checks) else start_hint(snapshot.draft, why)),
        Button(
            "Start scan",
            begin,
            ICON.PLAYER_PLAY,
            "leading",
            disabled=why is not None,
            commands=True,
            failed=NOT_STARTED,
            height_px=46,
        ),
    ]


def start(here: Here[PlanState]) -> None:
    """Start the scan and go to Acquire; ask for confirmation first if a preflight check is open."""
    page = here.page
    checks = _checks(here, page.session.snapshot)

    def now(_: Any = None) -> None:
        page.ask(NOT_STARTED, page.session.start_scan(), lambda _: page.change(step="acquire"))

    if all(check.state == "ok" for check in checks):
        now()
    else:
        start_dialog(page, checks, now)


def save(page: Page) -> None:
    """Open the dialog that saves the plan."""
    name = f"{suggested_name(required_job(page))}{PLAN_ENDING}"
    save_dialog(page, "Save the plan", name, page.session.save_plan, "Plan saved", NOT_SAVED)


def why_not_start(here: Here[PlanState], snapshot: Snapshot) -> str | None:
    """Return why the scan cannot start now, or None."""
    return _why_not(snapshot, _checks(here, snapshot))


def _checks(here: Here[PlanState], snapshot: Snapshot) -> tuple[PreflightCheck, ...]:
    return preflight_of_snapshot(snapshot, here.page.session.latest_frame, today())


def _why_not(snapshot: Snapshot, checks: tuple[PreflightCheck, ...]) -> str | None:
    draft, rig = snapshot.draft, snapshot.rig
    if snapshot.scanning:
        return "a scan is running."
    if not rig.can_start:
        return rig.message or f"the rig is {rig.state}."
    operating = snapshot.control.refusal("Job released") is not None
    if operating and not (draft.job is not None and draft.job.released):
        return "choose a released job: operators run no other plan."
    if draft.typed is not None or draft.job is None:
        return draft.typed.problem if draft.typed else "the sample has no size."
    if draft.problem or draft.plan is None:
        return draft.problem or "the time of the plan is being estimated."
    return next((f"{check.found} {check.mend}" for check in stops(checks)), None)


def _verb(ask: str, verb: Callable[[Here[PlanState]], Any]) -> Callable[[Here[PlanState], str], None]:
    return lambda here, _: here.page.ask(ask, verb(here))


PICKS: dict[str, Callable[[Here[PlanState], str], Any]] = {
    **ALIGN_PICKS,
    "strategy": lambda here, name: edit(here.page, "The strategy was not changed", strategy=name),
    "job": lambda here, path: load_job(here.page, Path(path)),
    "jobs": lambda here, _: jobs_dialog(here.page),
    "feature": lambda here, key: feature_dialog(here.page, int(key)),
    "no-feature": lambda here, key: drop_feature(here.page, int(key)),
    "everything": lambda here, key: here.page.change(everything=key == "yes"),
    "focus-row": lambda here, row: here.page.change(focus_row=int(row)),
    "cover": _verb(GRID_FAILED, lambda here: here.page.session.cover_sample()),
    "undo": _verb("Nothing was undone", lambda here: here.page.session.undo()),
    "redo": _verb("Nothing was redone", lambda here: here.page.session.redo()),
    "bracket": _verb("The bracket was not taken", lambda here: here.page.session.take_bracket()),
}
"""What clicks on links and rows of the step do."""


def _whole_plan(here: Here[PlanState], checks: tuple[PreflightCheck, ...]) -> Elements:
    snapshot, draft, page = here.snapshot, here.snapshot.draft, here.page
    jobs = snapshot.operating.jobs if draft.job is None else ()
    inputs = plan_inputs(here)
    return [
        Html(_title(draft)),
        Html(page.notes(snapshot)),
        Html(job_table(jobs, "job") if jobs else ""),
        Stack(_sample(inputs)),
        Html(grid_head(snapshot)),
        Stack(_grid(here, draft.job, inputs)) if draft.job is not None and draft.job.grid is not None else None,
        Html(_sweep_head(draft)),
        Stack(_sweep(here, draft.job, inputs)) if draft.job is not None else None,
        Stack(follow_section(here)),
        Html(strategies(snapshot, draft)),
        Buttons(
            [
                _engineer("Save plan…", partial(save, page), ICON.DEVICE_FLOPPY, failed=NOT_SAVED),
                Button("Load plan…", partial(load_plan_dialog, page), ICON.FOLDER_OPEN, commands=True),
            ]
        ),
        release_section(page, snapshot),
        Stack(align_section(here, "Align")),
        Html(section(checks)),
    ]


def _engineer(label: str, act: Callable[[], Any], icon: Any, disabled: bool = False, failed: str = "") -> Button:
    """Return the button of something that an engineer does."""
    return Button(label, act, icon, disabled=disabled, commands=True, action="Plan saved", failed=failed)


def _sample(inputs: Callable[..., list[Input]]) -> Elements:
    return [
        Html(html.head("Sample")),
        *inputs("sample.name"),
        Stack(inputs("sample.lot", "sample.wafer_id"), side_by_side=True),
        Stack(inputs("sample.product", "sample.operator"), side_by_side=True),
        *inputs("size"),
    ]


def _grid(here: Here[PlanState], job: Job, inputs: Callable[..., list[Input]]) -> Elements:
    session = here.page.session
    cover = _engineer("Cover the sample", session.cover_sample, ICON.ARROWS_MAXIMIZE, job.released, GRID_FAILED)
    centre = _engineer("Move to stage", session.centre_on_stage, ICON.CROSSHAIR, job.released, GRID_FAILED)
    return [*inputs("counts", "overlap", "centre"), Buttons([cover, centre])]


def _sweep(here: Here[PlanState], job: Job, inputs: Callable[..., list[Input]]) -> Elements:
    snapshot, find = here.snapshot, here.page.session.find_exposure
    busy = job.released or snapshot.draft.plan is None or not snapshot.rig.can_start
    return [
        *inputs("sweep", "step", "follow", "exposures"),
        Buttons([_engineer("Find the exposure", find, ICON.BRIGHTNESS_UP, busy, EXPOSURE_FAILED)]),
        Html(found_exposure(snapshot)),
        *inputs("compression"),
        Html(_depth_of_field_warning(snapshot, job)),
    ]


def _title(draft: Draft) -> Markup:
    if draft.job is not None and draft.job.released:
        title = f"{draft.job.product}, revision {draft.job.revision}"
        return html.title(title, "Released: only the names of the wafer can be changed.", unfold(more=False))
    below = "Lay out the fields, choose the focus range and the fastest strategy."
    return html.title(
        "Plan the scan", below if draft.job else "Enter the size of the sample; the grid follows.", _history(draft)
    )


def _history(draft: Draft) -> Markup:
    """Return the undo and redo actions of the title."""
    undo, redo = html.icon(ICON.ARROW_BACK_UP, 17), html.icon(ICON.ARROW_FORWARD_UP, 17)
    return html.title_action(undo, html.command_pick("undo"), "Undo · Ctrl + Z", draft.can_undo) + html.title_action(
        redo, html.command_pick("redo"), "Redo · Ctrl + Shift + Z", draft.can_redo
    )


def grid_head(snapshot: Snapshot) -> Markup:
    """Return the head of the field grid, or what is missing for a grid."""
    job = snapshot.draft.job
    if job is None:
        cover = html.command_link("Use the sample on the stage", "cover", action="Plan saved")
        on_stage = Markup('<div class="wv-why">{}</div>').format(cover) if snapshot.overview is not None else ""
        return html.head("Field grid") + html.empty("The grid follows from the size of the sample.") + on_stage
    if job.grid is None:
        return html.head("Fields", f"{len(job.fields)} fields from the plan's list")
    n = job.grid.rows * job.grid.cols
    extent = f"{number(job.grid.width_um, 0)} × {with_unit(job.grid.height_um, 0)}"
    return html.head("Field grid", f"{plural(n, 'field')} · {extent}")


def _sweep_head(draft: Draft) -> Markup:
    if draft.job is None:
        return Markup()
    sweep = draft.job.sweep
    return html.head("Focus sweep", f"{sweep.n_frames} frames · {with_unit(sweep.range_um, 1)}")


def _depth_of_field_warning(snapshot: Snapshot, job: Job) -> Markup:
    """Return a warning if the z step exceeds half the depth of field."""
    limits, step_um = snapshot.rig.limits, job.sweep.z_step_um
    if limits is None or step_um <= limits.depth_of_field_um / 2 + 1e-9:
        return Markup()
    fact = f"{with_unit(step_um, 2)} is over half the depth of field, {with_unit(limits.depth_of_field_um / 2, 1)}"
    sign = html.icon(ICON.ALERT_TRIANGLE, 18)
    return html.note("attention", "The step is coarse", f"{fact}: heights become less certain.", sign=sign)


def found_exposure(snapshot: Snapshot) -> Markup:
    """Return the exposure found and what it was found from, as long as the plan has it; else empty."""
    found, job = snapshot.exposure, snapshot.draft.job
    if found is None or job is None or job.exposures_us not in (found.single_us, found.bracket_us):
        return Markup()
    single, fields = found.single, ", ".join(map(str, found.fields))
    facts = (
        f"Brightest pixels at {share(single.level, 0)} of white in field {single.brightest_field}; searched in "
        f"field{'s' if len(found.fields) > 1 else ''} {fields}, {len(found.z_um)} positions over "
        f"{with_unit(found.z_um[-1], 1)}."
    )
    suits = f"{_time(single.exposure_us)}{THIN}µs suits the brightest field"
    return html.note("good", suits, facts) + _bracket(found, job.exposures_us)


def _bracket(found: FoundExposure, exposures_us: tuple[float, ...]) -> Markup:
    """Return the proposed bracket with its figures and the link that takes it; empty if there is none."""
    if not found.bracket:
        return Markup()
    rows = [
        html.row([_time(one.exposure_us), share(one.clipped_fraction), share(one.dark_fraction)], "nnn")
        for one in found.bracket
    ]
    table = html.table(["Exposure, µs", "Clipped", "Dark"], rows, "nnn")
    if exposures_us == found.bracket_us:
        return table
    dark = f"{share(found.single.dark_fraction)} of the pixels are darker than 5 % of white"
    take = html.command_link("Take the bracket", "bracket", action="Plan saved")
    return html.note("attention", "One exposure leaves dark areas", f"{dark}: a bracket shows them.", take) + table


def _time(exposure_us: float) -> str:
    return number(exposure_us, 0 if exposure_us >= 100 else 1)


def strategies(snapshot: Snapshot, draft: Draft) -> Markup:
    """Return all strategies with their time, and time and disk space of the chosen one."""
    job, plan, limits = draft.job, draft.plan, snapshot.rig.limits
    if job is None:
        waiting = html.empty("Every strategy is listed here with its time", "as soon as there is a grid.")
        return html.head("Strategy") + waiting + _GAP
    by_hand = "Chosen by hand. " + html.command_link("Use the fastest", "strategy", "auto", "Plan saved")
    chosen = html.remark(by_hand if job.strategy != "auto" else "")
    if plan is None:
        problem = html.typeset(draft.problem or "The time of every strategy is being estimated.")
        return html.head("Strategy") + html.empty(problem) + chosen + _GAP
    rate = f" at {number(limits.camera.frame_rate_hz, 0)} frames/s" if limits else ""
    best_s = min((p.predicted_s for p in plan.prices if p.predicted_s), default=0.0)
    prices = sorted(plan.prices, key=lambda p: (p.ruled_out is not None, p.predicted_s or 0.0))
    rows = [_price_row(price, best_s, chosen=price.strategy == plan.strategy) for price in prices]
    short = draft.free_bytes is not None and draft.free_bytes < plan.bytes_on_disk
    figures = [
        html.figure("Predicted time", duration(plan.predicted_s)),
        _size_figure("On disk", plan.bytes_on_disk),
        _size_figure("Free", draft.free_bytes, "fault" if short else "good"),
    ]
    head = html.head("Strategy", f"for {number(plan.n_frames, 0)} frames{rate}")
    return (
        head
        + html.table(["", "Time", "Motions", "× best"], rows, " nnn")
        + chosen
        + _GAP
        + html.columns(figures)
        + _GAP
    )


def start_hint(draft: Draft, why_not: str | None) -> Markup:
    """Return the line above the button: why it is disabled, else the cost of the scan (visible in low windows only)."""
    if why_not is not None:
        return html.why_not(why_not, " wv-at-foot")
    if draft.plan is None:
        return Markup()
    free = f", {size(draft.free_bytes)} free" if draft.free_bytes is not None else ""
    cost = Markup("<b>{}</b> · {} on disk{}").format(
        duration(draft.plan.predicted_s), size(draft.plan.bytes_on_disk), free
    )
    return Markup('<div class="wv-why wv-at-foot wv-low-only">{}</div>').format(cost)


def _price_row(price: Price, best_s: float, *, chosen: bool) -> Markup:
    name = Markup("{}").format(price.title)
    if price.look_s:
        look = f"{'about ' if price.estimated else ''}{duration(price.look_s)} of it coarse look"
        name += Markup("<small>{}</small>").format(look)
    if price.ruled_out is not None or price.predicted_s is None:
        why = html.typeset(price.ruled_out or "not estimated")
        return Markup('<tr class="off"><td colspan="4">{}<small>{}</small></td></tr>').format(name, why)
    ratio = price.predicted_s / best_s if best_s else 1.0
    cells = [name, duration(price.predicted_s), number(price.motions, 0), number(ratio, 2 if ratio < 9.95 else 1)]
    return html.row(cells, " nnn", html.command_pick("strategy", price.strategy, "Plan saved"), "sel" if chosen else "")


def _size_figure(label: str, n_bytes: int | None, tone: html.Tone | None = None) -> Markup:
    value, _, unit = size(n_bytes).rpartition(THIN)
    return html.figure(label, value or unit, unit if value else "", tone=tone)
