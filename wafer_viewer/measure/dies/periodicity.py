"""Lattice of a repeating pattern from the peaks of its autocorrelation. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.model.errors import DiesNotFound
from wafer_viewer.numerics.cross_correlation import contrast
from wafer_viewer.numerics.fourier import autocorrelation
from wafer_viewer.numerics.jit import Float32s


@dataclass(frozen=True, slots=True)
class PeriodicityParameters:
    """Limits of the search for a lattice in an autocorrelation.

    Parameters
    ----------
    least_correlation : float
        Smallest autocorrelation of a lag at which a pattern repeats.
    equal_correlation : float
        Fraction of the best autocorrelation above which a shorter lag is the period.
    half_correlation : float
        Fraction of the autocorrelation of the period from which a part of it makes the period ambiguous.
    shortest_px : int, px
        Shortest lag of a period.
    stands_out : float
        Smallest prominence of a lag over the surrounding lags, relative to its autocorrelation.
    goes_on : float
        Smallest prominence of far multiples relative to the first lag; patterns within a die do not reach it.
    limit_deg : float, deg
        Largest rotation of dies against the stage axes; beyond it rows and columns are confused.
    searched_deg : float, deg
        Half angle of the cone about an axis in which its period is searched.
    wide_deg : float, deg
        The same in the search for a lattice that is rotated too far.
    sizes : tuple[float, ...]
        Candidate high-pass scales, relative to the shorter side, used while the period is unknown.
    off_square_rad : float, rad
        Largest deviation of the two periods from a right angle, apart from two pixels on each.
    smaller : float
        Area ratio below which the smaller cell of a rotated lattice is taken.
    smoothing_px : float, px
        Standard deviation of the Gaussian that smooths an autocorrelation before its maxima are found.
    top_px : int, px
        Window in which a maximum is the largest.
    near : float
        Distance from the expected place of a maximum within which it is looked for, in periods.
    part_tolerance : float
        Largest deviation of a part of a period from a half or a third, relative to it.
    most_nodes : int
        Number of periods to either side beyond which the fit of the lattice is not extended.
    together_deg : float, deg
        Largest difference of the rotations of two axes that are rotated together.

    Notes
    -----
    `tests/bench/bench_dies.py` counts the lattices found, missed and wrong with these values on made-up wafers.
    """

    least_correlation: float = 0.15
    equal_correlation: float = 0.85
    half_correlation: float = 0.5
    shortest_px: int = 5
    stands_out: float = 0.2
    goes_on: float = 0.3
    limit_deg: float = 5.0
    searched_deg: float = 6.0
    wide_deg: float = 40.0
    sizes: tuple[float, ...] = (1 / 3, 1 / 6, 1 / 12, 1 / 24)
    off_square_rad: float = 0.02
    smaller: float = 0.75
    smoothing_px: float = 0.7
    top_px: int = 5
    near: float = 0.15
    part_tolerance: float = 0.05
    most_nodes: int = 32
    together_deg: float = 2


PERIODICITY = PeriodicityParameters()
MEND = "give pitch, origin and size of the dies instead"


@dataclass(frozen=True, slots=True)
class Peak:
    """A lag, in px to the right and upwards, and the autocorrelation there."""

    right: float
    up: float
    correlation: float

    @property
    def length(self) -> float:
        """Length of the lag, px."""
        return math.hypot(self.right, self.up)


def mean_autocorrelation(layers: Sequence[Float32s], size: int) -> Floats:
    """Return the mean autocorrelation of the layers with contrast, for lags up to half of the sides.

    Raises DiesNotFound where no layer has contrast.
    """
    found = [autocorrelation(detail) for layer in layers if (detail := _detail(layer, size)) is not None]
    if not found:
        raise DiesNotFound(f"The surface shows no contrast that dies could be found by: {MEND}.")
    return np.mean(found, axis=0)


def _detail(layer: Float32s, size: int) -> Floats | None:
    finite = np.isfinite(layer)
    if not finite.any() or float(np.ptp(layer[finite])) == 0:
        return None
    detail = contrast(layer, finite, size).astype(np.float64)
    return np.where(finite, detail - detail[finite].mean(), np.nan)


def peaks_of(correlation: Floats) -> list[Peak]:
    """Return the local maxima of an autocorrelation, except the central one."""
    from scipy.ndimage import gaussian_filter
    from skimage.feature import peak_local_max

    smooth = np.asarray(gaussian_filter(np.nan_to_num(correlation, nan=-1.0), PERIODICITY.smoothing_px))
    around = np.ones((PERIODICITY.top_px, PERIODICITY.top_px), bool)
    rows, cols = peak_local_max(
        smooth, threshold_abs=PERIODICITY.least_correlation, exclude_border=False, footprint=around
    ).T
    middle_row, middle_col = (n // 2 for n in correlation.shape)
    lags = zip((cols - middle_col).tolist(), (middle_row - rows).tolist(), smooth[rows, cols].tolist(), strict=True)
    return [Peak(*lag) for lag in lags if math.hypot(lag[0], lag[1]) >= PERIODICITY.shortest_px]


def peaks_near_axis(correlation: Floats, peaks: Sequence[Peak], upright: bool, half_deg: float) -> list[Peak]:
    """Return the peaks near the x axis, to the right, or near the y axis, upwards, that are prominent over the ridge.

    A pattern that is continuous along an axis, such as a street, correlates at every lag along it. A peak therefore
    counts by its excess over the median of all lags near the axis.
    """
    steep = math.tan(math.radians(half_deg))
    ridge = _ridge(correlation.T[::-1, ::-1] if upright else correlation, steep)

    def within(along: float, aside: float) -> bool:
        return along >= PERIODICITY.shortest_px and abs(aside) <= steep * along + 1

    near = [peak for peak in peaks if within(*((peak.up, peak.right) if upright else (peak.right, peak.up)))]
    over = [Peak(peak.right, peak.up, peak.correlation - ridge) for peak in near]
    return [
        peak
        for peak in over
        if peak.correlation >= PERIODICITY.stands_out * max(PERIODICITY.least_correlation, peak.correlation + ridge)
    ]


def _ridge(correlation: Floats, steep: float) -> float:
    """Return the median over lags of the largest autocorrelation within a cone about the axis; at least 0."""
    row, col = (n // 2 for n in correlation.shape)
    most = [
        float(np.nanmax(correlation[max(0, row - aside) : row + aside + 1, col + along], initial=-1.0))
        for along in range(PERIODICITY.shortest_px, col + 1)
        for aside in [min(row, math.floor(steep * along + 1))]
    ]
    return max(0.0, float(np.median(most)) if most else 0.0)


def shortest(peaks: Sequence[Peak]) -> Peak:
    """Return the shortest lag with an autocorrelation close to the best."""
    best = max(peak.correlation for peak in peaks)
    return min(
        (peak for peak in peaks if peak.correlation >= PERIODICITY.equal_correlation * best),
        key=lambda peak: peak.length,
    )


def persistent_lags(correlation: Floats, peaks: Sequence[Peak]) -> list[Peak]:
    """Return the lags that persist over the surface; patterns within a die, such as pads, end with the die."""
    return [peak for peak in peaks if _persists(correlation, peak)]


def _persists(correlation: Floats, peak: Peak) -> bool:
    """Return whether far multiples keep enough of the first lag's prominence over lags half a period away.

    On a round wafer the autocorrelation of peaks and valleys alike falls with the lag; prominence is independent of
    that.
    """
    middle = np.array([n // 2 for n in correlation.shape])
    step = np.array([-peak.up, peak.right])
    most = math.floor(float(np.min((middle - 2) / np.maximum(1, np.abs(step))) - 0.5))
    over = [_stands_out(correlation, middle + times * step, step / 2) for times in range(1, most + 1)]
    return len(over) < 2 or float(np.median(over[len(over) // 2 :])) >= PERIODICITY.goes_on * over[0]


def _stands_out(correlation: Floats, place: Floats, half: Floats) -> float:
    near = max(1, round(PERIODICITY.near * 2 * float(np.hypot(*half))))
    row, col = (max(0, round(float(k))) for k in place)
    top = float(
        np.nanmax(correlation[max(0, row - near) : row + near + 1, max(0, col - near) : col + near + 1], initial=-1)
    )
    valleys = [correlation[tuple(np.rint(place + side * half).astype(int))] for side in (-1, 1)]
    return top - float(np.mean(valleys))


def ambiguous_fraction(periods: Sequence[Peak]) -> Peak | None:
    """Return a half or a third of the period that may also be the period; None where unambiguous."""
    period = shortest(periods)
    near = (
        peak
        for peak in periods
        if _is_part(peak, period) and peak.correlation >= PERIODICITY.half_correlation * period.correlation
    )
    return next(near, None)


def _is_part(peak: Peak, period: Peak) -> bool:
    times = period.length / peak.length
    return round(times) in (2, 3) and abs(times - round(times)) < PERIODICITY.part_tolerance * times


AXES = ((False, "x"), (True, "y"))


@dataclass(frozen=True, slots=True)
class Periods:
    """Lattice of a pattern in px: two pitches, anticlockwise rotation, and autocorrelation."""

    pitch_x: float
    pitch_y: float
    angle_rad: float
    correlation: float


@dataclass(frozen=True, slots=True)
class Askew:
    """A lattice rotated too far: rotation, and area of its cell, px2."""

    turn_deg: float
    area: float


def periods_of(layers: Sequence[Float32s]) -> Periods:
    """Return the lattice of layers [row, col] that show one pattern, NaN where unknown.

    Raises MeasureError where nothing repeats along an axis within half of its side, where the period is ambiguous with
    a fraction of it, and where the lattice is rotated by more than `PERIODICITY.limit_deg`.
    """
    shorter = min(layers[0].shape)
    best = clearest(layers, [round(share * shorter) for share in PERIODICITY.sizes])
    if best is None:
        raise nothing_repeats(layers)
    across, up = (unambiguous_period(periods, axis) for periods, axis in ((best.right, "x"), (best.up, "y")))
    return _checked(fitted(best.correlation, across, up), _askew(best.correlation, best.peaks))


@dataclass(frozen=True, slots=True, eq=False)
class Periodicity:
    """Periodicity after a high-pass at some scale in px.

    An autocorrelation, its peaks, and those along x and y that persist over the surface.
    """

    correlation: Floats
    peaks: list[Peak]
    right: list[Peak]
    up: list[Peak]

    @property
    def clear(self) -> tuple[bool, float]:
        """Sort key: True if both periods are unambiguous, and the autocorrelation of the weaker one."""
        plain = ambiguous_fraction(self.right) is None and ambiguous_fraction(self.up) is None
        return plain, min(shortest(self.right).correlation, shortest(self.up).correlation)


def clearest(layers: Sequence[Float32s], sizes: Sequence[int]) -> Periodicity | None:
    """Return the periodicity for the best high-pass scale; None where nothing repeats at any.

    Slow variations, as beyond the rim of a wafer or at missing dies, favour some multiples of a period; the high-pass
    removes them.
    """
    each = (_repeats(layers, size) for size in sorted({max(3, size) for size in sizes}))
    return max((one for one in each if one is not None), key=lambda one: one.clear, default=None)


def _repeats(layers: Sequence[Float32s], size: int) -> Periodicity | None:
    correlation = mean_autocorrelation(layers, size)
    peaks = peaks_of(correlation)
    right, up = (
        persistent_lags(correlation, peaks_near_axis(correlation, peaks, upright, PERIODICITY.searched_deg))
        for upright, _ in AXES
    )
    return Periodicity(correlation, peaks, right, up) if right and up else None


def unambiguous_period(periods: Sequence[Peak], axis: str) -> Peak:
    """Return the period along an axis. Raises MeasureError where a fraction of it correlates nearly as well."""
    period, part = shortest(periods), ambiguous_fraction(periods)
    if part is not None:
        raise DiesNotFound(
            f"The pitch along {axis} may be all or 1/{round(period.length / part.length)} of what repeats best, for "
            f"neighbours are {100 * part.correlation / period.correlation:.0f} % as much alike: {MEND}.",
            f"No dies found: their pitch along {axis} is ambiguous",
        )
    return period


def fitted(correlation: Floats, across: Peak, up: Peak) -> tuple[Floats, Floats, float]:
    """Fit both periods [right, up] in px to all similar lags of their lattice; also return the autocorrelation."""
    basis = np.array([[across.right, across.up], [up.right, up.up]])
    reach = 1
    while True:
        nodes, places = _nodes_near(correlation, basis, reach)
        if len(nodes) > 2:
            basis = np.asarray(np.linalg.lstsq(nodes, places, rcond=None)[0], np.float64)
        limits = [half / (2 * reach) for half in (correlation.shape[1] // 2, correlation.shape[0] // 2)]
        if reach > PERIODICITY.most_nodes or all(abs(basis[k, k]) > limits[k] for k in (0, 1)):
            return basis[0], basis[1], min(across.correlation, up.correlation)
        reach *= 2


def _nodes_near(correlation: Floats, basis: Floats, reach: int) -> tuple[Floats, Floats]:
    """Return multiples (i, j) of the periods, and the subpixel lag of the local maximum near each."""
    middle = np.array([n // 2 for n in correlation.shape])
    near = max(2, round(PERIODICITY.near * float(np.abs(np.diag(basis)).min())))
    nodes: list[tuple[int, int]] = []
    places: list[tuple[float, float]] = []
    for i in range(-reach, reach + 1):
        for j in range(reach + 1):
            right, up = np.array([i, j]) @ basis
            row, col = round(middle[0] - up), round(middle[1] + right)
            if (j > 0 or i > 0) and (top := top_near(correlation, row, col, near)) is not None:
                nodes.append((i, j))
                places.append((top[1] - middle[1], middle[0] - top[0]))
    return np.array(nodes, float), np.array(places, float)


def top_near(correlation: Floats, row: int, col: int, near: int) -> tuple[float, float] | None:
    """Return (row, col) of the maximum near a place, to subpixels by parabolas; None at the border or if too low."""
    low_row, low_col = row - near, col - near
    part = correlation[max(0, low_row) : row + near + 1, max(0, low_col) : col + near + 1]
    if low_row < 1 or low_col < 1 or row + near + 2 > correlation.shape[0] or col + near + 2 > correlation.shape[1]:
        return None
    if np.isnan(part).any() or part.max() < PERIODICITY.least_correlation / 2:
        return None
    r, c = (int(k) for k in np.unravel_index(int(np.argmax(part)), part.shape))
    r, c = r + low_row, c + low_col
    return r + vertex(*correlation[r - 1 : r + 2, c].tolist()), c + vertex(*correlation[r, c - 1 : c + 2].tolist())


def vertex(before: float, middle: float, after: float) -> float:
    """Return the vertex of a parabola through three values, relative to the middle one."""
    bend = before - 2 * middle + after
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def _checked(found: tuple[Floats, Floats, float], askew: Askew | None) -> Periods:
    """Return the periods. Raises MeasureError where the lattice is rotated too far or not square."""
    across, up, correlation = found
    if askew is not None and askew.area < PERIODICITY.smaller * abs(float(np.linalg.det([across, up]))):
        raise turned_too_far(askew.turn_deg)
    turn_x, turn_y = math.atan2(across[1], across[0]), math.atan2(-up[0], up[1])
    if abs(turn_x - turn_y) > PERIODICITY.off_square_rad + 2 / math.hypot(*across) + 2 / math.hypot(*up):
        if askew is not None:
            raise turned_too_far(askew.turn_deg)
        raise DiesNotFound(
            f"What repeats along x and y is {math.degrees(abs(turn_x - turn_y)):.1f} degrees off square and dies are "
            f"not: {MEND}."
        )
    lengths = float(np.hypot(*across)), float(np.hypot(*up))
    angle = (turn_x * lengths[0] + turn_y * lengths[1]) / sum(lengths)
    if abs(math.degrees(angle)) > PERIODICITY.limit_deg:
        raise turned_too_far(math.degrees(angle))
    return Periods(*lengths, angle, correlation)


def turned_too_far(angle_deg: float) -> DiesNotFound:
    """Return the error for a wafer that is rotated too far."""
    return DiesNotFound(
        f"The dies are turned by {angle_deg:.1f} degrees and at most {PERIODICITY.limit_deg:g} can be found: turn the "
        f"wafer, or {MEND}.",
        f"No dies found: turned by {angle_deg:.1f} degrees",
    )


def nothing_repeats(layers: Sequence[Float32s]) -> DiesNotFound:
    """Return the error for a missing lattice: along which axis, or that it is rotated too far."""
    correlation = mean_autocorrelation(layers, max(3, min(layers[0].shape) // 6))
    peaks = peaks_of(correlation)
    right, up = (
        persistent_lags(correlation, peaks_near_axis(correlation, peaks, upright, PERIODICITY.searched_deg))
        for upright, _ in AXES
    )
    if (askew := _askew(correlation, peaks)) is not None:
        return turned_too_far(askew.turn_deg)
    axes = " or ".join(name for name, some in (("x", right), ("y", up)) if not some) or "x and y together"
    return DiesNotFound(
        f"No dies are found, because nothing repeats along {axes} within half of the surface, and at least two dies "
        f"are needed along each axis: scan more dies, or {MEND}.",
        f"No dies found: nothing repeats along {axes}",
    )


def _askew(correlation: Floats, peaks: Sequence[Peak]) -> Askew | None:
    """Return the lattice of the shortest lags if both axes are rotated together beyond the limit; None otherwise."""
    wide = [peaks_near_axis(correlation, peaks, upright, PERIODICITY.wide_deg) for upright in (False, True)]
    if not all(wide):
        return None
    across, up = map(shortest, wide)
    turn_x, turn_y = (math.degrees(math.atan2(*lag)) for lag in ((across.up, across.right), (-up.right, up.up)))
    far = abs(turn_x - turn_y) < PERIODICITY.together_deg and abs(turn_x) > PERIODICITY.limit_deg
    return Askew(turn_x, across.length * up.length) if far else None
