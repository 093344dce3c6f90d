"""Pairwise registration of overlapping fields, with uncertainty and rejection reason.

The images are compared first: the normalised correlation of the true overlap at every shift within reach, at a quarter
of the resolution. The best candidates are then refined to sub-pixel accuracy. Where the images are blank the heights
are compared instead.

A pattern that repeats fits at several shifts. All of them are kept, as candidates among which the poses of all fields
choose (`candidate_choice`); the shift that was chosen is then measured by `refine`. Along lines a shift is
undetermined; across them it is as good as any.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress
from wafer_viewer.model.surface.field_poses import (
    N_CANDIDATE,
    N_DRIFT,
    ObservationSource,
    RejectionReason,
    Shifts,
    padded_candidates,
    unknown_drift,
)
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.block_gradients import variance_per_drift
from wafer_viewer.reconstruct.focus.focus_volume import on_threads
from wafer_viewer.reconstruct.registration.drift_pool import with_own_drift
from wafer_viewer.reconstruct.registration.overlap_strips import OverlapWindow, height_of, picture_of
from wafer_viewer.reconstruct.registration.picture_match import Candidate, Match, match, match_near

REACH_PX, WIDE_REACH_PX, WIDE_FRACTION = 40.0, 120.0, 0.125
"""Search reach: 40 px about the stage position by default, four standard deviations of a good stage.

Where both fields have structure but do not match there, the reach is 120 px or an eighth of the shorter side of a
field.
"""
LEAST_MEASURED = 0.1
"""Minimum measured fraction; with fewer heights nothing was in focus, and the images are noise and may differ."""
_LOST = (RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH)


@dataclass(frozen=True, slots=True, eq=False)
class PairShift:
    """Lateral shift measured in one overlap, with the meaning of the fields of `Shifts`."""

    x_um: float
    y_um: float
    u_x_um: float
    u_y_um: float
    covariance_um2: float
    correlation: float
    by: ObservationSource
    doubt: RejectionReason
    candidates: NDArray[np.float32]
    drift: NDArray[np.float64]


def register(
    heights: Sequence[HeightMap],
    pairs: NDArray[np.int32],
    reach_um: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Shifts:
    """Register each pair of fields (indices, int32 [n, 2]) relative to their stage positions.

    reach_um: largest deviation from the stage position that is searched; by default as `REACH_PX` states. Only the
    possible overlap is read. progress receives the finished fraction (0 ... 1); an exception raised by it ends the
    work. threads: all cores if omitted.
    """

    def one(n: int) -> PairShift:
        first, second = heights[pairs[n, 0]], heights[pairs[n, 1]]
        return register_pair(first, second, None if reach_um is None else reach_um / first.pixel_um)

    return _each(one, pairs, threads, progress)


def refine(
    heights: Sequence[HeightMap],
    pairs: NDArray[np.int32],
    shift_um: NDArray[np.float64],
    threads: int | None = None,
    progress: Progress | None = None,
) -> Shifts:
    """Measure shifts (x, y) that are known to about two pixels, [n, 2]; otherwise as `register`."""

    def one(n: int) -> PairShift:
        first, second = heights[pairs[n, 0]], heights[pairs[n, 1]]
        return refine_pair(first, second, (float(shift_um[n, 0]), float(shift_um[n, 1])))

    return _each(one, pairs, threads, progress)


def _each(
    work: Callable[[int], PairShift], pairs: NDArray[np.int32], threads: int | None, progress: Progress | None
) -> Shifts:
    found: list[PairShift] = [_by_stage(RejectionReason.BLANK)] * len(pairs)
    done = 0

    def one(n: int) -> None:
        nonlocal done
        found[n] = work(n)
        done += 1
        if progress is not None:
            progress(done / len(pairs))

    on_threads(one, range(len(pairs)), threads)
    return _table(pairs, found)


def register_pair(first: HeightMap, second: HeightMap, reach_px: float | None = None) -> PairShift:
    """Return the shift of the second field against the first, relative to their stage positions.

    reach_px: largest deviation along x and along y; by default as `REACH_PX` states. A rejected match retains its best
    shift and correlation, with a doubt; it must not be used.
    """
    found = _within(first, second, REACH_PX if reach_px is None else reach_px)
    wide_px = min(WIDE_REACH_PX, WIDE_FRACTION * min(*first.shape, *second.shape))
    if reach_px is not None or found.doubt not in _LOST or wide_px <= REACH_PX:
        return found
    wider = _within(first, second, wide_px)
    return wider if wider.doubt is RejectionReason.NONE else found


def refine_pair(first: HeightMap, second: HeightMap, shift_um: tuple[float, float]) -> PairShift:
    """Return the shift near one that is known to about two pixels, relative to the stage positions."""
    x_um, y_um = shift_um
    moved = replace(second, x0_um=second.x0_um + x_um, y0_um=second.y0_um + y_um)
    found = _pair_shift(match_near(first, moved, picture_of), first.pixel_um, ObservationSource.PICTURE)
    return replace(found, x_um=found.x_um + x_um, y_um=found.y_um + y_um)


def _within(first: HeightMap, second: HeightMap, reach_px: float) -> PairShift:
    """Register by images, by heights where the images are blank, or else by the stage."""
    match_window = match(first, second, reach_px, picture_of)
    if match_window.doubt in _LOST and _measured_share(first, second) < LEAST_MEASURED:
        return _by_stage(RejectionReason.BLANK)
    if match_window.doubt is not RejectionReason.BLANK:
        return _pair_shift(match_window, first.pixel_um, ObservationSource.PICTURE)
    felt = match(first, second, reach_px, height_of)
    if felt.doubt is RejectionReason.NONE:
        return _pair_shift(felt, first.pixel_um, ObservationSource.HEIGHT)
    return _by_stage(RejectionReason.BLANK)


def _measured_share(first: HeightMap, second: HeightMap) -> float:
    """Return the measured fraction of an overlap, in the field that has less."""
    common = OverlapWindow.of(first, second, 0, 1).common
    shares = (np.isfinite(h.z_raw_um[part]).mean() for h, part in zip((first, second), common, strict=True))
    return min(map(float, shares))


def _pair_shift(found: Match, pixel_um: float, by: ObservationSource) -> PairShift:
    (down, right), (u_down, u_right) = found.off_px, found.u_px
    return PairShift(
        x_um=right * pixel_um,
        y_um=-down * pixel_um,
        u_x_um=u_right * pixel_um,
        u_y_um=u_down * pixel_um,
        covariance_um2=-float(found.covariance[0, 1]) * pixel_um**2,
        correlation=found.correlation,
        by=by,
        doubt=found.doubt,
        candidates=_listed(found.candidates, pixel_um),
        drift=_drift(found, pixel_um) if by is ObservationSource.PICTURE else unknown_drift(1)[0],
    )


def _drift(found: Match, pixel_um: float) -> NDArray[np.float64]:
    """Return a row of `Shifts.drift`, NaN where the drift is unknown."""
    if not np.isfinite(found.drift).all():
        return unknown_drift(1)[0]
    scatter = np.diag(found.covariance) - variance_per_drift(found.drift_freedom) * np.maximum(found.drift, 0.0)
    return np.append(np.concatenate((scatter[::-1], found.drift[::-1])) * pixel_um**2, found.drift_freedom)


def _listed(candidates: Sequence[Candidate], pixel_um: float) -> NDArray[np.float32]:
    """Return candidates as rows of `Shifts.candidates`, [k, 6]."""
    if not candidates:
        return np.zeros((0, N_CANDIDATE), np.float32)
    down, right = np.array([one.off_px for one in candidates]).T
    precision = np.linalg.inv(np.array([one.covariance for one in candidates])) / pixel_um**2
    misfit_nats = [one.misfit_nats for one in candidates]
    columns = precision[:, 1, 1], -precision[:, 0, 1], precision[:, 0, 0], misfit_nats
    return np.column_stack((right * pixel_um, -down * pixel_um, *columns)).astype(np.float32)


def _by_stage(doubt: RejectionReason) -> PairShift:
    nothing, unknown = np.zeros((0, N_CANDIDATE), np.float32), unknown_drift(1)[0]
    return PairShift(0.0, 0.0, float("inf"), float("inf"), 0.0, 0.0, ObservationSource.STAGE, doubt, nothing, unknown)


def _table(pairs: NDArray[np.int32], found: Sequence[PairShift]) -> Shifts:
    table = np.array([(f.x_um, f.y_um, f.u_x_um, f.u_y_um, f.covariance_um2) for f in found], np.float64).reshape(-1, 5)
    doubt = np.array([f.doubt for f in found], np.uint8)
    shifts = Shifts(
        first=np.array(pairs[:, 0], np.int32),
        second=np.array(pairs[:, 1], np.int32),
        x_um=table[:, 0].copy(),
        y_um=table[:, 1].copy(),
        u_x_um=table[:, 2].copy(),
        u_y_um=table[:, 3].copy(),
        covariance_um2=np.nan_to_num(table[:, 4], nan=0.0, posinf=0.0, neginf=0.0),
        correlation=np.array([f.correlation for f in found], np.float32),
        by=np.array([f.by for f in found], np.uint8),
        doubt=doubt,
        weight=(doubt == RejectionReason.NONE).astype(np.float32),
        residual_x_um=np.zeros(len(pairs)),
        residual_y_um=np.zeros(len(pairs)),
        candidates=padded_candidates([f.candidates for f in found]),
        drift=np.array([f.drift for f in found], np.float64).reshape(-1, N_DRIFT),
    )
    return with_own_drift(shifts)  # the same bits as those that are restored after a pooling
