"""Conversion between the form of the plan panel and a job."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import msgspec

from wafer_viewer.gui.widgets.number_field import Pair, pair_of, pair_text
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError, WaferViewerError
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Typed

FIRST_FRAMES = 31
"""Number of frames of the first sweep over a sample of which only the size is known."""


@dataclass(frozen=True, slots=True)
class PlanForm:
    """Inputs of the plan panel, in the units shown there."""

    name: str = ""
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    operator: str = ""
    size_mm: str = ""
    columns_rows: tuple[float, float] = (1.0, 1.0)
    overlap_percent: float = 10.0
    centre_um: tuple[float, float] = (0.0, 0.0)
    range_um: tuple[float, float] = (0.0, 0.0)
    step_um: float = 1.0
    exposures_us: str = "100"


def form_of(job: Job | None) -> PlanForm:
    """Return the form of a job; an empty form without a job."""
    if job is None:
        return PlanForm()
    sample, grid, sweep = job.sample, job.grid, job.sweep
    z0_um = job.z_start_um if grid else min(f.z_start_um for f in job.fields)
    return PlanForm(
        name=sample.name,
        lot=sample.lot,
        wafer_id=sample.wafer_id,
        product=sample.product,
        operator=sample.operator,
        size_mm=_size_text(sample),
        columns_rows=(float(grid.cols), float(grid.rows)) if grid else (1.0, 1.0),
        overlap_percent=round(100 * grid.overlap_x_fraction, 2) if grid else 0.0,
        centre_um=_rounded(grid.center_um) if grid else (0.0, 0.0),
        range_um=_rounded((z0_um, z0_um + sweep.range_um)),
        step_um=sweep.z_step_um,
        exposures_us=", ".join(f"{e:g}" for e in job.exposures_us),
    )


def text_of(form: PlanForm) -> str:
    """Serialise a form as JSON, to store it while it is not a valid plan."""
    return msgspec.json.encode(form).decode()


def stored_form(typed: Typed | None) -> PlanForm | None:
    """Return the stored form; None if there is none, or one of another version."""
    try:
        return msgspec.json.decode(typed.form, type=PlanForm) if typed is not None else None
    except (msgspec.DecodeError, msgspec.ValidationError):
        return None


def job_of(form: PlanForm, old: Job | None, limits: RigLimits | None) -> Job:
    """Return the job of a form; settings of the old job that the form does not show are kept.

    Raises PlanError with a message for the user if the form is not a valid job.
    """
    if old is None:
        return _first_job(form, limits)
    before = form_of(old)
    return replace(
        old,
        sample=_sample(form, old.sample),
        grid=_grid(form, before, old.grid) if old.grid else None,
        z_start_um=old.z_start_um if form.range_um[0] == before.range_um[0] else form.range_um[0],
        sweep=old.sweep if _same_sweep(form, before) else sweep_of(form),
        exposures_us=_exposures(form.exposures_us),
    )


def sweep_of(form: PlanForm) -> FocusSweep:
    """Return the focus sweep from the lowest z upward, with as many frames as fit; raise PlanError if invalid."""
    low, high = form.range_um
    if form.step_um <= 0:
        raise PlanError(f"The step of the focus sweep is {form.step_um:g} µm: it must be over 0.")
    if high <= low:
        raise PlanError(f"The focus sweep goes from {low:g} to {high:g} µm: the second must be higher than the first.")
    return FocusSweep(z_step_um=form.step_um, n_frames=_frames_in(form.range_um, form.step_um))


def _frames_in(range_um: tuple[float, float], step_um: float) -> int:
    return 1 + math.floor((range_um[1] - range_um[0]) / step_um + 1e-6)


def with_typed_range(form: PlanForm, job: Job | None, typed_um: tuple[float, float] | None) -> PlanForm:
    """Return the form with the typed focus range instead of the range rounded to full steps.

    A coarse step shortens the displayed range; a finer step entered next must restore it.
    """
    if job is None or typed_um is None:
        return form
    before = form_of(job)
    untouched = form.range_um == before.range_um and typed_um[0] == before.range_um[0] and typed_um[1] > typed_um[0]
    led_here = untouched and _frames_in(typed_um, job.sweep.z_step_um) == job.sweep.n_frames
    return dataclasses.replace(form, range_um=typed_um) if led_here else form


def _first_job(form: PlanForm, limits: RigLimits | None) -> Job:
    size_um = _size_um(form)
    if limits is None:
        raise PlanError("The rig has not reported its limits yet: the grid follows when it is ready.")
    if size_um is None:
        raise PlanError("The sample has no size yet: type its width and height in mm, such as 12.5 × 8.")
    width_um, height_um = size_um
    step_um = max(0.5, math.floor(limits.depth_of_field_um) / 2)
    return Job(
        sample=_sample(form, Sample()),
        grid=FieldGrid.covering(
            width_um, height_um, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um
        ),
        z_start_um=-step_um * (FIRST_FRAMES - 1) / 2,
        sweep=FocusSweep(z_step_um=step_um, n_frames=FIRST_FRAMES),
        exposures_us=_exposures(form.exposures_us),
    )


def _size_um(form: PlanForm) -> Pair | None:
    """Return width and height of the sample; None if they are not given."""
    try:
        size_mm = pair_of(form.size_mm, "Size, mm", over=0)
    except WaferViewerError as fault:
        raise PlanError(str(fault)) from fault
    return None if size_mm is None else (1000 * size_mm[0], 1000 * size_mm[1])


def _size_text(sample: Sample) -> str:
    size_um = sample.size_um
    return "" if size_um is None else pair_text((round(size_um[0] / 1000, 4), round(size_um[1] / 1000, 4)))


def _sample(form: PlanForm, old: Sample) -> Sample:
    width_um, height_um = _size_um(form) or (None, None)
    if form.size_mm == _size_text(old):
        width_um, height_um = old.width_um, old.height_um
    return replace(
        old,
        name=form.name.strip(),
        lot=form.lot.strip(),
        wafer_id=form.wafer_id.strip(),
        product=form.product.strip(),
        operator=form.operator.strip(),
        width_um=width_um,
        height_um=height_um,
    )


def _grid(form: PlanForm, before: PlanForm, old: FieldGrid) -> FieldGrid:
    """Return the grid around the form's centre; around the old, unrounded centre if it is unchanged."""
    grid = old
    if form.overlap_percent != before.overlap_percent:
        overlap = form.overlap_percent / 100
        grid = replace(grid, overlap_x_fraction=overlap, overlap_y_fraction=overlap)
    if form.columns_rows != before.columns_rows:
        cols, rows = (round(n) for n in form.columns_rows)
        grid = grid.resized(rows=rows, cols=cols)
    centre = old.center_um if form.centre_um == before.centre_um else form.centre_um
    return old if grid == old and centre == old.center_um else grid.centred_on(*centre)


def _same_sweep(form: PlanForm, before: PlanForm) -> bool:
    return form.step_um == before.step_um and form.range_um == before.range_um


def _exposures(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.replace(";", ",").split(",") if part.strip())
    except ValueError:
        raise PlanError(f"The exposures read '{text}': they must be times in µs, separated by commas.") from None


def _rounded(pair: tuple[float, float]) -> tuple[float, float]:
    return round(pair[0], 2), round(pair[1], 2)
