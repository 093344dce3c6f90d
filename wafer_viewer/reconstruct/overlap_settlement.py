"""Overlaps of fields, registered until they are settled.

register -> choose among repeats -> solve positions -> look again at lost overlaps -> exclude fields that fit nowhere
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap, Outline
from wafer_viewer.model.surface.recipe import Stitching
from wafer_viewer.reconstruct.pose_graph.candidate_choice import choose_candidates
from wafer_viewer.reconstruct.pose_graph.lateral_poses import CameraAxes, Positions, PreviousSolution, solve_positions
from wafer_viewer.reconstruct.registration.misplaced_fields import misplaced_fields
from wafer_viewer.reconstruct.registration.overlap_strips import neighbours
from wafer_viewer.reconstruct.registration.pair_registration import look_again, with_pooled_drift
from wafer_viewer.reconstruct.registration.shared_bend import SharedBend
from wafer_viewer.reconstruct.registration.swap_search import (
    NO_MISFITS,
    Misfits,
    StageDeviations,
    search_misfits,
    search_swapped,
    suspects,
    usual_unexplained,
)

Pairs = NDArray[np.int32]
Um = NDArray[np.float64]
MOST_LOOKS = 3
"""Largest number of times that lost overlaps are looked at again."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldsToPlace:
    """Fields at their stage positions, stitching parameters, and an earlier solution.

    numbers, marks: as in `Poses`; fixed: fields that keep their earlier pose, bool [n], None to solve for all jointly;
    assumed: True if the positions come from an assumed overlap, so that they tell nothing about pixel size and camera;
    calibration: of the pixel size, if there is one.
    """

    outlines: Sequence[Outline]
    numbers: NDArray[np.int32]
    marks: NDArray[np.int64]
    stitching: Stitching
    previous: PreviousSolution
    fixed: NDArray[np.bool_] | None
    assumed: bool = False
    calibration: Calibration | None = None

    @classmethod
    def of(
        cls,
        outlines: Sequence[Outline],
        numbers: Sequence[int],
        marks: NDArray[np.int64],
        stitching: Stitching,
        previous: PreviousSolution | None = None,
        *,
        final: bool = True,
        assumed: bool = False,
        calibration: Calibration | None = None,
    ) -> FieldsToPlace:
        """Return fields to be solved jointly or, if not `final`, new ones to be placed against the fixed others."""
        listed = np.array(numbers, np.int32)
        previous = previous or PreviousSolution.of(None, listed, marks)
        fixed = None if final else previous.unchanged
        return cls(outlines, listed, marks, stitching, previous, fixed, assumed, calibration)

    @property
    def centres_um(self) -> tuple[Um, Um]:
        """Stage coordinates (x_um, y_um) of the field centres, [n] each."""
        x_um = [o.x0_um + (o.shape[1] - 1) / 2 * o.pixel_um for o in self.outlines]
        y_um = [o.y0_um - (o.shape[0] - 1) / 2 * o.pixel_um for o in self.outlines]
        return np.array(x_um), np.array(y_um)

    @property
    def form(self) -> Form | None:
        """Shared terms of the earlier solution; None where they are to be estimated again."""
        poses = self.previous.poses
        return None if self.fixed is None or poses is None or not self.fixed.any() else poses.form


@dataclass(frozen=True, slots=True)
class OverlapObservers:
    """Functions that measure overlaps, either in memory or on workers that open the maps themselves.

    register(pairs): lateral shifts in x and y; refine(pairs, shift_um): the same near known ones; compare(pairs, x_um,
    y_um): height offsets in z, at the centres of all fields; opened(place): the height map of one field, by its index
    in the list.
    """

    register: Callable[[Pairs], Shifts]
    refine: Callable[[Pairs, Um], Shifts]
    compare: Callable[[Pairs, Um, Um], HeightOffsets]
    opened: Callable[[int], HeightMap]


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredOverlaps:
    """Pairs of overlapping fields, int32 [e, 2], their shifts, and a mask of the fields that fit none, bool [n]."""

    pairs: Pairs
    shifts: Shifts
    left_out: NDArray[np.bool_]
    misfits: Misfits
    notes: tuple[str, ...] = ()
    period_odds_nats: Um = dataclasses.field(default_factory=lambda: np.zeros(0))

    @property
    def usable_pairs(self) -> Pairs:
        """Pairs of fields that both stay in the mosaic."""
        return self.pairs[~self.left_out[self.pairs].any(axis=1)]


def settle_overlaps(fields: FieldsToPlace, observers: OverlapObservers) -> RegisteredOverlaps:
    """Register all overlaps, except those of unchanged fields; choose, solve and look again until they are settled.

    Of the offsets at which a repeating pattern fits, the one that agrees with all other overlaps is measured. Overlaps
    that were lost are measured where the solved positions expect them. Fields that fit no neighbour are excluded.
    """
    pairs = neighbours(fields.outlines)
    registered = fields.previous.shifts(pairs, observers.register)
    bend = SharedBend.of(registered, fields.outlines)
    refine = observers.refine
    observers = dataclasses.replace(observers, refine=lambda some, at_um: bend.judged(refine(some, at_um)))
    settled = _choose_and_measure(fields, bend.judged(registered), observers)
    misfits = _find_misfits(fields, settled, observers)
    if misfits.fields and settled.shifts.repeats.any():
        settled = _choose_and_measure(fields, _rejected(settled.shifts, misfits.fields), observers)
    left_out = settled.misplaced(len(fields.outlines))
    left_out[list(misfits.fields)] = True
    shifts = _rejected(settled.shifts, misfits.fields)
    notes = SharedBend.of(shifts, fields.outlines).notes(shifts, fields.calibration is not None) + settled.notes
    return RegisteredOverlaps(pairs, shifts, left_out, misfits, notes, settled.period_odds_nats)


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    """Shifts after the choice among the offsets of patterns, notes on it, and the log odds of the periods.

    deviations: of the fields from the stage; None without a pattern, or with one for which the stage is too coarse.
    """

    shifts: Shifts
    notes: tuple[str, ...]
    period_odds_nats: Um
    deviations: StageDeviations | None

    def misplaced(self, n_fields: int) -> NDArray[np.bool_]:
        """Return a mask of the fields that contradict their neighbours."""
        return np.isin(np.arange(n_fields), misplaced_fields(n_fields, self.shifts))


def _choose_and_measure(fields: FieldsToPlace, shifts: Shifts, observers: OverlapObservers) -> _Settled:
    """Choose among the offsets of patterns, measure those that were chosen, and look again at lost overlaps."""
    x_um, y_um = fields.centres_um
    pixel_um = fields.outlines[0].pixel_um
    choice = choose_candidates(
        x_um,
        y_um,
        shifts,
        pixel_um,
        stage_error_um=fields.stitching.stage_error_um,
        fixed=fields.fixed,
        start=(fields.previous.earlier("x_um", x_um), fields.previous.earlier("y_um", y_um)),
    )
    if choice is None:
        return _Settled(_look_again_until_settled(fields, shifts, observers), (), np.zeros(0), None)
    again = np.column_stack((shifts.first, shifts.second))[choice.to_measure]
    measured = choice.with_measured(observers.refine(again, choice.expected_um[choice.to_measure]))
    found = _look_again_until_settled(fields, measured, observers)
    return _Settled(found, choice.notes(pixel_um), choice.odds_nats, None if choice.refused else choice.deviations)


def _look_again_until_settled(fields: FieldsToPlace, shifts: Shifts, observers: OverlapObservers) -> Shifts:
    """Solve for the positions and measure lost overlaps where these expect them, until no more is found."""
    x_um, y_um = fields.centres_um
    pixel_um = fields.outlines[0].pixel_um
    for _ in range(MOST_LOOKS):
        if shifts.believed.all() or not shifts.believed.any():
            break
        found = solve_lateral(fields, shifts)
        moved = np.column_stack((found.x_um - x_um, found.y_um - y_um))
        joined = found.group[shifts.first] == found.group[shifts.second]
        u_um = np.where(joined, 0.0, np.sqrt(2) * found.stage_error_um)
        before, n = shifts, int(shifts.believed.sum())
        expected_um = moved[shifts.second] - moved[shifts.first] + _offset_um(fields, shifts)
        shifts = look_again(shifts, expected_um, u_um, pixel_um, observers.refine)
        if int(shifts.believed.sum()) == n:
            return before
    return shifts


def _find_misfits(fields: FieldsToPlace, settled: _Settled, observers: OverlapObservers) -> Misfits:
    """Return the mirrored, turned and swapped fields; none while new fields are placed against fixed ones."""
    if fields.fixed is not None:
        return NO_MISFITS
    misfits, shifts = NO_MISFITS, settled.shifts
    found = suspects(len(fields.outlines), shifts, settled.misplaced(len(fields.outlines)))
    if len(found):
        x_um, y_um = fields.centres_um
        expected = solve_lateral(fields, _rejected(shifts, found))
        moved = np.column_stack((expected.x_um - x_um, expected.y_um - y_um))
        pairs = np.column_stack((shifts.first, shifts.second))
        misfits = search_misfits(found, pairs, moved, usual_unexplained(shifts), observers.opened)
    if settled.deviations is None:
        return misfits
    rest = _rejected(shifts, misfits.fields)
    swapped = search_swapped(settled.deviations, rest, fields.outlines[0].pixel_um, observers.opened)
    return dataclasses.replace(misfits, swapped=(*misfits.swapped, *swapped))


def _rejected(shifts: Shifts, some: Sequence[int] | NDArray[np.int32]) -> Shifts:
    """Return the shifts, those of some fields rejected as unlike where they were accepted, or fit at several places."""
    those = np.isin(shifts.first, some) | np.isin(shifts.second, some)
    unlike = those & (shifts.believed | shifts.repeats)
    return dataclasses.replace(
        shifts,
        doubt=np.where(unlike, np.uint8(RejectionReason.UNLIKE), shifts.doubt),
        candidates=np.where(those[:, None, None], np.float32(np.nan), shifts.candidates),
    )


def _offset_um(fields: FieldsToPlace, shifts: Shifts) -> Um:
    """Return the offset (x, y) of overlaps by the distortion of the lens, [e, 2]."""
    off_px = SharedBend.of(shifts, fields.outlines).offset_px(shifts, fields.calibration is not None)
    return off_px[:, ::-1] * (1, -1) * fields.outlines[0].pixel_um


def solve_lateral(fields: FieldsToPlace, shifts: Shifts) -> Positions:
    """Solve for the lateral positions of the fields and the rotation and scale of the camera."""
    x_um, y_um = fields.centres_um
    return solve_positions(
        x_um,
        y_um,
        with_pooled_drift(shifts),
        fields.outlines[0].pixel_um,
        stage_error_um=fields.stitching.stage_error_um,
        fixed=fields.fixed,
        start=(fields.previous.earlier("x_um", x_um), fields.previous.earlier("y_um", y_um)),
        camera=fields.form and CameraAxes.of(fields.form),
        assumed=fields.assumed,
        calibration=fields.calibration,
        offset_um=_offset_um(fields, shifts),
    )
