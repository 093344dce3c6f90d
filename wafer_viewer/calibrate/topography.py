"""Metrological characteristics of measured heights: noise, flatness, linearity, z scale, response to an edge.

The characteristics are those of ISO 25178-600 and the procedures follow ISO 25178-700: noise from the differences of
repeated measurements of one place, flatness deviation from the mean over several places of a flat, and amplification
and linearity from steps of certified height.

The line of the edge is fitted to the borders between upper and lower heights, and each level is a plane. A profile is
the heights of a piece of the edge over their distance from the line. Its width is the distance between the last place
where most heights are within a tenth of the step of the lower level and the first place where most are within a tenth
of the upper one. Pixels without a height are within neither: a gap of rejected heights is part of the width.

This width describes how near to a steep edge heights are measured. It is not the topographic spatial resolution of
ISO 25178-600, which the response to a certified star-shaped groove gives.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.calibrate.image_geometry import Estimate
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeCheck, ScaleCorrection
from wafer_viewer.model.quantity import coverage_factor
from wafer_viewer.model.spec import replace
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, u_of_mean

# -------------------------------------------------------------------------------------------------------- edge response


Floats = NDArray[np.float64]
TOLERANCE = 0.1
"""Fraction of the step within which a height belongs to a level."""
PIECES = 12
"""Pieces of the edge, each with a profile of its own."""
LEAST_PIECES = 4
"""Fewest pieces with both levels."""
LEAST_STEP_SIGMAS = 15.0
"""Smallest step over the scatter of the heights of a level: a tenth of it is then 1.5 standard deviations."""
GUARD = 0.1
"""Distance from the edge, as a fraction of the side, beyond which heights count for the planes of the levels."""
LEAST_PIXELS = 10
"""Fewest pixels of each level in a row that shows the edge."""
OUTLIER_SIGMAS = 4.0
"""Distance from the line or plane above which a border or a height is left out of the fit."""
FIT_ROUNDS = 4
"""Rounds of a fit without outliers; two are enough for a straight edge."""


@dataclass(frozen=True, slots=True)
class EdgeResponse:
    """Width of the response and height of the step in um, and the angle of the edge to the columns of the image."""

    width_um: Estimate
    step_um: float
    angle_deg: float
    n_pieces: int


def edge_response(z_um: Heights, pixel_um: float) -> EdgeResponse:
    """Return the width of the response to a straight step across a height map.

    Parameters
    ----------
    z_um : float32 [row, col]
        Heights in um, NaN where not measured, with one straight edge between two levels.
    pixel_um : float
        Pixel size in um.

    Returns
    -------
    EdgeResponse
        Width with its standard uncertainty (k = 1) from the scatter of the pieces and the size of a pixel.

    Raises
    ------
    MeasureError
        Where no straight step between two levels crosses the map.
    """
    upper, lower = _classes(z_um)
    side = upper.astype(np.int8) - lower.astype(np.int8)
    across, along = (abs(float(half[0].mean()) - float(half[1].mean())) for half in _halves(side))
    turned = along > across
    if turned:
        side, z_um = side.T, z_um.T
    first, last = _halves(side)[0]
    rising = 1 if last.mean() > first.mean() else -1
    offset, slope = _line(side * rising)
    row, col = np.indices(side.shape)
    distance_px: Floats = rising * np.asarray(col - offset - slope * row, np.float64) / math.hypot(1.0, slope)
    part, step_um = _relative_heights(z_um.astype(np.float64), distance_px)
    widths = np.array([_width_px(part[rows], distance_px[rows]) for rows in _pieces(len(side))]) * pixel_um
    widths = widths[np.isfinite(widths)]
    if len(widths) < LEAST_PIECES:
        raise _no_edge("few profiles across the edge reach both levels")
    u_um = math.hypot(float(u_of_mean(widths)), pixel_um / math.sqrt(12))
    angle_deg = math.degrees(math.atan(slope)) + (90.0 if turned else 0.0)
    return EdgeResponse(Estimate(float(widths.mean()), u_um), step_um, angle_deg, len(widths))


def _classes(z_um: Heights) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the upper and the lower heights."""
    known = np.isfinite(z_um)
    if known.mean() < 0.5:
        raise _no_edge("less than half of the field is measured")
    low, high = np.percentile(z_um[known], (5, 95))
    upper, lower = known & (z_um > (low + high) / 2), known & (z_um <= (low + high) / 2)
    scatter = max(_mad(z_um[upper]), _mad(z_um[lower]))
    step = float(np.median(z_um[upper]) - np.median(z_um[lower]))
    if not step > 3 * scatter:
        raise _no_edge("the heights are not of two levels")
    return upper, lower


def _mad(values: NDArray[np.floating]) -> float:
    return MAD_TO_SIGMA * float(np.median(np.abs(values - np.median(values))))


def _halves(side: NDArray[np.int8]) -> tuple[tuple[NDArray[np.int8], NDArray[np.int8]], ...]:
    """Return the left and right halves, and the upper and lower ones."""
    rows, cols = (n // 2 for n in side.shape)
    return (side[:, :cols], side[:, cols:]), (side[:rows], side[rows:])


def _line(side: NDArray[np.int8]) -> tuple[float, float]:
    """Return offset and slope of the line col = offset + slope row between -1 on the left and 1 on the right."""
    rows = np.flatnonzero(((side > 0).sum(axis=1) >= LEAST_PIXELS) & ((side < 0).sum(axis=1) >= LEAST_PIXELS))
    if len(rows) < LEAST_PIXELS:
        raise _no_edge("it does not cross the rows or the columns")
    wrong = np.cumsum(side[rows] > 0, axis=1) - np.cumsum(side[rows] < 0, axis=1)
    wrong = np.concatenate([np.zeros((len(rows), 1), wrong.dtype), wrong], axis=1)
    least = wrong == wrong.min(axis=1, keepdims=True)
    n_cols = wrong.shape[1]
    border = (least.argmax(axis=1) + n_cols - 1 - least[:, ::-1].argmax(axis=1)) / 2 - 0.5
    good = np.ones(len(rows), np.bool_)
    slope = offset = 0.0
    for _ in range(FIT_ROUNDS):
        slope, offset = (float(v) for v in np.polyfit(rows[good], border[good], 1))
        residual = border - offset - slope * rows
        good = np.abs(residual) <= OUTLIER_SIGMAS * max(_mad(residual[good]), 0.5)
    return offset, slope


def _relative_heights(z_um: Floats, distance_px: Floats) -> tuple[Floats, float]:
    """Return the heights as a part of the step, 0 on the lower and 1 on the upper level, and the step in um."""
    row, col = np.indices(z_um.shape)
    design = np.stack([np.ones(z_um.size), row.ravel(), col.ravel()], axis=1)
    guard_px = GUARD * min(z_um.shape)
    planes, scatters = [], []
    for far in (distance_px < -guard_px, distance_px > guard_px):
        used = (far & np.isfinite(z_um)).ravel()
        if used.sum() < LEAST_PIXELS**2:
            raise _no_edge("one of the levels is hardly measured")
        fit = np.zeros(3)
        for _ in range(FIT_ROUNDS):
            fit, *_ = np.linalg.lstsq(design[used], z_um.ravel()[used], rcond=None)
            residual = z_um.ravel() - design @ fit
            used &= np.abs(residual) <= OUTLIER_SIGMAS * max(_mad(residual[used]), 1e-9)
        planes.append((design @ fit).reshape(z_um.shape))
        scatters.append(_mad((z_um - planes[-1]).ravel()[used]))
    low, high = planes
    step_um = float(np.median((high - low)[np.abs(distance_px) < guard_px]))
    if step_um < LEAST_STEP_SIGMAS * max(scatters):
        raise _no_edge(f"its {step_um:.3g} um are less than {LEAST_STEP_SIGMAS:g} times the scatter of the heights")
    return (z_um - low) / (high - low), step_um


def _pieces(n_rows: int) -> list[slice]:
    ends = np.linspace(0, n_rows, PIECES + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def _width_px(part: Floats, distance_px: Floats) -> float:
    """Return the distance between the levels of one profile in pixels, NaN if it does not reach both."""
    cell = np.floor(distance_px).astype(int)
    first = int(cell.min())
    count = np.maximum(np.bincount((cell - first).ravel()), 1)
    share = [
        np.bincount((cell - first).ravel(), (np.abs(part - level) < TOLERANCE).ravel(), len(count)) / count
        for level in (0.0, 1.0)
    ]
    steady = [(s[1:] >= 0.5) & (s[:-1] >= 0.5) for s in share]
    if not (steady[0].any() and steady[1].any()):
        return math.nan
    last_low = int(np.flatnonzero(steady[0])[-1]) + 1
    first_high = int(np.flatnonzero(steady[1])[0])
    return float(max(first_high - last_low - 1, 0))


def _no_edge(why: str) -> MeasureError:
    return MeasureError(
        f"No straight step is found across the field, {why}: centre a steep edge between two smooth levels, and let "
        "the range of z hold both."
    )


# -------------------------------------------------------------------------------------------------------------- z scale


LEAST_CHECK_REPEATS = 3
"""Fewest repeats for a correction of the scale."""


def scale_correction(check: GaugeCheck, in_force: Calibration, today: str) -> ScaleCorrection:
    """Return the calibration with which the mean of a check's repeats equals the certified value.

    in_force: current calibration of the rig, of which only the z scale changes; today: ISO 8601. The uncertainty of the
    scale is that of the comparison. It is due after the check's interval, but not later than the calibration it
    replaces. Raises MeasureError with fewer than three repeats, without an uncertainty, for another optical setup, and
    if the current scale is more certain than the check and consistent with it.
    """
    used = _require_fit(check, in_force)
    reference_um, u_um = check.reference.value_um, (check.deviation.expanded_um or 0.0) / 2
    factor = reference_um / check.height.value_um
    due = datetime.date.fromisoformat(today) + datetime.timedelta(days=check.terms.interval_days)
    corrected = replace(
        in_force,
        z_scale=used.z_scale * factor,
        u_z_scale=u_um / reference_um,
        z_against=check.certificate.serials,
        made=today,
        due=min(due.isoformat(), in_force.due),
    )
    changes_um = reference_um - check.height.value_um
    return ScaleCorrection(
        calibration=corrected, factor=factor, changes_um=changes_um, advice=_advice(check, used, corrected)
    )


def _require_fit(check: GaugeCheck, in_force: Calibration) -> Calibration:
    """Return the calibration used for the repeats; raise MeasureError if the check cannot set the scale."""
    if check.n < LEAST_CHECK_REPEATS:
        raise MeasureError(
            f"The check has {check.n} repeat{'' if check.n == 1 else 's'} and the z scale is set by "
            f"{LEAST_CHECK_REPEATS} at least: scan the blocks again."
        )
    used = check.repeats[0].calibration
    if used is None or check.deviation.expanded_um is None:
        raise MeasureError("The check has no uncertainty: the z scale cannot be set by it.")
    if used.setup != in_force.setup:
        raise MeasureError(
            f"The check is of {used.setup.objective or 'another objective'} and the rig has "
            f"{in_force.setup.objective or 'another'}: check it as it is now."
        )
    return used


def _advice(check: GaugeCheck, before: Calibration, after: Calibration) -> str:
    error_um, expanded_um = check.deviation.value_um, check.deviation.expanded_um or 0.0
    if abs(error_um) > expanded_um:
        return f"The error of {error_um:+.3f} um is more than its U of {expanded_um:.2g} um: the scale is off."
    if after.u_z_scale >= before.u_z_scale:
        raise MeasureError(
            f"The error of {error_um:+.3f} um is within its U of {expanded_um:.2g} um and the z scale is known better "
            "than that: there is nothing to correct."
        )
    return (
        f"The error is within its U of {expanded_um:.2g} um, so the scale may be right as it is; "
        f"set by the blocks, its u would be {after.u_z_scale:.2g} in place of {before.u_z_scale:.2g}."
    )


# ----------------------------------------------------------------------------------------------------------- topography


Heights = NDArray[np.float32]
LEAST_REPEATS = 3
"""Fewest repeats for the noise: two differences."""
LEAST_PLACES = 4
"""Fewest places for the flatness deviation."""
LEAST_MEASURED = 0.5
"""Smallest fraction of a field that must be measured."""
LEAST_SHARE = 0.75
"""Smallest fraction of the places at which a block must be measured to count."""
BLOCKS = 16
"""Blocks along the longer side of a field over which heights are averaged before the flatness deviation: an S-filter
that leaves the form of the field and removes texture and noise."""


@dataclass(frozen=True, slots=True)
class StepPair:
    """Measured and certified height of one step in um, with standard uncertainties (k = 1)."""

    measured_um: Estimate
    certified_um: Estimate


@dataclass(frozen=True, slots=True)
class ScaleResponse:
    """Amplification coefficient of z; deviation from linearity in um, None with steps of a single height."""

    amplification: Estimate
    linearity_um: Estimate | None


def measurement_noise_um(maps: Sequence[Heights]) -> Estimate:
    """Return the measurement noise N_M by the difference method.

    Parameters
    ----------
    maps : sequence of float32 [row, col]
        Heights in um of repeated scans of one place, NaN where not measured; at least three.

    Returns
    -------
    Estimate
        Root mean square noise of a single map in um.

    Raises
    ------
    MeasureError
        With too few maps, or where less than half of the field is measured.

    Notes
    -----
    Each difference of two successive maps is levelled; its root mean square height is sqrt(2) times the noise.

    References
    ----------
    .. [1] ISO 25178-700:2022, Geometrical product specifications (GPS) - Surface texture: Areal - Calibration,
       adjustment and verification of areal topography measuring instruments.
    """
    if len(maps) < LEAST_REPEATS:
        raise MeasureError(f"The noise takes {LEAST_REPEATS} repeats; there are {len(maps)}.")
    variances = np.array([float(np.nanmean(_levelled(b - a) ** 2)) / 2 for a, b in pairwise(maps)])
    value = math.sqrt(float(variances.mean()))
    u_variance = float(u_of_mean(variances))
    return Estimate(value, u_variance / (2 * value) if value > 0 else 0.0)


def flatness_deviation_um(maps: Sequence[Heights]) -> Estimate:
    """Return the flatness deviation z_FLT: the height range of the mean over several places of a flat.

    Parameters
    ----------
    maps : sequence of float32 [row, col]
        Heights in um at different places of a flat, NaN where not measured; at least four.

    Returns
    -------
    Estimate
        Flatness deviation in um; its uncertainty is the scatter of the maps at the highest and the lowest place.

    Raises
    ------
    MeasureError
        With too few maps, or where less than half of the field is measured.

    Notes
    -----
    Each map is averaged over blocks and levelled by a plane, so that the form of the instrument remains and the texture
    of the flat averages out.

    References
    ----------
    .. [1] ISO 25178-700:2022.
    """
    if len(maps) < LEAST_PLACES:
        raise MeasureError(f"The flatness deviation takes {LEAST_PLACES} places; there are {len(maps)}.")
    stack = np.stack([_levelled(_block_means(one)) for one in maps])
    count = np.isfinite(stack).sum(axis=0)
    known = count >= LEAST_SHARE * len(maps)
    if known.mean() < LEAST_MEASURED:
        raise _unmeasured()
    of_block = stack[:, known]
    mean = np.nanmean(of_block, axis=0)
    scatter = np.nanstd(of_block, axis=0, ddof=1) / np.sqrt(count[known])
    high, low = int(mean.argmax()), int(mean.argmin())
    wide = coverage_factor(LEAST_SHARE * len(maps) - 1) / 2
    return Estimate(float(mean[high] - mean[low]), wide * float(math.hypot(scatter[high], scatter[low])))


def scale_response(steps: Sequence[StepPair]) -> ScaleResponse:
    """Return the amplification coefficient and the linearity deviation from certified steps.

    Parameters
    ----------
    steps : sequence of StepPair
        Measured steps; a step of zero is measured as zero.

    Returns
    -------
    ScaleResponse
        Slope of the line through zero, weighted by the uncertainties, and the largest deviation from it.

    Raises
    ------
    MeasureError
        Without a step.

    References
    ----------
    .. [1] ISO 25178-600:2019, Geometrical product specifications (GPS) - Surface texture: Areal - Metrological
       characteristics for areal topography measuring methods.
    """
    if not steps:
        raise MeasureError("Amplification and linearity take signed checks against gauge blocks; there is none.")
    measured = np.array([step.measured_um.value for step in steps])
    certified = np.array([step.certified_um.value for step in steps])
    u = np.array([math.hypot(step.measured_um.u, step.certified_um.u) for step in steps])
    weight = 1 / np.maximum(u, 1e-6) ** 2
    energy = float((weight * certified**2).sum())
    amplification = Estimate(float((weight * certified * measured).sum()) / energy, math.sqrt(1 / energy))
    if len(np.unique(certified)) == 1:
        return ScaleResponse(amplification, None)
    residual = measured - amplification.value * certified
    farthest = int(np.argmax(np.abs(residual)))
    return ScaleResponse(amplification, Estimate(abs(float(residual[farthest])), float(u[farthest])))


def _levelled(z_um: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return heights minus their least-squares plane."""
    known = np.isfinite(z_um)
    if known.mean() < LEAST_MEASURED:
        raise _unmeasured()
    row, col = np.nonzero(known)
    design = np.stack([np.ones(len(row)), row - row.mean(), col - col.mean()], axis=1)
    values = z_um[known].astype(np.float64)
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    out = np.full(z_um.shape, np.nan)
    out[known] = values - design @ solution
    return out


def _block_means(z_um: Heights) -> NDArray[np.float64]:
    """Return means over square blocks, NaN for a block of which less than half is measured."""
    side = max(1, max(z_um.shape) // BLOCKS)
    rows, cols = (n // side for n in z_um.shape)
    blocks = z_um[: rows * side, : cols * side].reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, -1)
    known = np.isfinite(blocks)
    total = np.where(known, blocks, 0.0).sum(axis=2, dtype=np.float64)
    count = known.sum(axis=2)
    return np.where(count >= LEAST_MEASURED * side**2, total / np.maximum(count, 1), np.nan)


def _unmeasured() -> MeasureError:
    return MeasureError(
        "Less than half of the field is measured: choose a place with texture all over, and a range about its focus."
    )
