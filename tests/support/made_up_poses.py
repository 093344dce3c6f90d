"""Poses as stitching would find them, made up: fields on a stage that errs, some overlaps not to be believed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.field_poses import (
    DOUBT_TITLES,
    Form,
    HeightOffsets,
    Poses,
    RejectionReason,
    Shifts,
    no_candidates,
    unknown_bend,
    unknown_drift,
)
from wafer_viewer.session.state.snapshot import StitchingInfo

STAGE_ERROR_UM, Z_ERROR_UM = 2.8, 1.0
FORM = Form(
    names=("height", "tilt along x", "tilt along y", "bow"), u_um=(0.14, 0.31, 0.34, 0.82), camera_turn=1.2e-4,
    u_camera_turn=2e-6, camera_scale=-4e-5, u_camera_scale=3e-6,
)  # fmt: skip


def pairs_of(fields: Sequence[Field], width_um: float, height_um: float) -> list[tuple[int, int]]:
    """Neighbours along x and y, by their place in the list."""
    found = []
    for i, a in enumerate(fields):
        for j in range(i + 1, len(fields)):
            across, down = abs(fields[j].x_um - a.x_um), abs(fields[j].y_um - a.y_um)
            if across < width_um and down < height_um and (across < 0.3 * width_um or down < 0.3 * height_um):
                found.append((i, j))
    return found


def made_up_poses(
    fields: Sequence[Field],
    width_um: float,
    height_um: float,
    doubts: Mapping[tuple[int, int], RejectionReason] | None = None,
    left_out: Sequence[int] = (),
    seed: int = 4,
    n_groups: int = 1,
) -> Poses:
    """Poses of fields; `doubts` and `left_out` go by running numbers."""
    rng, n = np.random.default_rng(seed), len(fields)
    place = {f.number: k for k, f in enumerate(fields)}
    stage_x, stage_y = np.array([f.x_um for f in fields]), np.array([f.y_um for f in fields])
    out = np.isin([f.number for f in fields], left_out)
    off_x, off_y = (np.where(out, 0.0, rng.normal(0, STAGE_ERROR_UM, n)) for _ in range(2))
    pairs = np.array(pairs_of(fields, width_um, height_um), np.int32).reshape(-1, 2)
    doubt = np.zeros(len(pairs), np.uint8)
    for (a, b), reason in (doubts or {}).items():
        doubt[(pairs == (place[a], place[b])).all(axis=1)] = reason
    doubt[out[pairs].any(axis=1)] = RejectionReason.UNLIKE
    believed = doubt == RejectionReason.NONE
    u = np.where(out, STAGE_ERROR_UM, rng.uniform(0.04, 0.09, n))
    return Poses(
        numbers=np.array([f.number for f in fields], np.int32),
        marks=np.zeros(n, np.int64),
        stage_x_um=stage_x,
        stage_y_um=stage_y,
        x_um=stage_x + off_x,
        y_um=stage_y + off_y,
        z_um=rng.normal(0, Z_ERROR_UM, n),
        tilt_x=rng.normal(0, 1e-4, n),
        tilt_y=rng.normal(0, 1e-4, n),
        u_x_um=u,
        u_y_um=0.8 * u,
        u_z_um=np.full(n, 0.03),
        group=(np.arange(n) * n_groups // n).astype(np.int32),
        left_out=out,
        shifts=_shifts(pairs, doubt, believed, rng),
        seams=_seams(pairs, believed, rng),
        form=FORM,
        stage_error_um=STAGE_ERROR_UM,
        z_error_um=Z_ERROR_UM,
    )


def _shifts(pairs: np.ndarray, doubt: np.ndarray, believed: np.ndarray, rng: np.random.Generator) -> Shifts:
    n = len(pairs)
    off = np.where(believed, 0.03, np.where(doubt == RejectionReason.BLANK, np.nan, 6.0))
    return Shifts(
        first=pairs[:, 0].copy(),
        second=pairs[:, 1].copy(),
        x_um=rng.normal(0, STAGE_ERROR_UM, n),
        y_um=rng.normal(0, STAGE_ERROR_UM, n),
        u_x_um=np.where(doubt == RejectionReason.BLANK, np.inf, 0.03),
        u_y_um=np.where(doubt == RejectionReason.BLANK, np.inf, 0.03),
        correlation=rng.uniform(0.8, 0.98, n).astype(np.float32),
        by=np.zeros(n, np.uint8),
        doubt=doubt,
        weight=believed.astype(np.float32),
        residual_x_um=off * rng.normal(0, 1, n),
        residual_y_um=off * rng.normal(0, 1, n),
        covariance_um2=np.zeros(n),
        candidates=no_candidates(n),
        drift=unknown_drift(n),
        bend=unknown_bend(n),
    )


def _seams(pairs: np.ndarray, believed: np.ndarray, rng: np.random.Generator) -> HeightOffsets:
    n, zero = len(pairs), np.zeros(len(pairs))
    return HeightOffsets(
        first=pairs[:, 0].copy(),
        second=pairs[:, 1].copy(),
        mid_x_um=zero,
        mid_y_um=zero,
        z_um=rng.normal(0, Z_ERROR_UM, n),
        slope_x=zero,
        slope_y=zero,
        information=np.zeros((n, 3, 3)),
        n_pixels=np.full(n, 90_000, np.int32),
        weight=believed.astype(np.float32),
        step_um=rng.normal(0, 0.012, n),
        rms_um=np.full(n, 0.11),
    )


def stitching_of(poses: Poses, notes: tuple[str, ...] = ()) -> StitchingInfo:
    """The numbers of poses."""
    counts = {d: int((poses.shifts.doubt == d).sum()) for d in RejectionReason if d != RejectionReason.NONE}
    stored = ~poses.left_out
    moved = np.hypot(poses.x_um - poses.stage_x_um, poses.y_um - poses.stage_y_um)[stored]
    steps = np.abs(poses.seams.step_um)
    return StitchingInfo(
        n_overlaps=len(poses.shifts.first),
        n_believed=int(poses.shifts.believed.sum()),
        doubts=tuple((DOUBT_TITLES[d], n) for d, n in sorted(counts.items(), key=lambda c: -c[1]) if n),
        stage_error_um=poses.stage_error_um,
        z_error_um=poses.z_error_um,
        moved_rms_um=float(np.sqrt((moved**2).mean())),
        moved_max_um=float(moved.max()),
        position_u_um=float(2 * np.sqrt((poses.u_x_um[stored] ** 2).mean())),
        height_u_um=0.062,
        step_median_um=float(np.median(steps)),
        step_p95_um=float(np.percentile(steps, 95)),
        form=tuple(zip(poses.form.names, poses.form.u_um, strict=True)),
        n_groups=len(np.unique(poses.group[stored])),
        left_out=tuple(poses.numbers[poses.left_out].tolist()),
        notes=notes,
    )
