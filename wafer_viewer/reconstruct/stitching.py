"""Stitching of height maps into one surface: a sequence of stages.

fields -> settled overlaps -> lateral poses -> vertical poses -> poses -> layout -> mosaic

`stitch` runs all stages in memory. The mosaic of a dataset is updated by the same `find_poses`, with overlaps measured
on workers and poses of unchanged fields reused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.progress import Progress, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import (
    HeightOffsets,
    Poses,
    Shifts,
    no_seams,
    no_shifts,
)
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.blending.mosaic_layout import layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, mosaic_provenance, moved_to
from wafer_viewer.reconstruct.overlap_settlement import (
    FieldsToPlace,
    OverlapObservers,
    Pairs,
    RegisteredOverlaps,
    Um,
    settle_overlaps,
    solve_lateral,
)
from wafer_viewer.reconstruct.pose_graph.lateral_poses import Positions
from wafer_viewer.reconstruct.pose_graph.pose_graph import LEAST_TIED
from wafer_viewer.reconstruct.pose_graph.vertical_poses import VerticalPoses, solve_heights
from wafer_viewer.reconstruct.registration.height_seams import compare
from wafer_viewer.reconstruct.registration.misplaced_fields import stitching_notes
from wafer_viewer.reconstruct.registration.pair_registration import refine, register

REGISTER_SHARE = 0.8
"""Registration's share of the work in `stitch`; blending is deferred until a window is requested."""


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
    overlaps are rejected by graduated non-convexity [2]_. Positions that an import made up from an assumed overlap tell
    nothing about the pixel size and the angle of the camera: neither is doubted then.

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
    listed = FieldsToPlace.of(
        placed,
        numbers,
        np.zeros(len(placed), np.int64),
        recipe.stitching,
        assumed=all(height.provenance.positions_assumed for height in placed),
        calibration=placed[0].provenance.calibration,
    )
    poses = find_poses(listed, _in_memory_observers(placed, recipe.stitching, progress or silent))
    joint = mosaic_provenance([h.provenance for h in placed], recipe)
    return StitchedMosaic(placed, layout(placed, poses), replace(joint, notes=joint.notes + poses.notes))


def find_poses(fields: FieldsToPlace, observers: OverlapObservers) -> Poses:
    """Estimate position, height and tilt of each field from the overlaps, with the stage as prior.

    Raises ComputeError when the overlaps contradict the pixel size.
    """
    if fields.stitching.poses == "stage":
        return stage_poses(fields)
    registered = settle_overlaps(fields, observers)
    lateral = solve_lateral(fields, registered.shifts)
    vertical = solve_vertical(fields, registered, lateral, observers)
    return combine(fields, registered, lateral, vertical, observers)


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


# --------------------------------------------------------------------------------------------------------------- poses


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
