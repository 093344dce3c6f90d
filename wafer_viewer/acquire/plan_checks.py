"""Checks of a scan that apply to every strategy, with their error messages."""

from __future__ import annotations

from collections import Counter

from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace

STEP_TOLERANCE = 0.01
"""Permitted relative deviation of a z step from whole counts of the scale."""


def check_fields(fields: tuple[Field, ...], limits: RigLimits) -> None:
    """Raise PlanError without fields, for a repeated number, or for a field outside the stage's range."""
    if not fields:
        raise PlanError("The plan has 0 fields: at least 1 is needed; lay a grid over the sample or list fields.")
    number, times = Counter(f.number for f in fields).most_common(1)[0]
    if times > 1:
        raise PlanError(f"Field number {number} is there {times} times: every field needs a number of its own.")
    for field in fields:
        _check_place(field, limits)


def check_exposures(exposures_us: tuple[float, ...], limits: RigLimits) -> None:
    """Raise PlanError without exposures, or for one that the camera cannot take."""
    if not exposures_us:
        raise PlanError("The plan has 0 exposures: at least 1 is needed; give an exposure time in us.")
    low_us, high_us = limits.camera.exposure_min_us, limits.camera.exposure_max_us
    for exposure_us in exposures_us:
        if not low_us <= exposure_us <= high_us:
            raise PlanError(
                f"The exposure of {exposure_us:g} us is out of the camera's range, {low_us:g} to {high_us:g} us: "
                "choose one within it and correct the brightness with the light."
            )


def check_sweep(fields: tuple[Field, ...], sweep: FocusSweep, limits: RigLimits) -> None:
    """Raise PlanError if a sweep leaves the z range or brings the objective too close to the sample."""
    for field in fields:
        _check_height(field, sweep, limits)
    _check_clearance(fields, sweep, limits)


def whole_counts(sweep: FocusSweep, limits: RigLimits) -> FocusSweep:
    """Return the sweep with its step in whole counts; raise PlanError if that changes it by over 1 %."""
    counts, count_um = limits.z.counts(sweep.z_step_um), 1 / limits.z.counts_per_um
    step_um = counts * count_um
    if abs(step_um - sweep.z_step_um) <= STEP_TOLERANCE * sweep.z_step_um:
        return replace(sweep, z_step_um=round(step_um, 9))
    below = int(sweep.z_step_um / count_um)
    nearest = " or ".join(f"{n * count_um:g} um" for n in sorted({max(1, below), below + 1}))
    raise PlanError(
        f"The z step of {sweep.z_step_um:g} um is {sweep.z_step_um / count_um:.2f} counts of the z scale and may be at "
        f"most {STEP_TOLERANCE:.0%} off whole counts: choose {nearest}."
    )


def _check_place(field: Field, limits: RigLimits) -> None:
    for name, at_um in (("x", field.x_um), ("y", field.y_um)):
        axis = limits.axis("x" if name == "x" else "y")
        if not axis.low_um <= at_um <= axis.high_um:
            raise PlanError(
                f"Field {field.number} lies at {name} {at_um:.1f} um, out of the stage's range "
                f"{axis.low_um:g} to {axis.high_um:g} um: move the grid or take fewer fields."
            )


def _check_height(field: Field, sweep: FocusSweep, limits: RigLimits) -> None:
    low_um, high_um = field.z_start_um, field.z_start_um + sweep.range_um
    if low_um < limits.z.low_um or high_um > limits.z.high_um:
        raise PlanError(
            f"Field {field.number} sweeps z {low_um:.1f} to {high_um:.1f} um, out of the stage's range "
            f"{limits.z.low_um:g} to {limits.z.high_um:g} um: change its z start or take a shorter sweep."
        )


def _check_clearance(fields: tuple[Field, ...], sweep: FocusSweep, limits: RigLimits) -> None:
    """Check the clearance: at the start of the lowest sweep the lens is closest to the highest point of the sample."""
    lowest = min(fields, key=lambda f: f.z_start_um)
    highest = max(fields, key=lambda f: f.z_start_um)
    drop_um = highest.z_start_um + sweep.range_um - lowest.z_start_um
    objective = limits.objective
    free_um = objective.working_distance_um - objective.clearance_um
    if drop_um > free_um:
        raise PlanError(
            f"Field {lowest.number} begins {drop_um:.1f} um under the highest focus of the scan, and the objective may "
            f"come down {free_um:g} um (working distance {objective.working_distance_um:g} um less clearance "
            f"{objective.clearance_um:g} um): take a shorter sweep."
        )
