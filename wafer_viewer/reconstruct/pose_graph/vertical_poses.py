"""How high fields lie and how they lean: all seams at once, with the stage as prior."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, Numbers
from wafer_viewer.reconstruct.pose_graph.amg_solver import rigid
from wafer_viewer.reconstruct.pose_graph.pose_covariance import standard_uncertainties
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags, GraphEdges, PoseGraph
from wafer_viewer.reconstruct.pose_graph.robust_solver import RobustSolution, settle
from wafer_viewer.reconstruct.pose_graph.stage_form import FORM_TERMS, sag_between, uncertainty_of_form

_FLOOR_UM = 0.002
"""Heights of two fields at one spot differ by more than noise."""

_FLOOR_SLOPE = 5e-6
_USUAL_Z_UM, _USUAL_TILT = 1.0, 1e-4
"""Errors of the stage, until seams tell."""

_LEAN = 1e-2
"""Of the camera against the stage, before anything is measured (um per um)."""

_SAG_UM = 1.0
"""That all fields share at their corners, before anything is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class VerticalPoses:
    """Heights of fields, [n]: too high by z_um + tilt_x dx + tilt_y dy + form.sag_um(dx, dy) from their centre.

    u_z_um: standard uncertainty of z_um against the stage; seams: with weights and what is left in them; z_error_um,
    tilt_error: standard deviations of the stage's errors, field by field.
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
    """The most probable offset and tilt of every field [n], from the seams and the stage's word.

    A surface z = G(x, y) of second degree that is added to the errors of all fields leaves no trace in the seams: each
    field takes G's height and slope as its own offset and tilt, and G's curvature, which all fields have alike, as
    their common sag. So these six terms (height, two tilts, bow, twist, saddle) are held to the stage: offsets and
    tilts are taken as independent from field to field, and the correction is the one that has no component along the
    six, weighted by the stage's errors. Nothing of the true form of a sample goes into a correction, whatever its size,
    since all fields measure it alike. The sag and the lean that fields share are unknowns beside the others, so that
    a bowl in every field or a camera that leans does not look like a bend or a tilt of the whole; what is left to the
    stage is its error of the six terms, `Form.u_um`.

    z_error_um, tilt_error: standard deviations of the stage's errors, each field its own; ``auto`` finds them.
    field_size_um: (width, height). fixed: bool [n], fields that stay at `start` (z, tilt_x, tilt_y). form: as found
    before; its sag is kept.
    """
    fixed = np.zeros(len(x_um), np.bool_) if fixed is None else fixed
    network = _network(x_um, y_um, seams, field_size_um, fixed, form, (z_error_um, tilt_error))
    values = np.zeros((len(x_um), 3))
    if start is not None:
        values[fixed] = np.column_stack(start)[fixed]
    network, at = settle(network, values)
    sag_um = form.field_form_um if form is not None else (float(at.shared[2]), float(at.shared[3]), float(at.shared[4]))
    z_um, tilt_x, tilt_y = at.values.T
    z_sigma, tilt_sigma = float(network.prior_sigma[0]), float(network.prior_sigma[1])
    return VerticalPoses(
        z_um=z_um,
        tilt_x=tilt_x,
        tilt_y=tilt_y,
        u_z_um=standard_uncertainties(network, at, (0,))[:, 0],
        seams=_judged(seams, network, at),
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
    """Planes of differences between fields that are rigid plates; they share a lean, and a sag unless it is known."""
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
    """What seams tell, [e, 3, 3], once the least error of any comparison is added to their covariances."""
    floor = np.diag(np.array([_FLOOR_UM, _FLOOR_SLOPE, _FLOOR_SLOPE]) ** 2)
    told = np.isfinite(seams.z_um) & np.isfinite(seams.mid_x_um) & np.isfinite(seams.mid_y_um)
    information = np.where(told[:, None, None], seams.information, 0.0)
    floored = np.linalg.solve(np.eye(3) + information @ floor, information)
    return (floored + np.swapaxes(floored, 1, 2)) / 2


def _judged(seams: HeightOffsets, network: PoseGraph, at: RobustSolution) -> HeightOffsets:
    """The seams with their weights, and the step that is left in the middle of each."""
    step_um = np.where(at.weight > 0, network.misfit(at.values, at.shared)[:, 0], np.nan)
    rms_um = np.hypot(seams.rms_um, step_um)
    return dataclasses.replace(seams, weight=at.weight.astype(np.float32), step_um=step_um, rms_um=rms_um)
