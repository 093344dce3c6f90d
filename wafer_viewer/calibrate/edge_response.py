"""Width of the response to a step: the heights across a straight steep edge.

The line of the edge is fitted to the borders between upper and lower heights, and each level is a plane. A profile is
the heights of a piece of the edge over their distance from the line. Its width is the distance between the last place
where most heights are within a tenth of the step of the lower level and the first place where most are within a tenth
of the upper one. Pixels without a height are within neither: a gap of rejected heights is part of the width.

This width describes how near to a steep edge heights are measured. It is not the topographic spatial resolution of
ISO 25178-600, which the response to a certified star-shaped groove gives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.calibrate.pixel_scale import Estimate
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, u_of_mean

Heights = NDArray[np.float32]
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
