"""Pairwise registration of overlapping fields, with uncertainty and rejection reason.

The images are compared first: the normalised correlation of the true overlap at every shift within reach, at a quarter
of the resolution. The best candidates are then refined to sub-pixel accuracy. Where the images are blank the heights
are compared instead.

A pattern that repeats fits at several shifts. All of them are kept, as candidates among which the poses of all fields
choose (`candidate_choice`); the shift that was chosen is then measured by `refine`. Along lines a shift is
undetermined; across them it is as good as any.

Parts of a picture that come from different frames are displaced against each other. A single overlap holds few such
parts: the variance that it shows has as few degrees of freedom as two, and is often far too small by chance. How far
parts are displaced is a property of the scan, which its overlaps share.

A search over all shifts needs a match that stands out among hundreds. In narrow overlaps, in noise, and along lines a
true match may not. Where the other overlaps, or the stage, say about where it should be, a few refinements from there
and from the best match of the search decide: the pictures are accepted only if they are alike, and if all beginnings
that end in a likeness agree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress
from wafer_viewer.model.surface.field_poses import (
    N_BEND,
    N_CANDIDATE,
    N_DRIFT,
    Numbers,
    ObservationSource,
    RejectionReason,
    Shifts,
    padded_candidates,
    selected,
    unknown_bend,
    unknown_drift,
)
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.block_gradients import variance_per_drift
from wafer_viewer.reconstruct.focus.focus_volume import on_threads
from wafer_viewer.reconstruct.registration.overlap_strips import OverlapWindow, height_of, picture_of
from wafer_viewer.reconstruct.registration.picture_match import Candidate, Match, match, match_near

# ---------------------------------------------------------------------------------------------------------- second look


Refine = Callable[[NDArray[np.int32], Numbers], Shifts]
LEAST_CORRELATION = 0.7
"""Smallest correlation of a match that is accepted; `tests/bench/bench_grids.py` set it, on seeds below 200."""
RIVAL = 0.85
"""Smallest correlation of a rival, relative to the best."""
SAME_PX = 2.0
"""Distance, in determined directions, below which two beginnings ended at the same shift, in pixels."""
REACH_SIGMAS = 2.5
"""Largest deviation from the expected shift, in its standard deviations."""
STEP_PX = 4.0
"""Distance of the beginnings, in pixels."""
SURE_PX = 1.5
"""Uncertainty of an expected shift below which one beginning will do, in pixels."""
_STEPS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Beginnings of a match about the expected shift, in steps along x and y."""
_NOT_FOUND = (RejectionReason.BLANK, RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH, RejectionReason.AMBIGUOUS)


def look_again(shifts: Shifts, expected_um: Numbers, u_um: Numbers, pixel_um: float, refine: Refine) -> Shifts:
    """Return the shifts with those lost overlaps accepted that fit where they are expected.

    expected_um: [e, 2]; u_um: its standard uncertainty along an axis, [e]. Patterns that repeat are left open. Where
    there seemed to be nothing to compare, only the expected shift is tried. A match of the search that may be chance is
    tried too, however far the poses allow it.
    """
    lost = np.flatnonzero(np.isin(shifts.doubt, _NOT_FOUND) & ~shifts.repeats)
    if not len(lost):
        return shifts
    pairs, at_um = np.column_stack((shifts.first, shifts.second))[lost], expected_um[lost]
    reach_um = REACH_SIGMAS * np.maximum(u_um[lost], SURE_PX * pixel_um)
    many = (u_um[lost] > SURE_PX * pixel_um) & (shifts.doubt[lost] != RejectionReason.BLANK)
    searched = selected(shifts, lost)
    found_um = np.column_stack((searched.x_um, searched.y_um))
    near = _determined_um(searched, found_um - at_um) < reach_um
    begins = [(many | (not any(step)), at_um + np.array(step) * STEP_PX * pixel_um) for step in _STEPS]
    begins.append((near & (searched.correlation > LEAST_CORRELATION), found_um))
    ends: list[Shifts] = []
    for those, begin_um in begins:
        some = np.flatnonzero(those)
        found = refine(pairs[some], begin_um[some]) if len(some) else None
        ends.append(_spread(found, some, searched))
    best = _agreed(ends, pixel_um)
    off_um = np.column_stack((best.x_um, best.y_um)) - at_um
    accepted = best.believed & (_determined_um(best, off_um) < reach_um)
    return _replaced(shifts, lost[accepted], selected(best, accepted))


def _spread(found: Shifts | None, rows: NDArray[np.intp], every: Shifts) -> Shifts:
    """Return some rows among all of them; the others have no likeness."""
    nothing = replace(every, correlation=np.zeros(len(every.first), np.float32))
    return nothing if found is None else _replaced(nothing, rows, found)


def _replaced(shifts: Shifts, rows: NDArray[np.intp], found: Shifts) -> Shifts:
    columns = {}
    for item in fields(Shifts):
        column = getattr(shifts, item.name).copy()
        if item.name not in ("first", "second", "candidates"):
            column[rows] = getattr(found, item.name)
        columns[item.name] = column
    return Shifts(**columns)


def _agreed(ends: list[Shifts], pixel_um: float) -> Shifts:
    """Return the ends with the highest correlation, ambiguous where another that is about as high lies elsewhere."""
    alike = np.array(
        [np.where(end.believed & (end.correlation > LEAST_CORRELATION), end.correlation, 0) for end in ends]
    )
    which = alike.argmax(axis=0)
    best = ends[0]
    for n, end in enumerate(ends):
        rows = np.flatnonzero(which == n)
        best = _replaced(best, rows, selected(end, rows))
    at = np.column_stack((best.x_um, best.y_um))
    rivals = [
        (likeness > RIVAL * alike.max(axis=0))
        & (_determined_um(best, np.column_stack((end.x_um, end.y_um)) - at) > SAME_PX * pixel_um)
        for end, likeness in zip(ends, alike, strict=True)
    ]
    is_open = np.any(rivals, axis=0) | (alike.max(axis=0) <= LEAST_CORRELATION)
    return replace(best, doubt=np.where(is_open, np.uint8(RejectionReason.AMBIGUOUS), best.doubt).astype(np.uint8))


def _determined_um(shifts: Shifts, off_um: Numbers) -> Numbers:
    """Return the lengths [e] of offsets [e, 2], without the direction of lines where shifts are undetermined."""
    covariance = np.zeros((len(off_um), 2, 2))
    u = np.column_stack((shifts.u_x_um, shifts.u_y_um))
    known = np.isfinite(u).all(axis=1)
    covariance[known, 0, 0], covariance[known, 1, 1] = u[known].T ** 2
    covariance[known, 0, 1] = covariance[known, 1, 0] = shifts.covariance_um2[known]
    variance, axes = np.linalg.eigh(covariance)
    along = np.einsum("ea,eab->eb", off_um, axes)
    loose = variance > 100 * np.maximum(variance[:, :1], 1e-12)
    return np.hypot(*np.where(loose & (variance > 100), 0.0, along).T)


# ----------------------------------------------------------------------------------------------------------- drift pool


ALIKE_FREEDOM = 6.0
"""Weight of the drift of the scan in that of an overlap, in degrees of freedom; overlaps differ beyond chance."""


def with_own_drift(shifts: Shifts) -> Shifts:
    """Return shifts with the uncertainties that each overlap shows by itself."""
    return _with_drift(shifts, np.maximum(shifts.drift[:, 2:4], 0.0))


def with_pooled_drift(shifts: Shifts) -> Shifts:
    """Return shifts with uncertainties in which the drift of an overlap is shrunk towards that of all of them.

    That of the scan comes from the median of those not rejected, since a wrong overlap may show any drift; that of few
    is widened, as it may be too small by chance. An overlap that shows less than none, by chance, counts so. It
    replaces that of an earlier pooling. Where the drift is unknown, as along lines, the uncertainty stays as it is.
    """
    sound = np.isin(shifts.doubt, (RejectionReason.NONE, RejectionReason.DISAGREES))
    told = shifts.drift[sound & np.isfinite(shifts.drift).all(axis=1)]
    if not len(told):
        return shifts
    usual_um2 = np.maximum(np.median(told[:, 2:4] / _median_of_chi2(told[:, 4:]), axis=0), 0.0)
    of_scan_um2 = usual_um2 * (1 + 2 / told[:, 4].sum())
    own_um2, freedom = shifts.drift[:, 2:4], shifts.drift[:, 4:]
    shrunk_um2 = (freedom * own_um2 + ALIKE_FREEDOM * of_scan_um2) / (freedom + ALIKE_FREEDOM)
    return _with_drift(shifts, np.maximum(shrunk_um2, 0.0))


def _median_of_chi2(freedom: Numbers) -> Numbers:
    """Return the median of a variance with some degrees of freedom, relative to its mean.

    By E. B. Wilson, M. M. Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684.
    """
    return (1 - 2 / (9 * freedom)) ** 3


def _with_drift(shifts: Shifts, drift_um2: Numbers) -> Shifts:
    """Return shifts with uncertainties for a variance of the shifts of parts along x and y, [n, 2]."""
    known = np.isfinite(shifts.drift).all(axis=1)
    variance_um2 = shifts.drift[:, :2] + variance_per_drift(shifts.drift[:, 4:]) * drift_um2
    u_um = np.sqrt(np.maximum(variance_um2, 0.0))
    return replace(
        shifts, u_x_um=np.where(known, u_um[:, 0], shifts.u_x_um), u_y_um=np.where(known, u_um[:, 1], shifts.u_y_um)
    )


# ---------------------------------------------------------------------------------------------------- pair registration


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
    bend: NDArray[np.float64]


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

    def register_some(todo: Iterator[int]) -> None:
        nonlocal done
        for n in todo:
            found[n] = work(n)
            done += 1
            if progress is not None:
                progress(done / len(pairs))

    on_threads(register_some, range(len(pairs)), threads)
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
        bend=np.append(found.bend, found.unbent) if by is ObservationSource.PICTURE else unknown_bend(1)[0],
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
    unknown = np.zeros((0, N_CANDIDATE), np.float32), unknown_drift(1)[0], unknown_bend(1)[0]
    return PairShift(0.0, 0.0, float("inf"), float("inf"), 0.0, 0.0, ObservationSource.STAGE, doubt, *unknown)


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
        bend=np.array([f.bend for f in found], np.float64).reshape(-1, N_BEND),
    )
    return with_own_drift(shifts)  # the same bits as those that are restored after a pooling
