"""Many height maps as one surface: neighbours, registration, poses, seams, and the mosaic that is blended from them."""

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
from wafer_viewer.reconstruct.pose_graph.camera_rotation_scale import CameraAxes
from wafer_viewer.reconstruct.pose_graph.incremental import PreviousSolution
from wafer_viewer.reconstruct.pose_graph.lateral_poses import Positions, solve_positions
from wafer_viewer.reconstruct.pose_graph.vertical_poses import VerticalPoses, solve_heights
from wafer_viewer.reconstruct.registration.height_seams import compare
from wafer_viewer.reconstruct.registration.misplaced_fields import suspects
from wafer_viewer.reconstruct.registration.neighbour_pairs import neighbours
from wafer_viewer.reconstruct.registration.pair_registration import register
from wafer_viewer.reconstruct.registration.stitching_notes import remarks

Pairs = NDArray[np.int32]
Um = NDArray[np.float64]
REGISTER_SHARE = 0.8
"""Of the work in `stitch`, which leaves the blending to whoever asks for a window."""


@dataclass(frozen=True, slots=True)
class OverlapObservers:
    """How overlaps are looked at: in memory, or by workers that open the maps themselves.

    register(pairs): what overlaps say about x and y; compare(pairs, x_um, y_um): about z, at the centres of all fields;
    opened(place): the height map of one field, by its place in the list.
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
    """One surface from height maps: placed by their overlaps or by the stage, as the recipe says.

    fields: where the stage says they are (centres, in the same order); without it the maps' own places count. progress
    is told the finished share (0 ... 1); what it raises ends the work. The mosaic is blended when windows of it are
    asked for; `poses` says where the fields lie in it.
    Raises ComputeError without heights, for pixel sizes that differ or contradict the overlaps, and when fields and
    heights differ in number.
    """
    if not heights:
        raise ComputeError("There is no field to stitch: give at least one height map.")
    placed = heights if fields is None else moved_to(heights, fields)
    numbers = range(1, len(placed) + 1) if fields is None else [f.number for f in fields]
    eyes = _eyes_on(placed, recipe.stitching, progress or (lambda share: None))
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
    """Where fields lie and how they lean, from their overlaps, with the stage as prior.

    numbers, marks: as in `Poses`. known: an earlier solution; overlaps of unchanged fields are not registered again.
    final: solve for all fields; otherwise only those that are new are placed, against the others as they lie.
    Raises ComputeError when the overlaps contradict the pixel size.
    """
    listed = np.array(numbers, np.int32)
    known = known or PreviousSolution.of(None, listed, marks)
    task = _Task(outlines, stitching, known, None if final else known.unchanged)
    if stitching.poses == "stage":
        return task.at_stage(listed, marks)
    pairs = neighbours(outlines)
    shifts = known.shifts(pairs, eyes.register)
    positions = task.positions(shifts)
    left_out = np.isin(np.arange(len(outlines)), suspects(len(outlines), shifts))
    seen = pairs[~left_out[pairs].any(axis=1)]

    def look(pairs: Pairs) -> HeightOffsets:
        return eyes.compare(pairs, positions.x_um, positions.y_um)

    levels = task.levels(positions, look(seen) if final else known.seams(seen, look))
    poses = task.poses(listed, marks, left_out, positions, levels)
    return replaced(poses, notes=poses.notes + remarks(poses, pairs, eyes.opened))


@dataclass(frozen=True, slots=True)
class _Task:
    """Which fields are to be placed, what is known of them, and which of them stay where they are."""

    outlines: Sequence[Outline]
    stitching: Stitching
    known: PreviousSolution
    fixed: NDArray[np.bool_] | None

    def positions(self, shifts: Shifts) -> Positions:
        x_um, y_um = centres(self.outlines)
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
        """What fields share, as found before; found anew where all are solved for."""
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
        stage_x_um, stage_y_um = centres(self.outlines)
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
        """Every field where the stage says, upright; how far that is off nobody asked."""
        (x_um, y_um), zero = centres(self.outlines), np.zeros(len(numbers))
        unknown, alone = np.full(len(numbers), np.nan), np.arange(len(numbers), dtype=np.int32)
        whole = np.zeros(len(numbers), bool)
        place = (x_um, y_um, x_um, y_um, zero, zero, zero, unknown, unknown, unknown)
        return Poses(numbers, marks, *place, alone, whole, no_shifts(), no_seams())


def centres(outlines: Sequence[Outline]) -> tuple[Um, Um]:
    """(x_um, y_um) of the centres of fields, [n], by the stage."""
    x_um = [o.x0_um + (o.shape[1] - 1) / 2 * o.pixel_um for o in outlines]
    y_um = [o.y0_um - (o.shape[0] - 1) / 2 * o.pixel_um for o in outlines]
    return np.array(x_um), np.array(y_um)


def _eyes_on(heights: Sequence[HeightMap], stitching: Stitching, progress: Progress) -> OverlapObservers:
    """Both looks at maps in memory."""
    reach_um = None if stitching.search_um == "auto" else stitching.search_um

    def registered(pairs: Pairs) -> Shifts:
        return register(heights, pairs, reach_um, progress=lambda share: progress(REGISTER_SHARE * share))

    def compared(pairs: Pairs, x_um: Um, y_um: Um) -> HeightOffsets:
        rest = 1 - REGISTER_SHARE
        return compare(heights, pairs, x_um, y_um, progress=lambda share: progress(REGISTER_SHARE + rest * share))

    return OverlapObservers(registered, compared, heights.__getitem__)
