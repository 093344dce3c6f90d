"""Focus curve of a pixel, and the placement of the fields below it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Field, ScanPlan
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.state.snapshot import StitchingInfo

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.result import Result


COVERAGE = 2.0
"""Coverage factor of the expanded uncertainties."""


def stitching_info(poses: Poses) -> StitchingInfo | None:
    """Return the summary of poses; None if they are stage positions only."""
    from wafer_viewer.reconstruct.registration.misplaced_fields import placed_by_stage

    shifts = poses.shifts
    if not shifts.first.size:
        return None
    sure = poses.overlap_period_probability[shifts.believed]
    sure = sure[np.isfinite(sure)]
    moved_um = np.hypot(poses.x_um - poses.stage_x_um, poses.y_um - poses.stage_y_um)[~poses.left_out]
    steps_um = np.abs(poses.seams.step_um[np.isfinite(poses.seams.step_um)])
    position_u_um = np.hypot(poses.u_x_um, poses.u_y_um) / np.sqrt(2)
    return StitchingInfo(
        n_overlaps=shifts.first.size,
        n_believed=int(shifts.believed.sum()),
        doubts=_doubts(shifts.doubt),
        stage_error_um=poses.stage_error_um,
        z_error_um=poses.z_error_um,
        moved_rms_um=float(np.sqrt(np.mean(moved_um**2))) if moved_um.size else 0.0,
        moved_max_um=float(moved_um.max(initial=0.0)),
        position_u_um=COVERAGE * float(np.median(position_u_um)),
        height_u_um=COVERAGE * float(np.median(poses.u_z_um)),
        step_median_um=float(np.median(steps_um)) if steps_um.size else None,
        step_p95_um=float(np.percentile(steps_um, 95)) if steps_um.size else None,
        form=tuple((name, u) for name, u in zip(poses.form.names, poses.form.u_um, strict=True) if np.isfinite(u)),
        n_groups=int(np.unique(poses.group[~poses.left_out]).size),
        left_out=tuple(poses.numbers[poses.left_out].tolist()),
        notes=poses.notes,
        n_by_stage=int(placed_by_stage(poses).sum()),
        n_periodic=int((shifts.repeats & shifts.believed).sum()),
        period_probability=float(sure.min()) if sure.size else None,
    )


def as_stitched(fields: Sequence[Field], poses: Poses | None) -> list[Field]:
    """Return fields at their positions in the stitched surface; at their stage positions if they are not in it."""
    if poses is None:
        return list(fields)
    row = {number: i for i, number in enumerate(poses.numbers.tolist())}
    moved = ((field, row.get(field.number)) for field in fields)
    return [f if i is None else replace(f, x_um=float(poses.x_um[i]), y_um=float(poses.y_um[i])) for f, i in moved]


def _doubts(codes: NDArray[np.uint8]) -> tuple[tuple[str, int], ...]:
    """Return the reasons for rejected overlaps and their numbers, the most frequent first."""
    reasons = [
        (DOUBT_TITLES[doubt], int(np.sum(codes == doubt))) for doubt in RejectionReason if doubt != RejectionReason.NONE
    ]
    return tuple(sorted(((title, n) for title, n in reasons if n), key=lambda reason: -reason[1]))


def focus_curve(
    dataset: Path,
    result: str,
    field_number: int,
    x_um: float,
    y_um: float,
    recipe: Recipe | None = None,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> FocusCurve:
    """Return the focus curve at a position of a dataset; field_number 0: of the field with the nearest centre.

    A position on the stitched surface (field_number 0) is located in the field's displayed place, one on a field at its
    stage position. recipe: None means the recipe of the field's surface, or the default if there is none yet. Raises
    DatasetError when no field contains the position or its frames do not exist.
    """
    from wafer_viewer.reconstruct import focus_evidence
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    stored = data.result(result)
    field = data.field(field_number) if field_number else field_at(data, stored, x_um, y_um)
    stack = dataclasses.replace(data.stack(field.number), field=field)
    return focus_evidence.focus_curve(stack, x_um, y_um, recipe or _recipe_of(stored, field))


def field_at(data: Dataset, stored: Result, x_um: float, y_um: float) -> Field:
    """Return the field with the nearest centre of those that contain a position, as displayed in the stitched surface.

    Fields with a surface take precedence. Raises DatasetError if there is none.
    """
    plan = data.scan.plan
    if not data.fields:
        raise DatasetError(f"{data.path.name} is a surface without frames: there is no focus curve to look at.")
    holding = [f for f in as_stitched(data.fields, stored.poses()) if _holds(plan, f, data.scan.pixel_um, x_um, y_um)]
    if not holding:
        raise DatasetError(
            f"({x_um:.1f}, {y_um:.1f}) um lies in no field of {data.path.name}: "
            f"choose a place between {_ends(plan, data.fields, data.scan.pixel_um)} um."
        )
    done = stored.surfaces_done(holding)
    return min(holding, key=lambda f: (f.number not in done, math.hypot(f.x_um - x_um, f.y_um - y_um)))


def _recipe_of(stored: Result, field: Field) -> Recipe:
    return stored.surface(field).provenance.recipe if stored.surfaces_done([field]) else Recipe()


def _holds(plan: ScanPlan, field: Field, pixel_um: float, x_um: float, y_um: float) -> bool:
    return 2 * abs(x_um - field.x_um) < plan.cols * pixel_um and 2 * abs(y_um - field.y_um) < plan.rows * pixel_um


def _ends(plan: ScanPlan, fields: Iterable[Field], pixel_um: float) -> str:
    """Return the lowest and the highest corner of all fields, as text."""
    half_x, half_y = plan.cols * pixel_um / 2, plan.rows * pixel_um / 2
    x, y = [f.x_um for f in fields], [f.y_um for f in fields]
    return f"({min(x) - half_x:.1f}, {min(y) - half_y:.1f}) and ({max(x) + half_x:.1f}, {max(y) + half_y:.1f})"
