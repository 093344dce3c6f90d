"""Lateral pose estimation: all overlaps at once, with the stage as prior, and the camera's rotation and scale.

The camera may be rotated by its mounting, and scaled by a wrong pixel size. A camera rotated by 1 mrad shifts every
neighbour by 1.2 px to the side, always in the same direction; stage positions trusted field by field would then
contradict all overlaps at once. Rotation and scale are therefore unknowns that all fields share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import Calibration
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
from wafer_viewer.reconstruct.pose_graph.pose_graph import (
    BACKLASH_PX,
    Flags,
    GraphEdges,
    PoseGraph,
    between_neighbours,
    parity,
)
from wafer_viewer.reconstruct.pose_graph.robust_solver import (
    REJECTED,
    RobustSolution,
    shared_covariance,
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
"""Prior standard deviation of a rotation (rad) and a scale (fraction); uncertain values are not applied."""

LEAST_OVERLAPS = 4
"""With fewer overlaps, a single wrong one looks like a wrong pixel size."""
LEAST_FOR_AXES = 12
"""With fewer overlaps, one looks like axes of the stage that are not alike."""

_SIGNIFICANT = 4.0
"""Smallest rotation or scale that is noted, in standard uncertainties."""
_WORTH_PX = 0.1
"""Smallest shift of a neighbour by rotation or scale that is noted, in pixels."""
_WRONG_SCALE = 0.03
"""Largest error of a given pixel size (fraction); a larger one cannot be right."""
_AXES = ("scale", "turn", "stretch", "skew")
"""Components of the axes, in the order of the shared unknowns."""
_ALL = len(_AXES) + 2
"""Number of shared unknowns from which the axes are estimated: with the backlash of rows and of columns, which few rows
show as a skew. The poses are then solved without it, since nothing tells which direction of a scan is right."""


class Reach(NamedTuple):
    """Median distance of neighbours, and largest distance of a field from the middle, in pixels."""

    neighbour_px: float
    rim_px: float


@dataclass(frozen=True, slots=True)
class CameraAxes:
    """Camera against stage: rotated anticlockwise by `turn` (rad), pixels too large by `scale` (fraction).

    stretch, skew: of the stage's axes, distances along x too short and along y too long by `stretch` (fraction), each
    axis turned towards the other by `skew` (rad). u_turn, u_scale, u_stretch, u_skew: standard uncertainties;
    (middle_x_um, middle_y_um): the point where its axes and those of the stage agree.
    """

    turn: float = 0.0
    u_turn: float = float("inf")
    scale: float = 0.0
    u_scale: float = float("inf")
    middle_x_um: float = 0.0
    middle_y_um: float = 0.0
    stretch: float = 0.0
    u_stretch: float = float("inf")
    skew: float = 0.0
    u_skew: float = float("inf")

    @classmethod
    def of(cls, form: Form) -> CameraAxes:
        """Return the camera axes stored in a form."""
        known = {name: getattr(form, f"camera_{name}") for name in _AXES}
        known |= {f"u_{name}": getattr(form, f"u_camera_{name}") for name in _AXES}
        return cls(middle_x_um=form.middle_um[0], middle_y_um=form.middle_um[1], **known)

    def in_form(self, form: Form) -> Form:
        """Return a copy of a form with these camera axes."""
        known = {f"camera_{name}": getattr(self, name) for name in _AXES}
        known |= {f"u_camera_{name}": getattr(self, f"u_{name}") for name in _AXES}
        return dataclasses.replace(form, middle_um=(self.middle_x_um, self.middle_y_um), **known)

    def from_stage(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Transform stage coordinates to camera axes."""
        x, y = self.arms(stage_x_um, stage_y_um)
        right = (self.scale + self.stretch) * x + (self.turn + self.skew) * y
        up = (self.scale - self.stretch) * y - (self.turn - self.skew) * x
        return stage_x_um + right, stage_y_um + up

    def arms(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Return the vectors from the middle to stage positions."""
        return stage_x_um - self.middle_x_um, stage_y_um - self.middle_y_um

    def with_known(self, values: Numbers, covariance: Numbers) -> CameraAxes:
        """Return the axes with the first [m] of `_AXES` and their uncertainties."""
        u = np.sqrt(np.diag(covariance)).tolist()
        names = _AXES[: len(values)]
        known = dict(zip(names, values.tolist(), strict=True)) | {f"u_{n}": v for n, v in zip(names, u, strict=True)}
        return dataclasses.replace(self, **known)

    @property
    def is_square(self) -> bool:
        """True if the axes of the stage have one scale and are at right angles."""
        return self.stretch == 0 and self.skew == 0

    def significant(self, reach: Reach) -> set[str]:
        """Return the names of the components that are significant and noticeable.

        Scale and turn are where they shift neighbours, stretch and skew where they shift the outermost fields.
        """
        values = {name: (abs(getattr(self, name)), getattr(self, f"u_{name}")) for name in _AXES}
        arms_px = (reach.neighbour_px, reach.neighbour_px, reach.rim_px, reach.rim_px)
        shown = zip(values.items(), arms_px, strict=True)
        return {name for (name, (value, u)), px in shown if value > _SIGNIFICANT * u and value * px > _WORTH_PX}

    def notes(self, reach: Reach, pixel_um: float, calibration: Calibration | None = None) -> tuple[str, ...]:
        """Return operator notes on the significant components.

        Raises ComputeError when the pixel size cannot be right.
        """
        notes: list[str] = []
        significant = self.significant(reach)
        doubted = self._doubted(calibration) if calibration and significant & {"scale", "stretch"} else ""
        if "turn" in significant:
            turned = f"{abs(self.turn) * 1e3:.2f} mrad {'anticlockwise' if self.turn > 0 else 'clockwise'}"
            notes.append(f"The camera is turned by {turned} against the stage: calibrate its angle.")
        if not self.is_square and significant & {"scale", "stretch"}:
            notes.append(f"{self._scales}{doubted or ': calibrate the stage and the pixel size.'}")
        if "skew" in significant:
            angle = f"{2e3 * abs(self.skew):.2f} mrad off square (U = {4e3 * self.u_skew:.1g} mrad, k = 2)"
            notes.append(f"The overlaps say the axes of the stage are {angle}: calibrate the stage.")
        if "scale" in significant:
            found_um = pixel_um / (1 + self.scale)
            observed = f"The overlaps say a pixel is {found_um:.5g} um, not {pixel_um:.5g} um"
            if abs(self.scale) > _WRONG_SCALE:
                raise ComputeError(f"{observed}: give the pixel size of this objective and camera.")
            if self.is_square:
                notes.append(f"{observed}{doubted or ': calibrate the pixel size.'}")
        return tuple(notes)

    def _doubted(self, calibration: Calibration) -> str:
        """Return the end of a sentence on a scale that contradicts a calibration; nothing where it does not."""
        u = calibration.u_pixel_um / calibration.pixel_um
        if abs(self.scale) + abs(self.stretch) <= _SIGNIFICANT * u:
            return ""
        return (
            f", but the calibration of {calibration.made} gives the pixel size within {2 * u:.2g} (k = 2, relative): "
            "check the stage and the lens, or calibrate again."
        )

    @property
    def _scales(self) -> str:
        """Beginning of a sentence on the scale of each axis of the stage."""
        scales = {"x": self.scale + self.stretch, "y": self.scale - self.stretch}
        x, y = (f"{abs(s):.3%} {'further apart' if s > 0 else 'closer'} along {axis}" for axis, s in scales.items())
        u = 2 * float(np.hypot(self.u_scale, self.u_stretch))
        return f"The overlaps say fields lie {x} and {y} than by the stage (U = {u:.3%}, k = 2)"


def shared_by_all(x_um: Numbers, y_um: Numbers) -> Numbers:
    """Return the displacement [n, 2, 6] per unit of `_AXES` and of each backlash, at (x_um, y_um) from the middle."""
    none = np.zeros_like(x_um)
    effects = [(x_um, y_um), (y_um, -x_um), (x_um, -y_um), (y_um, x_um), (parity(y_um), none), (none, parity(x_um))]
    return np.stack([np.column_stack(effect) for effect in effects], axis=-1)


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
    calibration: Calibration | None = None,
    offset_um: Numbers | None = None,
) -> Positions:
    """Estimate the most probable positions of fields [n] from stage positions and overlap shifts.

    Images are placed on a lattice along the camera axes, so positions are given in these. Where the camera is rotated
    against the stage, or the pixel size is wrong, the surface is rotated and scaled about the middle of the fields, and
    only there do its coordinates equal those of the stage; `Positions.camera` gives the transformation. Rotation and
    scale are applied, and noted, only where they are significant and noticeable, and so are another scale of each axis
    of the stage and an angle between them that is not right.

    stage_error_um: standard deviation along an axis; ``auto`` estimates it. fixed: bool [n], fields that stay at their
    position in `start` (x, y). camera: from an earlier solution, not estimated again. assumed: the stage positions were
    made up, so that rotation and scale are those of the assumption: applied, never noted. calibration: of the pixel
    size, to which a note refers. offset_um: part of the shifts that is no displacement of the fields, [e, 2]. Raises
    ComputeError when the overlaps contradict the pixel size.
    """
    fixed = np.zeros(len(stage_x_um), np.bool_) if fixed is None else fixed
    offset_um = np.zeros((len(shifts.first), 2)) if offset_um is None else offset_um
    task = _Task(stage_x_um, stage_y_um, shifts, offset_um, pixel_um, stage_error_um, fixed, start)
    if camera is not None:
        return task.positions(*task.settled(camera), camera, camera)
    unturned = task.unturned()
    _, every = task.settled(unturned, _ALL)
    reach = task.reach(unturned)
    found, m = _estimated_axes(unturned, every, reach, assumed)
    notes = () if assumed else found.notes(reach, pixel_um, calibration)
    network, solution = task.settled(unturned, m, like=every.without_solver)
    return dataclasses.replace(task.positions(network, solution, unturned, found), notes=notes)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """Arguments of `solve_positions`, and the steps of its solution."""

    stage_x_um: Numbers
    stage_y_um: Numbers
    shifts: Shifts
    offset_um: Numbers
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

    def reach(self, camera: CameraAxes) -> Reach:
        """Return the distance between overlapping fields, 0 without any, and that of the outermost field."""
        i, j = self.shifts.first[self.usable], self.shifts.second[self.usable]
        distance_um = np.hypot(self.stage_x_um[j] - self.stage_x_um[i], self.stage_y_um[j] - self.stage_y_um[i])
        rim_um = np.hypot(*camera.arms(self.stage_x_um, self.stage_y_um)).max(initial=0.0)
        neighbour_um = float(np.median(distance_um)) if len(distance_um) else 0.0
        return Reach(neighbour_um / self.pixel_um, float(rim_um) / self.pixel_um)

    def settled(
        self, camera: CameraAxes, m: int = 0, like: RobustSolution | None = None
    ) -> tuple[PoseGraph, RobustSolution]:
        """Solve for displacements from the stage positions in camera axes, and for the first m shared unknowns."""
        x_um, y_um = camera.from_stage(self.stage_x_um, self.stage_y_um)
        values = np.zeros((len(x_um), 2))
        if self.start is not None:
            begun = np.column_stack((self.start[0] - x_um, self.start[1] - y_um))
            values[self.fixed] = begun[self.fixed]
        return solve_robust(self._network(camera, x_um, y_um, m), values, _decide, like)

    def _network(self, camera: CameraAxes, x_um: Numbers, y_um: Numbers, m: int) -> PoseGraph:
        first, second = self.shifts.first, self.shifts.second
        sigma = np.array((*[SIGMA] * len(_AXES), *[BACKLASH_PX * self.pixel_um] * 2))
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
            shared_sigma=sigma[:m],
            ties=GraphEdges.of(first, second, ~self.fixed),
            prior_guess=np.full(2, error_um),
            auto=((0, 1),) if self.stage_error_um == "auto" else (),
        )

    def _measured(self, x_um: Numbers, y_um: Numbers) -> Numbers:
        """Return the shift [e, 2] of the second against the first, relative to stage positions in camera axes."""
        i, j = self.shifts.first, self.shifts.second
        off_x, off_y = self.stage_x_um - x_um, self.stage_y_um - y_um
        shifts = (self.shifts.x_um + off_x[j] - off_x[i], self.shifts.y_um + off_y[j] - off_y[i])
        return np.nan_to_num(np.column_stack(shifts) - self.offset_um, posinf=0.0, neginf=0.0)

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


def _estimated_axes(
    unturned: CameraAxes, solution: RobustSolution, reach: Reach, assumed: bool
) -> tuple[CameraAxes, int]:
    """Return the significant components of the axes, from a solution for all, and how many of `_AXES` are to be solved.

    Without significant ones of the stage's axes, scale and turn are those for none of these. assumed: all count.
    """
    values, covariance = shared_covariance(solution, len(_AXES))
    every = unturned.with_known(values, covariance)
    n_overlaps = int(np.sum(solution.weight >= REJECTED))
    is_told = n_overlaps >= LEAST_FOR_AXES and every.significant(reach) & {"stretch", "skew"}
    if is_told or (assumed and n_overlaps >= LEAST_OVERLAPS):
        return every, len(_AXES)
    square = dataclasses.replace(every, stretch=0.0, skew=0.0)
    given = covariance[:2, 2:] @ np.linalg.inv(covariance[2:, 2:])
    square = square.with_known(values[:2] - given @ values[2:], covariance[:2, :2] - given @ covariance[2:, :2])
    if n_overlaps >= LEAST_OVERLAPS and square.significant(reach) & {"scale", "turn"}:
        return square, 2
    return dataclasses.replace(square, scale=0.0, turn=0.0), 0


def _decide(network: PoseGraph, solution: RobustSolution) -> Numbers:
    """Return the overlap weights forced by the arbitration of clusters."""
    return arbitrate_bridges(network, solution.values, solution.shared, solution.excess, solution.weight >= REJECTED)
