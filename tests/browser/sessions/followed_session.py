"""A plan that follows the focus, after its coarse look: one place without a focus, and a rise at one corner."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tests.browser.sessions import fake_session as fake
from wafer_viewer.acquire.focus.coarse_look import spread
from wafer_viewer.model.acquisition.plan import (
    CoarseLook,
    Field,
    FieldGrid,
    FocusCell,
    FocusPlace,
    FocusSweep,
    FollowFocus,
)
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.plan_editor import focus_of, plan_of
from wafer_viewer.session.state.snapshot import Snapshot

BLANK = 4
"""Place, in the order of the look, that has no focus."""


def focus_um(field: Field) -> float:
    """Height of the sample at a field."""
    x, y = field.x_um / 1000, field.y_um / 1000
    return 30 * x - 12 * y + 14 * math.sin(1.7 * x + y)


def followed() -> Snapshot:
    """The snapshot after the look."""
    job = following_job()
    fields = job.all_fields()
    wanted = [fields[i] for i in spread_over(fields, 12)]
    places = tuple(_place(field, blank=n == BLANK) for n, field in enumerate(wanted))
    plan = plan_of(replace(job, strategy="follow_focus"), fake.LIMITS, CoarseLook(places=places, duration_s=12.0))
    draft = dataclasses.replace(fake.draft_of(None), job=job, plan=plan, can_undo=True)
    return dataclasses.replace(fake.planned(), draft=dataclasses.replace(draft, focus=focus_of(plan, fake.LIMITS)))


def following_job() -> Job:
    """A job of 8 x 6 fields over the sample."""
    job = fake.a_job()
    grid = FieldGrid(
        rows=6, cols=8, field_width_um=fake.LIMITS.field_width_um, field_height_um=fake.LIMITS.field_height_um
    )
    sweep = FocusSweep(z_step_um=4.0, n_frames=101)
    return replace(
        job, grid=grid.centred_on(0.0, 0.0), fields=(), z_start_um=-200.0, sweep=sweep, follow_focus=FollowFocus()
    )


def spread_over(fields: tuple[Field, ...], n_places: int) -> list[int]:
    """Indices of fields far from each other."""
    return spread(np.array([(field.x_um, field.y_um) for field in fields]), n_places)


def _place(field: Field, *, blank: bool) -> FocusPlace:
    low_um = focus_um(field)
    cells = () if blank else (FocusCell(field.x_um, field.y_um, low_um, low_um + 12.0),)
    return FocusPlace(field=field.number, x_um=field.x_um, y_um=field.y_um, cells=cells, u_um=1.3)
