"""Stitching of height maps: neighbour search, registration, pose estimation, height offsets and blending."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as replaced

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.progress import Progress
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, Poses, Shifts, no_seams, no_shifts
from wafer_viewer.model.surface.height_map import HeightMap, Outline
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.blending.mosaic_layout import layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, mosaic_provenance, moved_to
from wafer_viewer.reconstruct.pose_graph.incremental import PreviousSolution
from wafer_viewer.reconstruct.pose_graph.lateral_poses import CameraAxes, Positions, solve_positions
from wafer_viewer.reconstruct.pose_graph.vertical_poses import VerticalPoses, solve_heights
from wafer_viewer.reconstruct.registration.height_seams import compare
from wafer_viewer.reconstruct.registration.misplaced_fields import misplaced_fields, stitching_notes
from wafer_viewer.reconstruct.registration.overlap_strips import neighbours
from wafer_viewer.reconstruct.registration.pair_registration import register

Pairs = NDArray[np.int32]
Um = NDArray[np.float64]
REGISTER_SHARE = 0.8
"""Registration's share of the work in `stitch`; blending is deferred until a window is requested."""


@dataclass(frozen=True, slots=True)
class OverlapObservers:
    """Functions that measure overlaps, either in memory or on workers that open the maps themselves.

    register(pairs): lateral shifts in x and y; compare(pairs, x_um, y_um): height offsets in z, at the centres of all
    fields; opened(place): the height map of one field, by its index in the list.
    """

    register: Callable[[Pairs], Shifts]
    compare: Callable[[Pairs, Um, Um], HeightOffsets]
    opened: Callable[[int], HeightMap]


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
    eyes = _in_memory_observers(placed, recipe.stitching, progress or (lambda share: None))
    poses = find_poses(placed, numbers, np.zeros(len(placed), np.int64), recipe.stitching, eyes)
    joint = mosaic_provenance([h.provenance for h in placed], recipe)
    return StitchedMosaic(placed, layout(placed, poses), replace(joint, notes=joint.notes + poses.notes))


def find_poses(
    outlines: Sequence[Outline],
    numbers: Sequence[int],
    marks: NDArray[np.int64],
    stitching: Stitching,
    eyes: OverlapObservers,
    known: PreviousSolution | None = None,
    *,
    final: bool = True,
) -> Poses:
    """Estimate position, height and tilt of each field from the overlaps, with the stage as prior.

    numbers, marks: as in `Poses`. known: an earlier solution; overlaps of unchanged fields are not registered again.
    final: solve for all fields; otherwise only new fields are placed and the others stay fixed. Raises ComputeError
    when the overlaps contradict the pixel size.
    """
    listed = np.array(numbers, np.int32)
    known = known or PreviousSolution.of(None, listed, marks)
    task = _Task(outlines, stitching, known, None if final else known.unchanged)
    if stitching.poses == "stage":
        return task.at_stage(listed, marks)
    pairs = neighbours(outlines)
    shifts = known.shifts(pairs, eyes.register)
    positions = task.positions(shifts)
    left_out = np.isin(np.arange(len(outlines)), misplaced_fields(len(outlines), shifts))
    seen = pairs[~left_out[pairs].any(axis=1)]

    def look(pairs: Pairs) -> HeightOffsets:
        return eyes.compare(pairs, positions.x_um, positions.y_um)

    levels = task.levels(positions, look(seen) if final else known.seams(seen, look))
    poses = task.poses(listed, marks, left_out, positions, levels)
    return replaced(poses, notes=poses.notes + stitching_notes(poses, pairs, eyes.opened))


@dataclass(frozen=True, slots=True)
class _Task:
    """A pose estimation problem: outlines, stitching parameters, earlier solution, and mask of fixed fields."""

    outlines: Sequence[Outline]
    stitching: Stitching
    known: PreviousSolution
    fixed: NDArray[np.bool_] | None

    def positions(self, shifts: Shifts) -> Positions:
        x_um, y_um = field_centres(self.outlines)
        return solve_positions(
            x_um,
            y_um,
            shifts,
            self.outlines[0].pixel_um,
            stage_error_um=self.stitching.stage_error_um,
            fixed=self.fixed,
            start=(self.known.earlier("x_um", x_um), self.known.earlier("y_um", y_um)),
            camera=self._form and CameraAxes.of(self._form),
        )

    def levels(self, positions: Positions, seams: HeightOffsets) -> VerticalPoses:
        first, zero, earlier = self.outlines[0], np.zeros(len(self.outlines)), self.known.earlier
        return solve_heights(
            positions.x_um,
            positions.y_um,
            seams,
            z_error_um=self.stitching.z_error_um,
            tilt_error=self.stitching.tilt_error,
            field_size_um=(first.shape[1] * first.pixel_um, first.shape[0] * first.pixel_um),
            fixed=self.fixed,
            start=(earlier("z_um", zero), earlier("tilt_x", zero), earlier("tilt_y", zero)),
            form=self._form,
        )

    @property
    def _form(self) -> Form | None:
        """Shared terms of the earlier solution; None where they are to be estimated again."""
        poses = self.known.poses
        return None if self.fixed is None or poses is None or not self.fixed.any() else poses.form

    def poses(
        self,
        numbers: NDArray[np.int32],
        marks: NDArray[np.int64],
        left_out: NDArray[np.bool_],
        positions: Positions,
        levels: VerticalPoses,
    ) -> Poses:
        stage_x_um, stage_y_um = field_centres(self.outlines)
        return Poses(
            numbers=numbers,
            marks=marks,
            stage_x_um=stage_x_um,
            stage_y_um=stage_y_um,
            x_um=positions.x_um,
            y_um=positions.y_um,
            z_um=levels.z_um,
            tilt_x=levels.tilt_x,
            tilt_y=levels.tilt_y,
            u_x_um=positions.u_x_um,
            u_y_um=positions.u_y_um,
            u_z_um=levels.u_z_um,
            group=positions.group,
            left_out=left_out,
            shifts=positions.shifts,
            seams=levels.seams,
            form=positions.camera.in_form(levels.form),
            stage_error_um=positions.stage_error_um,
            z_error_um=levels.z_error_um,
            final=self.fixed is None,
            notes=positions.notes + levels.notes,
        )

    def at_stage(self, numbers: NDArray[np.int32], marks: NDArray[np.int64]) -> Poses:
        """Return poses with every field at its stage position, without tilt; the uncertainties are NaN."""
        (x_um, y_um), zero = field_centres(self.outlines), np.zeros(len(numbers))
        unknown, alone = np.full(len(numbers), np.nan), np.arange(len(numbers), dtype=np.int32)
        whole = np.zeros(len(numbers), bool)
        place = (x_um, y_um, x_um, y_um, zero, zero, zero, unknown, unknown, unknown)
        return Poses(numbers, marks, *place, alone, whole, no_shifts(), no_seams())


def field_centres(outlines: Sequence[Outline]) -> tuple[Um, Um]:
    """Return the stage coordinates (x_um, y_um) of the field centres, [n] each."""
    x_um = [o.x0_um + (o.shape[1] - 1) / 2 * o.pixel_um for o in outlines]
    y_um = [o.y0_um - (o.shape[0] - 1) / 2 * o.pixel_um for o in outlines]
    return np.array(x_um), np.array(y_um)


def _in_memory_observers(heights: Sequence[HeightMap], stitching: Stitching, progress: Progress) -> OverlapObservers:
    """Return observers for maps in memory."""
    reach_um = None if stitching.search_um == "auto" else stitching.search_um

    def registered(pairs: Pairs) -> Shifts:
        return register(heights, pairs, reach_um, progress=lambda share: progress(REGISTER_SHARE * share))

    def compared(pairs: Pairs, x_um: Um, y_um: Um) -> HeightOffsets:
        rest = 1 - REGISTER_SHARE
        return compare(heights, pairs, x_um, y_um, progress=lambda share: progress(REGISTER_SHARE + rest * share))

    return OverlapObservers(registered, compared, heights.__getitem__)
