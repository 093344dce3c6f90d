"""Plans for tests that need one but scan nothing of interest: as an object, and as the text of a plan file."""

from __future__ import annotations

from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.job import Job


def plan_without_motion(job: Job, shape: tuple[int, int], pixel_um: float) -> ScanPlan:
    """The plan of a job whose frames, of `shape` (rows, cols), no rig takes."""
    rows, cols = shape
    return ScanPlan(
        fields=job.all_fields(),
        sweep=job.sweep,
        exposures_us=job.exposures_us,
        strategy="z_up",
        legs=(),
        predicted_s=1.0,
        prices=(),
        rows=rows,
        cols=cols,
        pixel_um=pixel_um,
    )


def die_beside_its_trench(n_frames: int, z_start_um: float = -6.0, exposures_us: str = "") -> str:
    """The text of a plan with comments, of one field on the virtual wafer; `exposures_us` is left out if empty."""
    exposures = f"\nexposures_us = {exposures_us}" if exposures_us else ""
    return f"""# The die beside its trench
product = "test"  # as on the carrier
z_start_um = {z_start_um}{exposures}

[grid]  # one field
rows = 1
cols = 1
field_width_um = 336.4488
field_height_um = 252.3366
x0_um = 800.0
y0_um = 560.0
[sweep]
z_step_um = 3.0
n_frames = {n_frames}
"""
