"""Stitching of height maps into one surface: a sequence of stages.

fields -> registered overlaps -> lateral poses -> vertical poses -> poses -> layout -> mosaic

`stitch` runs all stages in memory. The mosaic of a dataset is updated by the same `find_poses`, with overlaps measured
on workers and poses of unchanged fields reused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.progress import Progress, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import (
    Form,
    HeightOffsets,
    Poses,
    RejectionReason,
    Shifts,
    no_seams,
    no_shifts,
)
from wafer_viewer.model.surface.height_map import HeightMap, Outline
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.blending.mosaic_layout import layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, mosaic_provenance, moved_to
from wafer_viewer.reconstruct.pose_graph.candidate_choice import choose_candidates
from wafer_viewer.reconstruct.pose_graph.incremental import PreviousSolution
from wafer_viewer.reconstruct.pose_graph.lateral_poses import CameraAxes, Positions, solve_positions
from wafer_viewer.reconstruct.pose_graph.stage_errors import LEAST_TIED
from wafer_viewer.reconstruct.pose_graph.vertical_poses import VerticalPoses, solve_heights
from wafer_viewer.reconstruct.registration.drift_pool import with_pooled_drift
from wafer_viewer.reconstruct.registration.height_seams import compare
from wafer_viewer.reconstruct.registration.misfit_search import (
    NO_MISFITS,
    Misfits,
    search_misfits,
    suspects,
    usual_unexplained,
)
from wafer_viewer.reconstruct.registration.misplaced_fields import misplaced_fields, stitching_notes
from wafer_viewer.reconstruct.registration.overlap_strips import neighbours
from wafer_viewer.reconstruct.registration.pair_registration import refine, register
from wafer_viewer.reconstruct.registration.second_look import look_again
from wafer_viewer.reconstruct.registration.swap_search import StageDeviations, search_swapped

Pairs = NDArray[np.int32]
Um = NDArray[np.float64]
REGISTER_SHARE = 0.8
"""Registration's share of the work in `stitch`; blending is deferred until a window is requested."""
MOST_LOOKS = 3
"""Largest number of times that lost overlaps are looked at again."""


def stitch(
    heights: Sequence[HeightMap],
    fields: Sequence[Field] | None = None,
    recipe: Recipe = Recipe(),
    progress: Progress | None = None,
) -> StitchedMosaic:
    """Stitch height maps of fields into one surface.

    The fields are placed by their overlaps, with the stage positions as prior, or by the stage, as the recipe requires.

    Parameters
    ----------
    heights : sequence of HeightMap
        Height maps of the fields, all with the same pixel size.
    fields : sequence of Field, optional
        Stage positions of the fields (centres, in um), in the order of `heights`. Default: the positions of the maps.
    recipe : Recipe, optional
        Settings, of which only `Recipe.stitching` is used. Default: ``Recipe()``.
    progress : callable, optional
        Receives the finished fraction, 0 to 1; an exception raised by it ends the work.

    Returns
    -------
    StitchedMosaic
        A mosaic that is blended when a window of it is requested; `StitchedMosaic.poses` holds the positions of the
        fields in it.

    Raises
    ------
    ComputeError
        When there are no heights, fields and heights differ in number, pixel sizes differ or contradict the overlaps,
        all fields are left out because none fits its neighbours, or the poses of very many fields do not converge.

    Notes
    -----
    Overlaps are registered by masked correlation of the images [1]_, and by heights where the images are blank. Bad
    overlaps are rejected by graduated non-convexity [2]_.

    References
    ----------
    .. [1] D. Padfield, Masked object registration in the Fourier domain, IEEE Trans. Image Process. 21 (2012) 2706.
    .. [2] M. J. Black, A. Rangarajan, On the unification of line processes, outlier rejection, and robust statistics
       with applications in early vision, Int. J. Comput. Vis. 19 (1996) 57.
    """
    if not heights:
        raise ComputeError("There is no field to stitch: give at least one height map.")
    placed = heights if fields is None else moved_to(heights, fields)
    numbers = range(1, len(placed) + 1) if fields is None else [f.number for f in fields]
    listed = FieldsToPlace.of(placed, numbers, np.zeros(len(placed), np.int64), recipe.stitching)
    poses = find_poses(listed, _in_memory_observers(placed, recipe.stitching, progress or silent))
    joint = mosaic_provenance([h.provenance for h in placed], recipe)
    return StitchedMosaic(placed, layout(placed, poses), replace(joint, notes=joint.notes + poses.notes))


def find_poses(fields: FieldsToPlace, observers: OverlapObservers) -> Poses:
    """Estimate position, height and tilt of each field from the overlaps, with the stage as prior.

    Raises ComputeError when the overlaps contradict the pixel size.
    """
    if fields.stitching.poses == "stage":
        return stage_poses(fields)
    registered = register_overlaps(fields, observers)
    lateral = solve_lateral(fields, registered)
    vertical = solve_vertical(fields, registered, lateral, observers)
    return combine(fields, registered, lateral, vertical, observers)


# -------------------------------------------------------------------------------------------------------------- fields


@dataclass(frozen=True, slots=True, eq=False)
class FieldsToPlace:
    """Fields at their stage positions, stitching parameters, and an earlier solution.

    numbers, marks: as in `Poses`; fixed: fields that keep their earlier pose, bool [n], None to solve for all jointly.
    """

    outlines: Sequence[Outline]
    numbers: NDArray[np.int32]
    marks: NDArray[np.int64]
    stitching: Stitching
    previous: PreviousSolution
    fixed: NDArray[np.bool_] | None

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
    ) -> FieldsToPlace:
        """Return fields to be solved jointly or, if not `final`, new ones to be placed against the fixed others."""
        listed = np.array(numbers, np.int32)
        previous = previous or PreviousSolution.of(None, listed, marks)
        return cls(outlines, listed, marks, stitching, previous, None if final else previous.unchanged)

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


def _in_memory_observers(heights: Sequence[HeightMap], stitching: Stitching, progress: Progress) -> OverlapObservers:
    """Return observers for maps in memory."""
    reach_um = None if stitching.search_um == "auto" else stitching.search_um

    def registered(pairs: Pairs) -> Shifts:
        return register(heights, pairs, reach_um, progress=lambda share: progress(REGISTER_SHARE * share))

    def refined(pairs: Pairs, shift_um: Um) -> Shifts:
        return refine(heights, pairs, shift_um, progress=lambda _: progress(REGISTER_SHARE))

    def compared(pairs: Pairs, x_um: Um, y_um: Um) -> HeightOffsets:
        rest = 1 - REGISTER_SHARE
        return compare(heights, pairs, x_um, y_um, progress=lambda share: progress(REGISTER_SHARE + rest * share))

    return OverlapObservers(registered, refined, compared, heights.__getitem__)


# ------------------------------------------------------------------------------------------------------------ overlaps


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


def register_overlaps(fields: FieldsToPlace, observers: OverlapObservers) -> RegisteredOverlaps:
    """Register all overlaps, except those of unchanged fields, and exclude the fields that fit no neighbour.

    Of the offsets at which a repeating pattern fits, the one that agrees with all other overlaps is measured.
    """
    pairs, n_fields = neighbours(fields.outlines), len(fields.outlines)
    chosen = _chosen(fields, fields.previous.shifts(pairs, observers.register), observers)
    left_out = np.isin(np.arange(n_fields), misplaced_fields(n_fields, chosen.shifts))
    misfits = _searched_misfits(fields, chosen, left_out, observers)
    if misfits.fields and chosen.shifts.repeats.any():
        chosen = _chosen(fields, _without(chosen.shifts, misfits.fields), observers)
        left_out = np.isin(np.arange(n_fields), misplaced_fields(n_fields, chosen.shifts))
    left_out |= np.isin(np.arange(n_fields), misfits.fields)
    shifts = _without(chosen.shifts, misfits.fields)
    return RegisteredOverlaps(pairs, shifts, left_out, misfits, chosen.notes, chosen.period_odds_nats)


@dataclass(frozen=True, slots=True, eq=False)
class _Chosen:
    """Shifts after the choice among the offsets of patterns, notes on it, and the log odds of the periods.

    deviations: of the fields from the stage; None without a pattern, or with one for which the stage is too coarse.
    """

    shifts: Shifts
    notes: tuple[str, ...]
    period_odds_nats: Um
    deviations: StageDeviations | None


def _chosen(fields: FieldsToPlace, shifts: Shifts, observers: OverlapObservers) -> _Chosen:
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
        return _Chosen(_looked_at_again(fields, shifts, observers), (), np.zeros(0), None)
    again = np.column_stack((shifts.first, shifts.second))[choice.to_measure]
    measured = choice.with_measured(observers.refine(again, choice.expected_um[choice.to_measure]))
    found = _looked_at_again(fields, measured, observers)
    return _Chosen(found, choice.notes(pixel_um), choice.odds_nats, None if choice.refused else choice.deviations)


def _looked_at_again(fields: FieldsToPlace, shifts: Shifts, observers: OverlapObservers) -> Shifts:
    """Return the shifts after lost overlaps were measured where the poses expect them, until none more is found."""
    x_um, y_um = fields.centres_um
    pixel_um = fields.outlines[0].pixel_um
    for _ in range(MOST_LOOKS):
        if shifts.believed.all() or not shifts.believed.any():
            break
        found = _solved_positions(fields, shifts)
        moved = np.column_stack((found.x_um - x_um, found.y_um - y_um))
        joined = found.group[shifts.first] == found.group[shifts.second]
        u_um = np.where(joined, 0.0, np.sqrt(2) * found.stage_error_um)
        before, n = shifts, int(shifts.believed.sum())
        shifts = look_again(shifts, moved[shifts.second] - moved[shifts.first], u_um, pixel_um, observers.refine)
        if int(shifts.believed.sum()) == n:
            return before
    return shifts


def _searched_misfits(
    fields: FieldsToPlace, chosen: _Chosen, left_out: NDArray[np.bool_], observers: OverlapObservers
) -> Misfits:
    """Return the mirrored, turned and swapped fields; none while new fields are placed against fixed ones."""
    if fields.fixed is not None:
        return NO_MISFITS
    misfits, shifts = NO_MISFITS, chosen.shifts
    found = suspects(len(fields.outlines), shifts, left_out)
    if len(found):
        x_um, y_um = fields.centres_um
        expected = _solved_positions(fields, _without(shifts, found))
        moved = np.column_stack((expected.x_um - x_um, expected.y_um - y_um))
        pairs = np.column_stack((shifts.first, shifts.second))
        misfits = search_misfits(found, pairs, moved, usual_unexplained(shifts), observers.opened)
    if chosen.deviations is None:
        return misfits
    rest = _without(shifts, misfits.fields)
    swapped = search_swapped(chosen.deviations, rest, fields.outlines[0].pixel_um, observers.opened)
    return dataclasses.replace(misfits, swapped=(*misfits.swapped, *swapped))


def _without(shifts: Shifts, some: Sequence[int] | NDArray[np.int32]) -> Shifts:
    """Return the shifts, those of some fields rejected as unlike where they were accepted, or fit at several places."""
    those = np.isin(shifts.first, some) | np.isin(shifts.second, some)
    unlike = those & (shifts.believed | shifts.repeats)
    return dataclasses.replace(
        shifts,
        doubt=np.where(unlike, np.uint8(RejectionReason.UNLIKE), shifts.doubt),
        candidates=np.where(those[:, None, None], np.float32(np.nan), shifts.candidates),
    )


# --------------------------------------------------------------------------------------------------------------- poses


def solve_lateral(fields: FieldsToPlace, registered: RegisteredOverlaps) -> Positions:
    """Solve for the lateral positions of the fields and the rotation and scale of the camera."""
    return _solved_positions(fields, registered.shifts)


def _solved_positions(fields: FieldsToPlace, shifts: Shifts) -> Positions:
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
    )


def solve_vertical(
    fields: FieldsToPlace, registered: RegisteredOverlaps, lateral: Positions, observers: OverlapObservers
) -> VerticalPoses:
    """Compare the heights in the overlaps at their lateral positions, and solve for heights, tilts and shared sag."""

    def look(pairs: Pairs) -> HeightOffsets:
        return observers.compare(pairs, lateral.x_um, lateral.y_um)

    pairs, previous = registered.usable_pairs, fields.previous
    first, zero = fields.outlines[0], np.zeros(len(fields.outlines))
    return solve_heights(
        lateral.x_um,
        lateral.y_um,
        look(pairs) if fields.fixed is None else previous.seams(pairs, look),
        z_error_um=fields.stitching.z_error_um,
        tilt_error=fields.stitching.tilt_error,
        field_size_um=(first.shape[1] * first.pixel_um, first.shape[0] * first.pixel_um),
        fixed=fields.fixed,
        start=(previous.earlier("z_um", zero), previous.earlier("tilt_x", zero), previous.earlier("tilt_y", zero)),
        form=fields.form,
    )


def combine(
    fields: FieldsToPlace,
    registered: RegisteredOverlaps,
    lateral: Positions,
    vertical: VerticalPoses,
    observers: OverlapObservers,
) -> Poses:
    """Return lateral and vertical poses together, with notes on what is odd about the fields."""
    stage_x_um, stage_y_um = fields.centres_um
    poses = Poses(
        numbers=fields.numbers,
        marks=fields.marks,
        stage_x_um=stage_x_um,
        stage_y_um=stage_y_um,
        x_um=lateral.x_um,
        y_um=lateral.y_um,
        z_um=vertical.z_um,
        tilt_x=vertical.tilt_x,
        tilt_y=vertical.tilt_y,
        u_x_um=lateral.u_x_um,
        u_y_um=lateral.u_y_um,
        u_z_um=vertical.u_z_um,
        group=lateral.group,
        left_out=registered.left_out,
        shifts=lateral.shifts,
        seams=vertical.seams,
        form=lateral.camera.in_form(vertical.form),
        stage_error_um=lateral.stage_error_um,
        z_error_um=vertical.z_error_um,
        final=fields.fixed is None,
        notes=registered.notes + lateral.notes + vertical.notes,
        period_odds_nats=registered.period_odds_nats,
    )
    notes = stitching_notes(
        poses,
        registered.pairs,
        observers.opened,
        registered.misfits.notes(fields.numbers),
        registered.misfits.fields,
        stage_known=fields.fixed is None and int(np.bincount(lateral.group).max(initial=0)) >= LEAST_TIED,
    )
    return dataclasses.replace(poses, notes=poses.notes + notes)


def stage_poses(fields: FieldsToPlace) -> Poses:
    """Return poses with every field at its stage position, without tilt; the uncertainties are NaN."""
    (x_um, y_um), n_fields = fields.centres_um, len(fields.numbers)
    zero, unknown = np.zeros(n_fields), np.full(n_fields, np.nan)
    return Poses(
        numbers=fields.numbers,
        marks=fields.marks,
        stage_x_um=x_um,
        stage_y_um=y_um,
        x_um=x_um,
        y_um=y_um,
        z_um=zero,
        tilt_x=zero,
        tilt_y=zero,
        u_x_um=unknown,
        u_y_um=unknown,
        u_z_um=unknown,
        group=np.arange(n_fields, dtype=np.int32),
        left_out=np.zeros(n_fields, np.bool_),
        shifts=no_shifts(),
        seams=no_seams(),
    )
