"""Least-squares alignment of a wafer on the stage (rotation and shift) from its measured marks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.sample import Alignment, Marks, Notch
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace

MOST_TURN_DEG = 5.0
"""Largest rotation from the notch direction; more indicates a wrong notch or another corner."""


def fit_alignment(marks: Marks, seen_um: Sequence[tuple[float, float]], notch: Notch) -> Alignment:
    """Fit the rotation and shift from stage to wafer coordinates to the marks (least squares; Kabsch 1976).

    seen_um: (x, y) on the stage of each mark, in the order of `marks`. Scale is not fitted: a disagreement between the
    stage's scale and the marks is part of the residual. Raises PlanError if a mark is missing, all are in one place, or
    the wafer is rotated by more than 5 degrees from the direction of its notch.
    """
    if len(seen_um) != len(marks.places):
        raise PlanError(f"{len(seen_um)} of {len(marks.places)} corners are marked: mark the others too.")
    stage = np.array(seen_um, float)
    wafer = np.array([(m.x_um, m.y_um) for m in marks.places], float)
    turned = Alignment(rotation_rad=_rotation(stage, wafer, notch))
    shift = np.mean(wafer - _through(turned, stage), axis=0)
    fit = replace(turned, shift_x_um=float(shift[0]), shift_y_um=float(shift[1]), n_marks=len(stage))
    return replace(fit, residual_um=float(np.hypot(*(_through(fit, stage) - wafer).T).max()))


def _rotation(stage: NDArray[np.float64], wafer: NDArray[np.float64], notch: Notch) -> float:
    """Return the rotation from the measured marks to those of the wafer, each about their centroid."""
    (u, v), (p, q) = (stage - stage.mean(axis=0)).T, (wafer - wafer.mean(axis=0)).T
    if not (np.hypot(u, v).max() > 0 and np.hypot(p, q).max() > 0):
        raise PlanError("All corners are marked in one place: mark corners of dies that lie far apart.")
    found = math.atan2(float(np.sum(u * q - v * p)), float(np.sum(u * p + v * q)))
    off_deg = math.degrees(math.remainder(found - Alignment.by_notch(notch).rotation_rad, math.tau))
    if abs(off_deg) > MOST_TURN_DEG:
        raise PlanError(
            f"The corners say that the wafer is turned by {off_deg:.1f} degrees from where its notch points "
            f"('{notch}'), and {MOST_TURN_DEG:g} are allowed: mark the corners named, or put the wafer in straight."
        )
    return found


def _through(alignment: Alignment, stage: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([alignment.to_wafer(x, y) for x, y in stage])
