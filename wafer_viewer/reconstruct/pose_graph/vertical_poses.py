"""Vertical pose estimation, height and tilt of all fields: all seams at once, with the form of the stage."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, Numbers
from wafer_viewer.reconstruct.pose_graph.amg_solver import rigid
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags, GraphEdges, PoseGraph
from wafer_viewer.reconstruct.pose_graph.robust_solver import RobustSolution, solve_robust, standard_uncertainties

FORM_TERMS = ("height", "tilt along x", "tilt along y", "bow", "twist", "saddle")

_UNKNOWN_UM = 1e4
"""Uncertainties above this are reported as infinite: a single row does not determine its cross tilt."""

_RIDGE = 1e-12
"""Relative ridge on the diagonal; collinear terms would otherwise be separated by rounding errors."""

Arms = tuple[Numbers, Numbers]


def sag_between(first: Arms, second: Arms, field_size_um: tuple[float, float]) -> Numbers:
    """Return the plane (height, slopes) [e, 3, 3] at seam midpoints for each term of a shared sag.

    first, second: from the centres of the two fields to the midpoint. The difference of two equal parabolas side by
    side is exactly a plane.
    """
    half_x, half_y = field_size_um[0] / 2, field_size_um[1] / 2
    (ax, ay), (bx, by) = first, second
    zero = np.zeros_like(ax)
    xx = np.column_stack((bx**2 - ax**2, 2 * (bx - ax), zero)) / half_x**2
    xy = np.column_stack((bx * by - ax * ay, by - ay, bx - ax)) / (half_x * half_y)
    yy = np.column_stack((by**2 - ay**2, zero, 2 * (by - ay))) / half_y**2
    return np.stack((xx, xy, yy), axis=-1)


def uncertainty_of_form(
    x_um: Numbers, y_um: Numbers, z_error_um: float, tilt_error: float, lean: float
) -> tuple[float, ...]:
    """Return expanded uncertainties (k = 2) of `FORM_TERMS` at the rim of fields at (x_um, y_um), by the stage alone.

    z_error_um, tilt_error: independent errors of each field; lean: standard deviation of the tilt that all fields
    share.
    """
    if len(x_um) < 2:
        return (2 * z_error_um, *[float("inf")] * 5)
    x, y = x_um - x_um.mean(), y_um - y_um.mean()
    rim_um = float(np.hypot(x, y).max())
    x, y, one, zero = x / rim_um, y / rim_um, np.ones_like(x_um), np.zeros_like(x_um)
    height = np.column_stack((one, x, y, x**2 + y**2, 2 * x * y, x**2 - y**2, zero, zero))
    along_x = np.column_stack((zero, one, zero, 2 * x, 2 * y, 2 * x, -one, zero)) / rim_um
    along_y = np.column_stack((zero, zero, one, 2 * y, 2 * x, -2 * y, zero, -one)) / rim_um
    information = height.T @ height / z_error_um**2 + (along_x.T @ along_x + along_y.T @ along_y) / tilt_error**2
    before = np.array([10 * _UNKNOWN_UM] * 6 + [lean * rim_um] * 2)
    information += np.diag(before**-2.0)
    scale = 1 / np.sqrt(np.diag(information))
    covariance = scale[:, None] * np.linalg.inv(information * scale[:, None] * scale + _RIDGE * np.eye(8)) * scale
    u_um = 2 * np.sqrt(np.diag(covariance)[:6])
    return tuple(float(u) if u < _UNKNOWN_UM else float("inf") for u in u_um)


_FLOOR_UM = 0.002
"""Minimum uncertainty of a height offset: heights of two fields at one spot differ by more than noise."""

_FLOOR_SLOPE = 5e-6
"""Minimum uncertainty of a tilt between two fields (um per um)."""
_USUAL_Z_UM, _USUAL_TILT = 1.0, 1e-4
"""Initial guesses of the stage errors."""

_LEAN = 1e-2
"""Prior standard deviation of the camera tilt against the stage (um per um)."""

_SAG_UM = 1.0
"""Prior standard deviation of the sag that all fields share, at their corners."""


@dataclass(frozen=True, slots=True, eq=False)
class VerticalPoses:
    """Height errors of fields, [n]: z_um + tilt_x dx + tilt_y dy + form.sag_um(dx, dy) from their centre.

    Positive means too high. u_z_um: standard uncertainty of z_um against the stage; seams: with weights and residual
    steps; z_error_um, tilt_error: standard deviations of the stage's errors, field by field.
    """

    z_um: Numbers
    tilt_x: Numbers
    tilt_y: Numbers
    u_z_um: Numbers
    seams: HeightOffsets
    form: Form
    z_error_um: float
    tilt_error: float
    notes: tuple[str, ...] = ()


def solve_heights(
    x_um: Numbers,
    y_um: Numbers,
    seams: HeightOffsets,
    *,
    z_error_um: float | Literal["auto"],
    tilt_error: float | Literal["auto"],
    field_size_um: tuple[float, float],
    fixed: Flags | None = None,
    start: tuple[Numbers, Numbers, Numbers] | None = None,
    form: Form | None = None,
) -> VerticalPoses:
    """Estimate the most probable offset and tilt of every field [n] from the seams and the stage prior.

    A surface z = G(x, y) of second degree that is added to the errors of all fields leaves no trace in the seams: each
    field takes G's height and slope as its own offset and tilt, and G's curvature, which is equal in all fields, as
    their common sag. These six terms (height, two tilts, bow, twist, saddle) are therefore tied to the stage: offsets
    and tilts are treated as independent from field to field, and the correction is the one without a component along
    the six, weighted by the stage's errors. The true form of a sample never enters a correction, whatever its size,
    since all fields measure it alike. The shared sag and camera tilt are separate unknowns, so that a bowl in every
    field or a tilted camera is not mistaken for a bend or a tilt of the entire surface. The remaining stage error of
    the six terms is `Form.u_um`.

    z_error_um, tilt_error: standard deviations of the stage's errors, independent for each field; ``auto`` estimates
    them. field_size_um: (width, height). fixed: bool [n], fields that stay at `start` (z, tilt_x, tilt_y). form: of an
    earlier solution; its sag is retained.
    """
    fixed = np.zeros(len(x_um), np.bool_) if fixed is None else fixed
    network = _network(x_um, y_um, seams, field_size_um, fixed, form, (z_error_um, tilt_error))
    values = np.zeros((len(x_um), 3))
    if start is not None:
        values[fixed] = np.column_stack(start)[fixed]
    network, solution = solve_robust(network, values)
    sag_um = (
        form.field_form_um
        if form is not None
        else (float(solution.shared[2]), float(solution.shared[3]), float(solution.shared[4]))
    )
    z_um, tilt_x, tilt_y = solution.values.T
    z_sigma, tilt_sigma = float(network.prior_sigma[0]), float(network.prior_sigma[1])
    return VerticalPoses(
        z_um=z_um,
        tilt_x=tilt_x,
        tilt_y=tilt_y,
        u_z_um=standard_uncertainties(network, solution, (0,))[:, 0],
        seams=_judged(seams, network, solution),
        form=dataclasses.replace(
            form or Form(),
            names=FORM_TERMS,
            u_um=uncertainty_of_form(x_um, y_um, z_sigma, tilt_sigma, _LEAN),
            field_form_um=sag_um,
            field_size_um=field_size_um,
        ),
        z_error_um=z_sigma,
        tilt_error=tilt_sigma,
    )


def _network(
    x_um: Numbers,
    y_um: Numbers,
    seams: HeightOffsets,
    field_size_um: tuple[float, float],
    fixed: Flags,
    form: Form | None,
    errors: tuple[float | Literal["auto"], float | Literal["auto"]],
) -> PoseGraph:
    """Build the graph of seam planes between rigid fields with a shared tilt, and a shared sag unless known."""
    mid_x_um, mid_y_um = np.nan_to_num(seams.mid_x_um), np.nan_to_num(seams.mid_y_um)
    arms = [(mid_x_um - x_um[k], mid_y_um - y_um[k]) for k in (seams.first, seams.second)]
    sag = sag_between(arms[0], arms[1], field_size_um)
    measured = np.nan_to_num(np.column_stack((seams.z_um, seams.slope_x, seams.slope_y)))
    shared = np.concatenate((np.zeros((len(sag), 3, 2)), sag), axis=2)
    if form is not None:
        measured = measured - sag @ np.array(form.field_form_um)
        shared = shared[:, :, :2]
    lean = np.zeros((len(x_um), 3, shared.shape[2]))
    lean[:, 1, 0] = lean[:, 2, 1] = 1.0
    z_um, tilt = (u if e == "auto" else e for e, u in zip(errors, (_USUAL_Z_UM, _USUAL_TILT), strict=True))
    return PoseGraph(
        x_um=x_um,
        y_um=y_um,
        first=seams.first,
        second=seams.second,
        at_first=rigid(*arms[0], 3),
        at_second=rigid(*arms[1], 3),
        at_shared=shared,
        measured=measured,
        information=_floored(seams),
        prior_sigma=np.array([z_um, tilt, tilt]),
        prior_guess=np.array([z_um, tilt, tilt]),
        prior_shared=lean,
        shared_sigma=np.array([_LEAN, _LEAN, _SAG_UM, _SAG_UM, _SAG_UM])[: shared.shape[2]],
        ties=GraphEdges.of(seams.first, seams.second, ~fixed),
        auto=tuple(group for group, e in zip(((0,), (1, 2)), errors, strict=True) if e == "auto"),
    )


def _floored(seams: HeightOffsets) -> Numbers:
    """Return the information [e, 3, 3] of seams, with the minimum error added to their covariances."""
    floor = np.diag(np.array([_FLOOR_UM, _FLOOR_SLOPE, _FLOOR_SLOPE]) ** 2)
    finite = np.isfinite(seams.z_um) & np.isfinite(seams.mid_x_um) & np.isfinite(seams.mid_y_um)
    information = np.where(finite[:, None, None], seams.information, 0.0)
    floored = np.linalg.solve(np.eye(3) + information @ floor, information)
    return (floored + np.swapaxes(floored, 1, 2)) / 2


def _judged(seams: HeightOffsets, network: PoseGraph, solution: RobustSolution) -> HeightOffsets:
    """Return the seams with their weights, and the residual step in the middle of each."""
    step_um = np.where(solution.weight > 0, network.misfit(solution.values, solution.shared)[:, 0], np.nan)
    rms_um = np.hypot(seams.rms_um, step_um)
    return dataclasses.replace(seams, weight=solution.weight.astype(np.float32), step_um=step_um, rms_um=rms_um)
