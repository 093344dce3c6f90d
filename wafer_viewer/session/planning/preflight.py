"""Preflight checks before a scan: sample, alignment, calibration, disk, clearance, light, each with its remedy."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from wafer_viewer.model.acquisition.calibration import UNKNOWN_OBJECTIVE, Calibration, OpticalSetup
from wafer_viewer.model.acquisition.plan import FieldGrid, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.session.state.snapshot import LatestFrame, Snapshot
from wafer_viewer.store.io.atomic_files import size

State = Literal["ok", "attention", "stop"]
ROOM_FOR_SURFACES = 0.25
"""Disk space of the surfaces as a fraction of the frames' size."""
DUE_SOON_DAYS = 14
CLIPPED = 0.05
"""Fraction of clipped pixels of the last frame above which the light check asks for attention."""


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """Result of one check: subject, state, finding and remedy.

    ``stop`` forbids the scan; ``attention`` needs confirmation by a person.
    """

    what: str
    state: State
    found: str
    mend: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Preflight:
    """Inputs of the checks. confirmed: True if a person confirmed that the sample on the stage is the named one.

    clipped_fraction: fraction of clipped pixels of the last frame, None before there is one; today: ISO 8601. n_marked:
    number of alignment corners marked on the stage.
    """

    job: Job
    plan: ScanPlan
    limits: RigLimits
    simulated: bool
    calibration: Calibration | None
    setup: OpticalSetup | None
    free_bytes: int | None
    z_um: float
    today: str
    confirmed: bool = True
    clipped_fraction: float | None = None
    n_marked: int = 0


def preflight_of_snapshot(now: Snapshot, latest: LatestFrame | None, today: str) -> tuple[PreflightCheck, ...]:
    """Return the six checks of a snapshot's plan; none while there is no plan or no rig."""
    draft, rig = now.draft, now.rig
    if draft.job is None or draft.plan is None or rig.limits is None:
        return ()
    return preflight(
        Preflight(
            job=draft.job,
            plan=draft.plan,
            limits=rig.limits,
            simulated=rig.simulated,
            calibration=rig.calibration,
            setup=rig.setup,
            free_bytes=draft.free_bytes,
            z_um=rig.z_um,
            today=today,
            confirmed=draft.confirmed,
            clipped_fraction=None if latest is None else latest.clipped_fraction,
            n_marked=sum(place_um is not None for place_um in draft.marked_um),
        )
    )


def preflight(now: Preflight) -> tuple[PreflightCheck, ...]:
    """Return the six checks, always in the same order, and that of the objective where the plan or the rig needs it."""
    return (*(look(now) for look in LOOKS), *objective(now))


def stops(checks: Iterable[PreflightCheck]) -> tuple[PreflightCheck, ...]:
    """Return the checks that forbid the scan."""
    return tuple(check for check in checks if check.state == "stop")


def require_passed(checks: Iterable[PreflightCheck], *, confirmed: bool = True) -> None:
    """Raise PlanError with the first check that forbids the scan, or that a person still has to confirm."""
    for check in checks:
        if check.state == "stop" or (check.state == "attention" and not confirmed):
            raise PlanError(f"The scan does not start. {check.what}: {check.found} {check.mend}".rstrip())


def sample(now: Preflight) -> PreflightCheck:
    """Check that the sample under the objective is known."""
    sample_of_job, released = now.job.sample, now.job.released
    if released and not sample_of_job.wafer_id:
        return PreflightCheck("Sample", "stop", "The wafer has no id.", "Type or scan it.")
    if not now.simulated and not (sample_of_job.name or sample_of_job.wafer_id):
        return PreflightCheck("Sample", "stop", "The sample has no name.", "Type a name or a wafer id.")
    named = sample_of_job.wafer_id or sample_of_job.name or "a sample without a name"
    of_lot = f"{named} of lot {sample_of_job.lot}" if sample_of_job.lot else named
    if not now.confirmed:
        found = f"{of_lot}: not confirmed since the plan was opened again."
        return PreflightCheck("Sample", "stop", found, "Check and confirm it.")
    return PreflightCheck("Sample", "ok", f"{of_lot}.")


def alignment(now: Preflight) -> PreflightCheck:
    """Check that the orientation and position of the wafer are known."""
    marks, found = now.job.marks, now.job.alignment
    if marks is None:
        state: State = "stop" if now.job.released else "ok"
        mend = "Let the engineer name corners to align by." if now.job.released else ""
        return PreflightCheck("Alignment", state, "Without alignment: places are those of the stage.", mend)
    if found is None:
        state, mend = ("stop", "Mark them.") if now.job.released else ("attention", "Mark them, or start without.")
        return PreflightCheck(
            "Alignment", state, f"Not aligned: {now.n_marked} of {len(marks.places)} corners marked.", mend
        )
    fit = f"{found.n_marks} corners, residual {found.residual_um:.1f} um of {marks.limit_um:g} um"
    if found.residual_um > marks.limit_um:
        return PreflightCheck("Alignment", "stop", f"{fit}: too large.", "Mark the named corners again.")
    return PreflightCheck("Alignment", "ok", f"{fit}.")


def calibration(now: Preflight) -> PreflightCheck:
    """Check that lengths will have an uncertainty."""
    state: State = "stop" if now.job.released else "attention"
    mend = "Calibrate: without it there is no verdict." if now.job.released else "Lengths will read 'uncalibrated'."
    if now.calibration is None:
        return PreflightCheck("Calibration", state, "The rig has no calibration.", mend)
    problem = now.calibration.problem(now.setup or now.calibration.setup, now.today)
    if problem is not None:
        return PreflightCheck("Calibration", state, f"{problem[:1].upper()}{problem[1:]}.", mend)
    if now.calibration.simulated:
        return PreflightCheck("Calibration", "ok", "That of the simulation.")
    return PreflightCheck("Calibration", "ok", f"Valid, due {_due(now.calibration.due, now.today)}.")


def disk(now: Preflight) -> PreflightCheck:
    """Check that the disk has space for the frames."""
    needs = now.plan.bytes_on_disk
    if now.free_bytes is None:
        return PreflightCheck(
            "Disk", "attention", f"{size(needs)} needed; the free space is unknown.", "Look at the disk."
        )
    words = f"{size(needs)} needed, {size(now.free_bytes)} free"
    if now.free_bytes < needs:
        return PreflightCheck("Disk", "stop", f"{words}.", "Free some space or serve another folder.")
    if now.free_bytes < (1 + ROOM_FOR_SURFACES) * needs:
        return PreflightCheck("Disk", "attention", f"{words}: little is left for the surfaces.", "Free some space.")
    return PreflightCheck("Disk", "ok", f"{words}.")


def clearance(now: Preflight) -> PreflightCheck:
    """Check the clearance of the objective from the highest point of the sample, which is taken as the highest focus.

    The focus is a working distance below the objective. At stage height z, the distance from that point is the working
    distance minus the height of the highest focus above z. The stage may travel sideways at the safe height, so no
    focus may be above it.
    """
    objective = now.limits.objective
    lows = [field.z_start_um for field in now.plan.fields]
    highest_um = max(lows) + now.plan.sweep.range_um
    nearest_um = objective.working_distance_um - (highest_um - min(*lows, now.z_um, highest_um))
    words = f"{_mm(nearest_um)} at the nearest, {_mm(objective.clearance_um)} at least"
    if nearest_um < objective.clearance_um:
        deep = "Raise the stage" if now.z_um < min(lows) else "Take a shorter sweep"
        return PreflightCheck("Clearance", "stop", f"The objective comes too near: {words}.", f"{deep}.")
    if highest_um > objective.safe_z_um:
        found = (
            f"The sweep ends {highest_um - objective.safe_z_um:.0f} um over the safe height {objective.safe_z_um:g} um."
        )
        return PreflightCheck("Clearance", "stop", found, "Mount the sample lower, or have the safe height reset.")
    return PreflightCheck("Clearance", "ok", f"{words}.")


def light(now: Preflight) -> PreflightCheck:
    """Check that frames will be bright enough and not clipped."""
    times = ", ".join(f"{t:g}" for t in now.plan.exposures_us)
    words = f"{100 * now.job.light_fraction:.0f} % at {times} us"
    if now.job.light_fraction == 0:
        return PreflightCheck("Light", "stop", "The light is off.", "Set a share of the light over 0.")
    if now.clipped_fraction is None:
        return PreflightCheck("Light", "ok", f"{words}; no frame was seen yet.")
    words = f"{words}; {100 * now.clipped_fraction:.1f} % of the last frame is too bright"
    if now.clipped_fraction > CLIPPED:
        return PreflightCheck(
            "Light", "attention", f"{words}.", "Expose for a shorter time, or add a shorter exposure."
        )
    return PreflightCheck("Light", "ok", f"{words}.")


def objective(now: Preflight) -> tuple[PreflightCheck, ...]:
    """Check that the objective is known, and the one that the plan was made for; none if any will do."""
    wanted, setup = now.job, now.setup or OpticalSetup()
    if setup.objective == UNKNOWN_OBJECTIVE:
        found, mend = "The objective in the light path is not known.", "Turn the nosepiece and set the zoom in Live."
        return (PreflightCheck("Objective", "stop", found, mend),)
    has = f"{setup.objective or 'an objective without a name'} at zoom {setup.zoom:g}"
    wants = f"{wanted.objective or setup.objective} at zoom {wanted.zoom or setup.zoom:g}"
    if wanted.objective not in ("", setup.objective) or wanted.zoom not in (None, setup.zoom):
        found = f"The plan is for {wants}, the rig has {has}."
        return (PreflightCheck("Objective", "stop", found, "Change it, or plan again."),)
    if (grid := wanted.grid) is not None and not _fields_meet(grid, now.limits):
        found = (
            f"A frame of {has} is {now.limits.field_width_um:.0f} x {now.limits.field_height_um:.0f} um, the fields of "
            f"the plan are {grid.pitch_x_um:.0f} x {grid.pitch_y_um:.0f} um apart: there are gaps between them."
        )
        return (PreflightCheck("Objective", "attention", found, "Change the objective, or the size of the fields."),)
    return (PreflightCheck("Objective", "ok", f"{has}, as planned."),) if wanted.objective or wanted.zoom else ()


def _fields_meet(grid: FieldGrid, limits: RigLimits) -> bool:
    """Return whether frames of the rig leave no gaps between the fields of a grid."""
    across = grid.cols == 1 or grid.pitch_x_um <= limits.field_width_um
    return across and (grid.rows == 1 or grid.pitch_y_um <= limits.field_height_um)


LOOKS: tuple[Callable[[Preflight], PreflightCheck], ...] = (sample, alignment, calibration, disk, clearance, light)


def _due(due: str, today: str) -> str:
    days = (datetime.date.fromisoformat(due) - datetime.date.fromisoformat(today)).days
    return f"{due}, in {days} days" if days <= DUE_SOON_DAYS else due


def _mm(length_um: float) -> str:
    return f"{length_um / 1000:.1f} mm"
