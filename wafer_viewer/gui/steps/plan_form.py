"""The form of a plan: the values of a job as a person sees them, and the job with other values.

What is typed is applied field by field to the newest job. Input that makes no job stays in the session as it was typed,
until it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import msgspec

from wafer_viewer.gui.elements.elements import Input, NumberPair, Slider, Text
from wafer_viewer.gui.elements.form import spec_input
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.widgets.callbacks import COMMIT_S
from wafer_viewer.gui.widgets.number_field import PLACE, Pair, pair_of, pair_text
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, FollowFocus
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError, WaferViewerError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace, value_at, with_field
from wafer_viewer.session.state.snapshot import Snapshot, Typed

FIRST_FRAMES = 31
"""Number of frames of the first sweep over a sample of which only the size is known."""
SIZE, FOLLOW = "Size, mm", "Below, above focus, µm"
NOT_CHANGED = "The plan was not changed"


@dataclass(frozen=True, slots=True)
class PlanState:
    """State of the step.

    entered: values on their way to the session. range_um: focus range that was typed last; a coarse step shortens the
    range shown, and a finer one restores it. corner: alignment corner that was chosen to be marked.
    """

    entered: dict[str, Any] = field(default_factory=dict[str, Any])
    range_um: Pair | None = None
    corner: int | None = None


@dataclass(frozen=True, slots=True)
class PlanField:
    """A value of the form: that of a job, the job with another value, and its input.

    prepared: by an engineer, and fixed in a released job.
    """

    get: Callable[[Job], Any]
    put: Callable[[Job, Any], Job]
    make: Callable[..., Input]
    prepared: bool = True


def _rounded(*numbers: float) -> tuple[float, ...]:
    return tuple(round(number, 2) for number in numbers)


def _pair(text: str, name: str, over: float | None = None) -> Pair | None:
    try:
        return pair_of(text, name, over=over)
    except WaferViewerError as fault:
        raise PlanError(str(fault)) from fault


def _size(job: Job) -> str:
    size_um = job.sample.size_um
    return "" if size_um is None else pair_text((round(size_um[0] / 1000, 4), round(size_um[1] / 1000, 4)))


def _with_size(job: Job, text: str) -> Job:
    width_mm, height_mm = _pair(text, SIZE, over=0) or (0.0, 0.0)
    return replace(job, sample=replace(job.sample, width_um=1000 * width_mm, height_um=1000 * height_mm))


def _on_grid(change: Callable[[FieldGrid, Any], FieldGrid]) -> Callable[[Job, Any], Job]:
    """Return a change of the grid that leaves its centre where it is; a list of fields stays as it is."""

    def put(job: Job, value: Any) -> Job:
        return job if job.grid is None else replace(job, grid=change(job.grid, value).centred_on(*job.grid.center_um))

    return put


def _resized(grid: FieldGrid, counts: Pair) -> FieldGrid:
    return grid.resized(cols=round(counts[0]), rows=round(counts[1]))


def _overlapping(grid: FieldGrid, percent: float) -> FieldGrid:
    return replace(grid, overlap_x_fraction=percent / 100, overlap_y_fraction=percent / 100)


def _centred(job: Job, centre_um: Pair) -> Job:
    return job if job.grid is None else replace(job, grid=job.grid.centred_on(*centre_um))


def _sweep(job: Job) -> tuple[float, ...]:
    z0_um = job.z_start_um if job.grid else min(f.z_start_um for f in job.fields)
    return (*_rounded(z0_um, z0_um + job.sweep.range_um), job.sweep.z_step_um)


def _with_sweep(job: Job, value: tuple[float, float, float]) -> Job:
    """Return the job with a sweep from the lowest z upward, with as many frames as fit."""
    low, high, step_um = value
    if step_um <= 0:
        raise PlanError(f"The step of the focus sweep is {step_um:g} µm: it must be over 0.")
    if high <= low:
        raise PlanError(f"The focus sweep goes from {low:g} to {high:g} µm: the second must be higher than the first.")
    sweep = FocusSweep(z_step_um=step_um, n_frames=_frames_in((low, high), step_um))
    return replace(job, z_start_um=job.z_start_um if low == _sweep(job)[0] else low, sweep=sweep)


def _frames_in(range_um: Pair, step_um: float) -> int:
    return 1 + math.floor((range_um[1] - range_um[0]) / step_um + 1e-6)


def _with_exposures(job: Job, text: str) -> Job:
    try:
        times_us = tuple(float(part) for part in text.replace(";", ",").split(",") if part.strip())
    except ValueError:
        raise PlanError(f"The exposures read '{text}': they must be times in µs, separated by commas.") from None
    return replace(job, exposures_us=times_us)


def _follow(job: Job) -> str:
    follow = job.follow_focus
    return "" if follow is None else pair_text((follow.below_um, follow.above_um), PLACE)


def _with_follow(job: Job, text: str) -> Job:
    """Return the job with a depth about the focus; with the whole sweep if the text is empty."""
    depth_um, follow = _pair(text, FOLLOW), job.follow_focus or FollowFocus()
    made = None if depth_um is None else replace(follow, below_um=depth_um[0], above_um=depth_um[1])
    return replace(job, follow_focus=made)


def _at(path: str, *, prepared: bool = True) -> PlanField:
    def put(job: Job, value: Any) -> Job:
        return with_field(job, path, value.strip())

    return PlanField(lambda job: value_at(job, path), put, partial(spec_input, Job, path), prepared)


def _counts(job: Job) -> Pair:
    return (float(job.grid.cols), float(job.grid.rows)) if job.grid else (1.0, 1.0)


def _overlap(job: Job) -> float:
    return round(100 * job.grid.overlap_x_fraction, 2) if job.grid else 0.0


def _centre(job: Job) -> tuple[float, ...]:
    return _rounded(*job.grid.center_um) if job.grid else (0.0, 0.0)


def _exposures(job: Job) -> str:
    return ", ".join(f"{time_us:g}" for time_us in job.exposures_us)


COUNTS_HINT = "Fields side by side and one above the other; at least 1"
OVERLAP_HINT = "Of neighbouring fields, share of a field's side; 0 to 50 %. Stitching needs 8 % or more"
CENTRE_HINT = "Centre of the grid, stage x and y in µm"
RANGE_HINT = "Lowest and highest frame, stage z in µm"
TIMES_HINT = "One time, or several with commas: the frames of one z are then fused"
FOLLOW_HINT = (
    "Depth about the focus, such as 5, 5: a coarse look finds the focus, and every field takes its own part of the "
    "sweep. Empty: the whole sweep."
)
FIELDS: dict[str, PlanField] = {
    **{f"sample.{name}": _at(f"sample.{name}", prepared=False) for name in ("name", "lot", "wafer_id", "operator")},
    **{path: _at(path) for path in ("sample.product", "compression")},
    "size": PlanField(_size, _with_size, partial(Text, SIZE, hint="Width and height of the outline, mm; over 0")),
    "overlap": PlanField(
        _overlap, _on_grid(_overlapping), partial(Slider, "Overlap, %", hint=OVERLAP_HINT, most=50.0, step=0.5)
    ),
    "counts": PlanField(
        _counts, _on_grid(_resized), partial(NumberPair, "Columns, rows", hint=COUNTS_HINT, step=1, least=1)
    ),
    "centre": PlanField(_centre, _centred, partial(NumberPair, "Centre, µm", hint=CENTRE_HINT, decimals=2)),
    "sweep": PlanField(_sweep, _with_sweep, partial(NumberPair, "From, to, µm", hint=RANGE_HINT, step=0.5, decimals=2)),
    "exposures": PlanField(_exposures, _with_exposures, partial(Text, "Exposures, µs", hint=TIMES_HINT)),
    "follow": PlanField(_follow, _with_follow, partial(Text, FOLLOW, hint=FOLLOW_HINT)),
}
"""Values of the form, in the order in which they are applied; paths with dots are fields of the job."""


def no_job(operator: str = "") -> Job:
    """Return what the form begins with before there is a plan: it names the person who is signed in."""
    one = FieldGrid(rows=1, cols=1, field_width_um=1.0, field_height_um=1.0)
    return Job(sample=Sample(operator=operator), grid=one, sweep=FocusSweep(z_step_um=1.0, n_frames=FIRST_FRAMES))


def job_of(values: Mapping[str, Any], old: Job | None, limits: RigLimits | None, operator: str = "") -> Job:
    """Return a job with values of the form; without a job, the first one, which covers the sample.

    Raises PlanError with a message for the user if they make no valid job.
    """
    job = old or no_job(operator)
    for key, form_field in FIELDS.items():
        if key in values and values[key] != form_field.get(job):
            job = form_field.put(job, values[key])
    return job if old is not None else _first_job(job, limits)


def _first_job(named: Job, limits: RigLimits | None) -> Job:
    size_um = named.sample.size_um
    if limits is None:
        raise PlanError("The rig has not reported its limits yet: the grid follows when it is ready.")
    if size_um is None:
        raise PlanError("The sample has no size yet: type its width and height in mm, such as 12.5 × 8.")
    step_um = max(0.5, math.floor(limits.depth_of_field_um) / 2)
    grid = FieldGrid.covering(*size_um, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um)
    sweep = FocusSweep(z_step_um=step_um, n_frames=FIRST_FRAMES)
    return replace(named, grid=grid, z_start_um=-sweep.range_um / 2, sweep=sweep)


def typed_values(typed: Typed | None) -> dict[str, Any]:
    """Return stored input that makes no plan; empty if there is none, or that of another version."""
    try:
        values = msgspec.json.decode(typed.form, type=dict[str, str | float | tuple[float, ...]]) if typed else {}
    except (msgspec.DecodeError, msgspec.ValidationError):
        return {}
    known = all(key in FIELDS and _alike(FIELDS[key].get(no_job()), value) for key, value in values.items())
    return values if known else {}


def _alike(a: object, b: object) -> bool:
    return type(a) is type(b) and (not isinstance(a, tuple) or len(a) == len(b))  # type: ignore[arg-type]


def values_of(snapshot: Snapshot, entered: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that the form shows: those of the job, and over them what is typed."""
    job = snapshot.draft.job or no_job(snapshot.control.author(""))
    return {key: one.get(job) for key, one in FIELDS.items()} | typed_values(snapshot.draft.typed) | dict(entered)


def enter(here: Here[PlanState], key: str, value: Any) -> None:
    """Put a value of the form into the job; store it as it is if that makes no job."""
    page, entered = here.page, here.own.entered
    entered[key] = value
    snapshot = page.session.snapshot
    draft = snapshot.draft
    values = typed_values(draft.typed) | entered
    try:
        job = job_of(values, draft.job, snapshot.rig.limits, snapshot.control.author(""))
    except WaferViewerError as fault:
        answer = page.session.keep_typed(Typed(msgspec.json.encode(values).decode(), str(fault)))
    else:
        answer = page.session.keep_typed(None) if job == draft.job else page.session.edit_job(job)

    def arrived(_: Any) -> None:
        if entered.get(key) == value:
            del entered[key]
            here.redraw()

    page.ask(NOT_CHANGED, answer)
    answer.add_done_callback(arrived)


def plan_inputs(here: Here[PlanState]) -> Callable[..., list[Input]]:
    """Return the function that makes the inputs of values of the form; the range and the step of a sweep are two."""
    values, job = values_of(here.snapshot, here.own.entered), here.snapshot.draft.job

    def made(key: str) -> Input:
        if key == "step":
            step_um, put_step = values["sweep"][2], partial(_enter_step, here)
            return spec_input(Job, "sweep.z_step_um", step_um, put_step, **_state_of(job))
        form_field, value, put = FIELDS[key], values[key], partial(enter, here, key)
        if key == "sweep":
            value, put = value[:2], partial(_enter_range, here)
        return form_field.make(value=value, put=put, **_state_of(job, prepared=form_field.prepared))

    return lambda *keys: [made(key) for key in keys]


def _state_of(job: Job | None, *, prepared: bool = True) -> dict[str, Any]:
    """Return the state of inputs that an engineer prepares, which a released job has fixed, or of the others."""
    fixed = {"action": "Plan saved", "disabled": job is not None and job.released} if prepared else {}
    return {"commands": True, "pause_s": COMMIT_S, **fixed}


def _enter_range(here: Here[PlanState], range_um: Pair) -> None:
    here.keep(range_um=range_um)
    enter(here, "sweep", (*range_um, values_of(here.page.session.snapshot, here.own.entered)["sweep"][2]))


def _enter_step(here: Here[PlanState], step_um: float) -> None:
    snapshot = here.page.session.snapshot
    sweep = values_of(snapshot, here.own.entered)["sweep"]
    enter(here, "sweep", (*finer_range(snapshot.draft.job, sweep, here.own.range_um), step_um))


def finer_range(job: Job | None, sweep: tuple[float, float, float], typed_um: Pair | None) -> Pair:
    """Return the range for another step: as it was typed, if the present step has only rounded it to full steps."""
    if job is None or typed_um is None or sweep != _sweep(job) or typed_um[0] != sweep[0] or typed_um[1] <= typed_um[0]:
        return sweep[:2]
    return typed_um if _frames_in(typed_um, job.sweep.z_step_um) == job.sweep.n_frames else sweep[:2]
