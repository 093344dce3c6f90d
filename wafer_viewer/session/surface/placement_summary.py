"""Summary of the field placement of a surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.session.state.snapshot import StitchingInfo

COVERAGE = 2.0
"""Coverage factor of the expanded uncertainties."""


def stitching_info(poses: Poses) -> StitchingInfo | None:
    """Return the summary of poses; None if they are stage positions only."""
    from wafer_viewer.reconstruct.registration.misplaced_fields import placed_by_stage

    shifts = poses.shifts
    if not shifts.first.size:
        return None
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
    found = [
        (DOUBT_TITLES[doubt], int(np.sum(codes == doubt))) for doubt in RejectionReason if doubt != RejectionReason.NONE
    ]
    return tuple(sorted(((title, n) for title, n in found if n), key=lambda reason: -reason[1]))
