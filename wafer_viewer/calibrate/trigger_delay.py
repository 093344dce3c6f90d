"""Delay from the pulse to the exposure, from sweeps of one field upward and downward at several speeds.

A frame taken at the speed v is assigned to the z of its pulse + direction v (delay + exposure / 2). With a delay that
is too small by d, the sharpness over z appears shifted by -v d in upward and by +v d in downward sweeps. Half the
difference of a pair, h = (z_down - z_up) / 2, follows

    h(v) = c + d v

The constant c holds what depends on the direction alone, such as the play of the axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.calibrate.image_geometry import Estimate
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.quantity import coverage_factor

Floats = NDArray[np.float64]
STEPS = 6
"""Gauss-Newton steps of the shift between two curves; three reach a nm."""
MARGIN = 0.15
"""Part of a curve at each end that is not compared, so that the shifted curve covers the rest."""
LEAST_PAIRS = 4
"""Fewest pairs of sweeps for a delay with an uncertainty."""


@dataclass(frozen=True, slots=True, eq=False)
class FocusSweepCurve:
    """Sharpness over z of one sweep: z_um, rising, with the delay in use; sharpness, mean squared gradient."""

    z_um: Floats
    sharpness: Floats


@dataclass(frozen=True, slots=True)
class SweepPair:
    """Half the shift from an upward to a downward sweep in um, at a speed in um/s."""

    speed_um_s: float
    half_shift_um: float


@dataclass(frozen=True, slots=True)
class DelayError:
    """Delay minus the delay in use, in us, and the shift that does not depend on the speed, in um."""

    delay_us: Estimate
    play_um: Estimate


def sharpness(image: Image) -> float:
    """Return the mean squared difference of neighbouring pixels over the squared mean of the image."""
    grey = image.astype(np.float32)
    down, right = np.diff(grey, axis=0), np.diff(grey, axis=1)
    return float((np.mean(down * down) + np.mean(right * right)) / max(float(grey.mean()), 1.0) ** 2)


def curve_shift_um(first: FocusSweepCurve, second: FocusSweepCurve) -> float:
    """Return how much higher in z the second curve lies, by least squares with a free gain and offset.

    Parameters
    ----------
    first, second : FocusSweepCurve
        Curves of the same field over the same range.

    Returns
    -------
    float
        Shift in um.

    Raises
    ------
    RigError
        If the curves have no peak in common.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(first.z_um, first.sharpness)
    low, high = max(first.z_um[0], second.z_um[0]), min(first.z_um[-1], second.z_um[-1])
    room = MARGIN * (high - low)
    inside = (second.z_um > low + room) & (second.z_um < high - room)
    z_um, values = second.z_um[inside], second.sharpness[inside]
    shift_um = 0.0
    for _ in range(STEPS):
        model, slope = spline(z_um - shift_um), -spline(z_um - shift_um, 1)
        design = np.stack([model, np.ones_like(model), slope], axis=1)
        gain, _, step = np.linalg.lstsq(design, values, rcond=None)[0]
        if not (gain > 0 and abs(step / gain) <= room):
            break
        shift_um += float(step / gain)
    else:
        if abs(shift_um) <= room:
            return shift_um
    raise RigError(
        "The sharpness of an upward and a downward sweep cannot be compared: the focus must lie in the middle of the "
        "range, on a place with texture."
    )


def delay_error(pairs: Sequence[SweepPair], u_shift_um: float = 0.0) -> DelayError:
    """Return the error of the delay in use from pairs of sweeps at two speeds or more.

    Parameters
    ----------
    pairs : sequence of SweepPair
        At least four, at two speeds.
    u_shift_um : float
        Standard uncertainty (k = 1) of half a shift that all pairs of one speed share, from the interpolation.

    Returns
    -------
    DelayError
        Error of the delay with its standard uncertainty from the scatter, widened by Student's t.

    Raises
    ------
    RigError
        With fewer pairs, or with one speed.
    """
    speeds = np.array([pair.speed_um_s for pair in pairs])
    if len(pairs) < LEAST_PAIRS or np.ptp(speeds) == 0:
        raise RigError(f"The delay takes {LEAST_PAIRS} pairs of sweeps at two speeds; there are {len(pairs)}.")
    shifts = np.array([pair.half_shift_um for pair in pairs])
    design = np.stack([np.ones_like(speeds), speeds], axis=1)
    solution, *_ = np.linalg.lstsq(design, shifts, rcond=None)
    freedom = len(pairs) - 2
    residual = shifts - design @ solution
    covariance = float(residual @ residual) / freedom * np.linalg.inv(design.T @ design)
    wide = coverage_factor(freedom) / 2
    u = wide * np.sqrt(np.diag(covariance))
    u_delay_us = math.hypot(float(u[1]), u_shift_um / float(np.ptp(speeds))) * 1e6
    play_um = Estimate(float(solution[0]), math.hypot(float(u[0]), u_shift_um))
    return DelayError(Estimate(float(solution[1]) * 1e6, u_delay_us), play_um)
