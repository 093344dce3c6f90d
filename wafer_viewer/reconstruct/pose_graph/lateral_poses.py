"""Lateral pose estimation: all overlaps at once, with the stage as prior, and the camera's rotation and scale.

The camera may be rotated by its mounting, and scaled by a wrong pixel size. A camera rotated by 1 mrad shifts every
neighbour by 1.2 px to the side, always in the same direction; stage positions trusted field by field would then
contradict all overlaps at once. Rotation and scale are therefore unknowns that all fields share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import (
    Form,
    HeightOffsets,
    Numbers,
    Poses,
    RejectionReason,
    Shifts,
    joined,
    selected,
)
from wafer_viewer.numerics.block_gradients import LOOSE_PX
from wafer_viewer.reconstruct.pose_graph.bridge_arbitration import arbitrate_bridges, groups
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags, GraphEdges, PoseGraph, between_neighbours
from wafer_viewer.reconstruct.pose_graph.robust_solver import (
    REJECTED,
    RobustSolution,
    shared_uncertainties,
    solve_robust,
    standard_uncertainties,
)
from wafer_viewer.reconstruct.registration.pair_registration import with_own_drift

# ---------------------------------------------------------------------------------------------------------- incremental


Pairs = NDArray[np.int32]
T = TypeVar("T", Shifts, HeightOffsets)
A = TypeVar("A", np.float64, np.bool_)
STILL_PX = 0.1
"""Lateral move, in pixels, below which a field is not redrawn."""
STILL_UM = 0.01
"""Height change, at the most affected corner of a field, below which it is not redrawn.

It is below the repeatability of any height.
"""
POSE = ("x_um", "y_um", "z_um", "tilt_x", "tilt_y")


@dataclass(frozen=True, slots=True, eq=False)
class PreviousSolution:
    """Earlier solution mapped to the current list of fields, all [n_fields].

    row: index of each field in the earlier list, -1 where it is new or its surface was recomputed; poses: the earlier
    ones.
    """

    row: NDArray[np.intp]
    poses: Poses | None

    @classmethod
    def of(cls, poses: Poses | None, numbers: NDArray[np.int32], marks: NDArray[np.int64]) -> PreviousSolution:
        """Map earlier poses to fields with the given surface marks."""
        if poses is None or poses.numbers.size == 0:
            return cls(np.full(len(numbers), -1), poses)
        order = np.argsort(poses.numbers)
        position = np.minimum(np.searchsorted(poses.numbers, numbers, sorter=order), len(order) - 1)
        row = order[position]
        same = (poses.numbers[row] == numbers) & (poses.marks[row] == marks)
        return cls(np.where(same, row, -1), poses)

    @property
    def unchanged(self) -> NDArray[np.bool_]:
        """Mask of the unchanged fields."""
        return self.row >= 0

    def earlier(self, name: str, without: NDArray[A]) -> NDArray[A]:
        """Return a quantity of the earlier poses, `without` where a field has none."""
        if self.poses is None or not self.unchanged.any():
            return without
        return np.where(self.unchanged, getattr(self.poses, name)[self.row], without)

    def stale(self, moved: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the rows of the earlier list to hide: fields that moved, changed or were removed."""
        n_before = 0 if self.poses is None else self.poses.numbers.size
        return np.setdiff1d(np.arange(n_before), self.row[self.unchanged & ~moved])

    def shifts(self, pairs: Pairs, observe: Callable[[Pairs], Shifts]) -> Shifts:
        """Return the lateral shifts of overlaps; only changed overlaps are measured again."""
        return self._and(pairs, observe, None if self.poses is None else _as_measured(self.poses.shifts))

    def seams(self, pairs: Pairs, observe: Callable[[Pairs], HeightOffsets]) -> HeightOffsets:
        """Return the height offsets of overlaps, reusing those between unchanged fields."""
        return self._and(pairs, observe, None if self.poses is None else _unsolved(self.poses.seams))

    def _and(self, pairs: Pairs, observe: Callable[[Pairs], T], earlier: T | None) -> T:
        if earlier is None or earlier.first.size == 0:
            return observe(pairs)
        n, first, second = len(self.row), self._now(earlier.first), self._now(earlier.second)
        wanted, known_pairs = _keys(pairs[:, 0], pairs[:, 1], n), _keys(first, second, n)
        of_use = (first >= 0) & (second >= 0) & np.isin(known_pairs, wanted)
        reused = replace(selected(earlier, of_use), first=first[of_use], second=second[of_use])
        new = ~np.isin(wanted, known_pairs[of_use])
        return joined([reused, observe(pairs[new])]) if new.any() else reused

    def _now(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Convert earlier indices to current ones, -1 for fields that were removed or recomputed."""
        n_before = 0 if self.poses is None else self.poses.numbers.size
        place = np.full(n_before, -1, np.int32)
        place[self.row[self.unchanged]] = np.flatnonzero(self.unchanged)
        return place[rows]


def _keys(first: NDArray[np.int32], second: NDArray[np.int32], n: int) -> NDArray[np.int64]:
    """Return a unique number for each pair of n fields."""
    return first.astype(np.int64) * n + second


def _as_measured(shifts: Shifts) -> Shifts:
    """Restore shifts as measured: the overlaps that they disagree with, or share the drift with, may have changed."""
    doubt = np.where(shifts.doubt == RejectionReason.DISAGREES, np.uint8(RejectionReason.NONE), shifts.doubt)
    return with_own_drift(replace(shifts, doubt=doubt.astype(np.uint8)))


def _unsolved(seams: HeightOffsets) -> HeightOffsets:
    """Restore the offsets of `height_seams.compare`, without the residual step of a solution."""
    return replace(seams, rms_um=np.sqrt(np.maximum(seams.rms_um**2 - seams.step_um**2, 0)), step_um=seams.z_um)


def freeze_unmoved_fields(
    poses: Poses, previous: PreviousSolution, pixel_um: float, corner_um: float
) -> tuple[Poses, NDArray[np.bool_]]:
    """Restore the drawn poses of fields that hardly moved, and return which fields are to be redrawn.

    corner_um: from the centre of a field to its corner.
    """
    if previous.poses is None:
        return poses, np.ones(poses.numbers.size, bool)
    before = {name: previous.earlier(name, getattr(poses, name)) for name in POSE}
    change = {name: getattr(poses, name) - before[name] for name in POSE}
    away_px = np.hypot(change["x_um"], change["y_um"]) / pixel_um
    higher_um = np.abs(change["z_um"]) + corner_um * np.hypot(change["tilt_x"], change["tilt_y"])
    turned_up = poses.left_out != previous.earlier("left_out", poses.left_out)
    moved = ~previous.unchanged | (away_px > STILL_PX) | (higher_um > STILL_UM) | turned_up
    frozen = {name: np.where(moved, getattr(poses, name), before[name]) for name in POSE}
    return replace(poses, **frozen), moved


# -------------------------------------------------------------------------------------------------------- lateral poses


SIGMA = 0.05
"""Prior standard deviation of rotation (rad) and scale (fraction); uncertain values are not applied."""

LEAST_OVERLAPS = 4
"""With fewer overlaps, a single wrong one looks like a wrong pixel size."""

_SIGNIFICANT = 4.0
"""Smallest rotation or scale that is noted, in standard uncertainties."""
_WORTH_PX = 0.1
"""Smallest shift of a neighbour by rotation or scale that is noted, in pixels."""
_WRONG_SCALE = 0.03
"""Largest error of a given pixel size (fraction); a larger one cannot be right."""


@dataclass(frozen=True, slots=True)
class CameraAxes:
    """Camera against stage: rotated anticlockwise by `turn` (rad), pixels too large by `scale` (fraction).

    u_turn, u_scale: standard uncertainties; (middle_x_um, middle_y_um): the point where its axes and those of the stage
    agree.
    """

    turn: float = 0.0
    u_turn: float = float("inf")
    scale: float = 0.0
    u_scale: float = float("inf")
    middle_x_um: float = 0.0
    middle_y_um: float = 0.0

    @classmethod
    def of(cls, form: Form) -> CameraAxes:
        """Return the camera axes stored in a form."""
        return cls(form.camera_turn, form.u_camera_turn, form.camera_scale, form.u_camera_scale, *form.middle_um)

    def in_form(self, form: Form) -> Form:
        """Return a copy of a form with these camera axes."""
        return dataclasses.replace(
            form,
            camera_turn=self.turn,
            u_camera_turn=self.u_turn,
            camera_scale=self.scale,
            u_camera_scale=self.u_scale,
            middle_um=(self.middle_x_um, self.middle_y_um),
        )

    def from_stage(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Transform stage coordinates to camera axes."""
        x, y = self.arms(stage_x_um, stage_y_um)
        return stage_x_um + self.scale * x + self.turn * y, stage_y_um + self.scale * y - self.turn * x

    def arms(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Return the vectors from the middle to stage positions."""
        return stage_x_um - self.middle_x_um, stage_y_um - self.middle_y_um

    def notes(self, field_um: float, pixel_um: float) -> tuple[str, ...]:
        """Return operator notes on rotation and scale, if they are significant and shift neighbours noticeably.

        field_um: distance between neighbours. Raises ComputeError when the pixel size cannot be right.
        """
        notes: list[str] = []
        if self._matters(self.turn, self.u_turn, field_um, pixel_um):
            turned = f"{abs(self.turn) * 1e3:.2f} mrad {'anticlockwise' if self.turn > 0 else 'clockwise'}"
            notes.append(f"The camera is turned by {turned} against the stage: calibrate its angle.")
        if self._matters(self.scale, self.u_scale, field_um, pixel_um):
            found_um = pixel_um / (1 + self.scale)
            observed = f"The overlaps say a pixel is {found_um:.5g} um, not {pixel_um:.5g} um"
            if abs(self.scale) > _WRONG_SCALE:
                raise ComputeError(f"{observed}: give the pixel size of this objective and camera.")
            notes.append(f"{observed}: calibrate the pixel size.")
        return tuple(notes)

    def _matters(self, value: float, u: float, field_um: float, pixel_um: float) -> bool:
        return abs(value) > _SIGNIFICANT * u and abs(value) * field_um > _WORTH_PX * pixel_um


def shared_by_all(x_um: Numbers, y_um: Numbers) -> Numbers:
    """Return the displacement [n, 2, 2] per unit scale and per rad of rotation, at (x_um, y_um) from the middle."""
    return np.stack((np.column_stack((x_um, y_um)), np.column_stack((y_um, -x_um))), axis=-1)


_FLOOR_PX = 0.02
"""Minimum registration uncertainty: two images of the same spot differ by more than noise."""

_USUAL_ERROR_PX = 6.0
"""Initial guess of the stage error."""


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """Field centres in the camera's axes, [n], with uncertainties and diagnostics.

    u_x_um, u_y_um: standard uncertainties against the stage's coordinates (errors of neighbours are correlated: the
    distance between them is known much better); group: fields joined by accepted overlaps have one number; shifts: with
    weights, residuals and rejections; stage_error_um: standard deviation of the stage along an axis.
    """

    x_um: Numbers
    y_um: Numbers
    u_x_um: Numbers
    u_y_um: Numbers
    group: NDArray[np.int32]
    shifts: Shifts
    stage_error_um: float
    camera: CameraAxes
    notes: tuple[str, ...] = ()


def solve_positions(
    stage_x_um: Numbers,
    stage_y_um: Numbers,
    shifts: Shifts,
    pixel_um: float,
    *,
    stage_error_um: float | Literal["auto"] = "auto",
    fixed: Flags | None = None,
    start: tuple[Numbers, Numbers] | None = None,
    camera: CameraAxes | None = None,
    assumed: bool = False,
) -> Positions:
    """Estimate the most probable positions of fields [n] from stage positions and overlap shifts.

    Images are placed on a lattice along the camera axes, so positions are given in these. Where the camera is rotated
    against the stage, or the pixel size is wrong, the surface is rotated and scaled about the middle of the fields, and
    only there do its coordinates equal those of the stage; `Positions.camera` gives the transformation. Rotation and
    scale are applied, and noted, only where they are significant and noticeable.

    stage_error_um: standard deviation along an axis; ``auto`` estimates it. fixed: bool [n], fields that stay at their
    position in `start` (x, y). camera: from an earlier solution, not estimated again. assumed: the stage positions were
    made up, so that rotation and scale are those of the assumption: applied, never noted. Raises ComputeError when the
    overlaps contradict the pixel size.
    """
    fixed = np.zeros(len(stage_x_um), np.bool_) if fixed is None else fixed
    task = _Task(stage_x_um, stage_y_um, shifts, pixel_um, stage_error_um, fixed, start)
    if camera is not None:
        return task.positions(*task.settled(camera), camera, camera)
    unturned = task.unturned()
    network, solution = task.settled(unturned, (SIGMA, SIGMA))
    found = _found(unturned, solution)
    is_known = np.sum(solution.weight >= REJECTED) >= LEAST_OVERLAPS
    notes = found.notes(task.neighbours_um, pixel_um) if is_known and not assumed else ()
    if not notes and not (is_known and assumed):
        solution = solution.without_solver
        network, solution = task.settled(unturned, like=solution)
        found = dataclasses.replace(found, turn=0.0, scale=0.0)
    return dataclasses.replace(task.positions(network, solution, unturned, found), notes=notes)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """Arguments of `solve_positions`, and the steps of its solution."""

    stage_x_um: Numbers
    stage_y_um: Numbers
    shifts: Shifts
    pixel_um: float
    stage_error_um: float | Literal["auto"]
    fixed: Flags
    start: tuple[Numbers, Numbers] | None

    def unturned(self) -> CameraAxes:
        """Return a camera aligned with the stage, about the middle of the fixed fields, or else of all fields."""
        those = self.fixed if np.any(self.fixed) else np.ones_like(self.fixed)
        middle = (float(np.mean(a[those])) if len(a) else 0.0 for a in (self.stage_x_um, self.stage_y_um))
        return CameraAxes(0.0, np.inf, 0.0, np.inf, *middle)

    @property
    def usable(self) -> Flags:
        """Mask of overlaps with finite uncertainty and no rejection reason of their own."""
        own_doubt = ~np.isin(self.shifts.doubt, (RejectionReason.NONE, RejectionReason.DISAGREES))
        return ~own_doubt & (np.isfinite(self.shifts.u_x_um) | np.isfinite(self.shifts.u_y_um))

    @property
    def neighbours_um(self) -> float:
        """Median distance between overlapping fields."""
        i, j = self.shifts.first[self.usable], self.shifts.second[self.usable]
        distance_um = np.hypot(self.stage_x_um[j] - self.stage_x_um[i], self.stage_y_um[j] - self.stage_y_um[i])
        return float(np.median(distance_um)) if len(distance_um) else 0.0

    def settled(
        self, camera: CameraAxes, shared_sigma: tuple[float, ...] = (), like: RobustSolution | None = None
    ) -> tuple[PoseGraph, RobustSolution]:
        """Solve for displacements from the stage positions in camera axes."""
        x_um, y_um = camera.from_stage(self.stage_x_um, self.stage_y_um)
        values = np.zeros((len(x_um), 2))
        if self.start is not None:
            begun = np.column_stack((self.start[0] - x_um, self.start[1] - y_um))
            values[self.fixed] = begun[self.fixed]
        return solve_robust(self._network(camera, x_um, y_um, np.array(shared_sigma)), values, _decide, like)

    def _network(self, camera: CameraAxes, x_um: Numbers, y_um: Numbers, shared_sigma: Numbers) -> PoseGraph:
        first, second, m = self.shifts.first, self.shifts.second, len(shared_sigma)
        ones = np.broadcast_to(np.eye(2), (len(first), 2, 2))
        error_um = _USUAL_ERROR_PX * self.pixel_um if self.stage_error_um == "auto" else self.stage_error_um
        return PoseGraph(
            x_um=x_um,
            y_um=y_um,
            first=first,
            second=second,
            at_first=ones,
            at_second=ones,
            at_shared=np.zeros((len(first), 2, m)),
            measured=self._measured(x_um, y_um),
            information=self._information(),
            prior_sigma=np.full(2, error_um),
            prior_shared=shared_by_all(*camera.arms(self.stage_x_um, self.stage_y_um))[:, :, :m],
            shared_sigma=shared_sigma,
            ties=GraphEdges.of(first, second, ~self.fixed),
            prior_guess=np.full(2, error_um),
            auto=((0, 1),) if self.stage_error_um == "auto" else (),
        )

    def _measured(self, x_um: Numbers, y_um: Numbers) -> Numbers:
        """Return the shift [e, 2] of the second against the first, relative to stage positions in camera axes."""
        i, j = self.shifts.first, self.shifts.second
        off_x, off_y = self.stage_x_um - x_um, self.stage_y_um - y_um
        shifts = (self.shifts.x_um + off_x[j] - off_x[i], self.shifts.y_um + off_y[j] - off_y[i])
        return np.nan_to_num(np.column_stack(shifts), posinf=0.0, neginf=0.0)

    def _information(self) -> Numbers:
        """Return the inverse covariances [e, 2, 2] of the overlaps, without directions that nothing determines."""
        u = np.column_stack((self.shifts.u_x_um, self.shifts.u_y_um))
        u = np.where(np.isfinite(u), u, LOOSE_PX * self.pixel_um)
        told = self.usable & np.isfinite(self.shifts.x_um) & np.isfinite(self.shifts.y_um)
        covariance = np.zeros((len(u), 2, 2))
        covariance[told] = u[told][:, :, None] * u[told][:, None, :] * np.eye(2)
        covariance[told, 0, 1] = covariance[told, 1, 0] = self.shifts.covariance_um2[told]
        variance, axes = np.linalg.eigh(covariance)
        loose = variance > (LOOSE_PX / 2 * self.pixel_um) ** 2
        precision = 1 / (variance + (_FLOOR_PX * self.pixel_um) ** 2)
        precision = np.where(told[:, None] & ~loose, precision, 0.0)
        return np.asarray((axes * precision[:, None, :]) @ np.swapaxes(axes, 1, 2), np.float64)

    def positions(self, network: PoseGraph, solution: RobustSolution, axes: CameraAxes, found: CameraAxes) -> Positions:
        """Return positions, uncertainties and groups from the displacements against a known camera."""
        x_um, y_um = (
            a + moved
            for a, moved in zip(axes.from_stage(self.stage_x_um, self.stage_y_um), solution.values.T, strict=True)
        )
        if self.start is not None:
            x_um, y_um = np.where(self.fixed, self.start[0], x_um), np.where(self.fixed, self.start[1], y_um)
        u = standard_uncertainties(network, solution, (0, 1))
        shifts = self._judged(network, solution)
        believed = shifts.weight >= REJECTED
        group = groups(len(x_um), shifts.first[believed], shifts.second[believed])
        place = np.column_stack((x_um, y_um))
        if not np.any(self.fixed):
            stage = np.column_stack((self.stage_x_um, self.stage_y_um))
            pairs = np.column_stack((shifts.first, shifts.second))
            place, u = between_neighbours(stage, place, u, group, pairs, self.pixel_um)
        error_um = float(network.prior_sigma[0])
        return Positions(place[:, 0], place[:, 1], u[:, 0], u[:, 1], group, shifts, error_um, found)

    def _judged(self, network: PoseGraph, solution: RobustSolution) -> Shifts:
        """Return the shifts with their weights, residuals and doubts."""
        residual = np.where(
            np.isfinite(np.column_stack((self.shifts.x_um, self.shifts.y_um))),
            network.misfit(solution.values, solution.shared),
            np.nan,
        )
        verdict = np.where(solution.weight >= REJECTED, RejectionReason.NONE, RejectionReason.DISAGREES)
        return dataclasses.replace(
            self.shifts,
            weight=solution.weight.astype(np.float32),
            doubt=np.where(self.usable, verdict, self.shifts.doubt).astype(np.uint8),
            residual_x_um=residual[:, 0],
            residual_y_um=residual[:, 1],
        )


def _found(unturned: CameraAxes, solution: RobustSolution) -> CameraAxes:
    """Return the camera axes from the shared unknowns."""
    (scale, turn), (u_scale, u_turn) = solution.shared.tolist(), shared_uncertainties(solution).tolist()
    return dataclasses.replace(unturned, turn=turn, u_turn=u_turn, scale=scale, u_scale=u_scale)


def _decide(network: PoseGraph, solution: RobustSolution) -> Numbers:
    """Return the overlap weights forced by the arbitration of clusters."""
    return arbitrate_bridges(network, solution.values, solution.shared, solution.excess, solution.weight >= REJECTED)
