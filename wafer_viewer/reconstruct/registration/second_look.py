"""Second look at overlaps that the search did not find, at the shifts that the poses of all fields expect.

A search over all shifts needs a match that stands out among hundreds. In narrow overlaps, in noise, and along lines a
true match may not. Where the other overlaps, or the stage, say about where it should be, a few refinements from there
and from the best match of the search decide: the pictures are accepted only if they are alike, and if all beginnings
that end in a likeness agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts, selected

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
_LOST = (RejectionReason.BLANK, RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH, RejectionReason.AMBIGUOUS)


def look_again(shifts: Shifts, expected_um: Numbers, u_um: Numbers, pixel_um: float, refine: Refine) -> Shifts:
    """Return the shifts with those lost overlaps accepted that fit where they are expected.

    expected_um: [e, 2]; u_um: its standard uncertainty along an axis, [e]. Patterns that repeat are left open. Where
    there seemed to be nothing to compare, only the expected shift is tried. A match of the search that may be chance is
    tried too, however far the poses allow it.
    """
    lost = np.flatnonzero(np.isin(shifts.doubt, _LOST) & ~shifts.repeats)
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
