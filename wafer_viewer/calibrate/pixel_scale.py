"""Pixel size and rotation of the camera from overlapping frames along lines of known stage moves.

Positions are complex numbers, x + i y of the stage in um and right + i up on the camera in pixels. Along a line the
displacements between neighbouring frames add up to positions on the camera, p, in a frame of reference that is longer
than a field. The regression of the stage's positions s on them, s = m p + constant, has the slope

    m = e exp(i a),    e pixel size in um, a rotation of the camera against the axis of the stage

for lines along x and along y alike. A line averages the errors of the stage's scales over its length; lines far apart
have independent errors, so their scatter is the uncertainty. It includes the registration. The scale of the stage
itself is common to all lines: its uncertainty comes from its certificate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import RigError
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, student

Complexes = NDArray[np.complex128]
OUTLIER_SIGMAS = 6.0
"""Distance of a step from the median of all steps above which its registration is rejected."""
LEAST_SIGMA = 1e-4
"""Smallest standard deviation of a step relative to its length: a step of 300 um to 0.03 um."""
LEAST_LINES = 2
"""Fewest lines along an axis."""
LEAST_STEPS = 3
"""Fewest neighbouring steps that make a piece of a line."""


@dataclass(frozen=True, slots=True, eq=False)
class StageLine:
    """Line of overlapping frames.

    moved_um: moves of the stage between neighbours, complex [n]; displaced_px: displacements of the frames on the
    sample, complex [n], NaN where the registration failed.
    """

    moved_um: Complexes
    displaced_px: Complexes


@dataclass(frozen=True, slots=True)
class Estimate:
    """Value with its standard uncertainty (k = 1)."""

    value: float
    u: float


@dataclass(frozen=True, slots=True)
class PixelScale:
    """Pixel size in um, as a mean and along each axis; rotation of the camera and angle between the axes in rad.

    rotation_rad: anticlockwise from the x axis of the stage to the rows of the camera. shear_rad: rotation by the lines
    along y minus that by the lines along x, from axes that are not square to each other. stage_error_um: root mean
    square distance of the stage from the lines. n_rejected: steps without a usable registration.
    """

    pixel_um: Estimate
    pixel_x_um: Estimate
    pixel_y_um: Estimate
    rotation_rad: Estimate
    shear_rad: Estimate
    stage_error_um: float
    n_steps: int
    n_rejected: int


def pixel_scale(
    along_x: Sequence[StageLine], along_y: Sequence[StageLine], u_stage_fraction: float = 0.0
) -> PixelScale:
    """Return pixel size and rotation of the camera from lines along both axes.

    Parameters
    ----------
    along_x, along_y : sequence of StageLine
        At least two lines each.
    u_stage_fraction : float
        Relative standard uncertainty (k = 1) of the scales of the stage, from their certificate.

    Returns
    -------
    PixelScale
        Estimates with standard uncertainties.

    Raises
    ------
    RigError
        With fewer than two usable lines along an axis.

    Notes
    -----
    The uncertainty of a mean over lines is s / sqrt(n), s pooled over both axes and widened by Student's t, so that
    k = 2 covers 95 %. That of the mean pixel size contains half the difference of both axes as a uniform distribution.

    References
    ----------
    .. [1] JCGM 100:2008, Evaluation of measurement data - Guide to the expression of uncertainty in measurement.
    """
    usable = _usable_steps([*along_x, *along_y])
    fits = [
        [fit for line, good in zip(lines, kept, strict=True) if (fit := _fit(line, good)) is not None]
        for lines, kept in ((along_x, usable[: len(along_x)]), (along_y, usable[len(along_x) :]))
    ]
    for axis, of_axis in zip("xy", fits, strict=True):
        if len(of_axis) < LEAST_LINES:
            raise RigError(
                f"{len(of_axis)} of the lines along {axis} can be followed in the frames and {LEAST_LINES} are needed: "
                "choose a place with texture everywhere, and check the focus."
            )
    sizes = [np.array([abs(fit.slope) for fit in of_axis]) for of_axis in fits]
    angles = [np.array([np.angle(fit.slope) for fit in of_axis]) for of_axis in fits]
    pixel, rotation = _mean_of_axes(sizes), _mean_of_axes(angles)
    residuals = np.concatenate([fit.residual_um for of_axis in fits for fit in of_axis])
    n_steps = sum(len(good) for good in usable)
    return PixelScale(
        pixel_um=_with_scale(pixel.mean, u_stage_fraction),
        pixel_x_um=_with_scale(pixel.of_x, u_stage_fraction),
        pixel_y_um=_with_scale(pixel.of_y, u_stage_fraction),
        rotation_rad=rotation.mean,
        shear_rad=Estimate(rotation.of_y.value - rotation.of_x.value, math.hypot(rotation.of_x.u, rotation.of_y.u)),
        stage_error_um=float(np.sqrt(np.mean(np.abs(residuals) ** 2) / 2)),
        n_steps=n_steps,
        n_rejected=n_steps - sum(int(good.sum()) for good in usable),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _LineFit:
    slope: complex
    residual_um: Complexes


@dataclass(frozen=True, slots=True)
class _AxisMeans:
    of_x: Estimate
    of_y: Estimate
    mean: Estimate


def _usable_steps(lines: Sequence[StageLine]) -> list[NDArray[np.bool_]]:
    """Return which steps of each line agree with the median of all steps."""
    ratios = [_ratios(line) for line in lines]
    every = np.concatenate(ratios)
    known = every[np.isfinite(every)]
    if not len(known):
        return [np.zeros(len(line), np.bool_) for line in ratios]
    middle = complex(np.median(known.real), np.median(known.imag))
    sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(known - middle))), LEAST_SIGMA * abs(middle))
    return [np.isfinite(line) & (np.abs(line - middle) <= OUTLIER_SIGMAS * sigma) for line in ratios]


def _ratios(line: StageLine) -> Complexes:
    """Return the move over the displacement of every step, NaN where the registration failed."""
    known = np.isfinite(line.displaced_px)
    return np.where(known, line.moved_um / np.where(known, line.displaced_px, 1.0), np.nan)


def _fit(line: StageLine, good: NDArray[np.bool_]) -> _LineFit | None:
    """Return the regression over the unbroken pieces of a line, each with its own constant; None without a piece."""
    pieces = [piece for piece in np.split(np.arange(len(good)), np.flatnonzero(~good)) if len(piece)]
    steps = [piece[good[piece]] for piece in pieces]
    stage, camera = (
        [_centred(np.cumsum(np.concatenate([[0], of_step[piece]]))) for piece in steps if len(piece) >= LEAST_STEPS]
        for of_step in (line.moved_um, line.displaced_px)
    )
    if not stage:
        return None
    s, p = np.concatenate(stage), np.concatenate(camera)
    slope = complex(np.vdot(p, s) / np.vdot(p, p))
    return _LineFit(slope, s - slope * p)


def _centred(positions: Complexes) -> Complexes:
    return positions - positions.mean()


def _mean_of_axes(values: list[NDArray[np.float64]]) -> _AxisMeans:
    freedom = sum(len(v) - 1 for v in values)
    s = math.sqrt(sum(float(((v - v.mean()) ** 2).sum()) for v in values) / freedom)
    wide = s * student(freedom) / 2
    x, y = (Estimate(float(v.mean()), wide / math.sqrt(len(v))) for v in values)
    between = abs(x.value - y.value) / 2 / math.sqrt(3)
    return _AxisMeans(x, y, Estimate((x.value + y.value) / 2, math.hypot(math.hypot(x.u, y.u) / 2, between)))


def _with_scale(estimate: Estimate, u_fraction: float) -> Estimate:
    return Estimate(estimate.value, math.hypot(estimate.u, u_fraction * estimate.value))
