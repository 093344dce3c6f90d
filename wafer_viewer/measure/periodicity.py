"""Which lattice a pattern repeats on: the two shortest lags, along x and y, at which it is like itself again. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.heights import Floats
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.numerics.arrays import Float32s
from wafer_viewer.numerics.autocorrelation import autocorrelation
from wafer_viewer.numerics.likeness import contrast

LIMIT_DEG = 5.0
"""Dies turned further against the axes of the stage are refused: rows and columns would be taken for each other."""
SEARCHED_DEG, WIDE_DEG = 6.0, 40.0
LEAST_ALIKE = 0.15
"""Autocorrelation of a lag at which a pattern repeats, at least."""
AS_ALIKE, HALF_ALIKE = 0.75, 0.5
"""Of the best lag: a shorter one that is as much alike is the period; one in between leaves it open which is."""
SHORTEST_PX = 5
SIZES = (1 / 3, 1 / 6, 1 / 12, 1 / 24)
"""Of the shorter side: what varies over more is taken off before the period is known."""
OFF_SQUARE_RAD = 0.02
STANDS_OUT = 0.2
"""Of how much alike a lag is: so much it has at least over the lags round it."""
GOES_ON = 0.3
"""Of how the first lag stands out: the far multiples of a period do, those of what repeats within a die do not."""
AXES = ((False, "x"), (True, "y"))
MEND = "give pitch, origin and size of the dies instead"


@dataclass(frozen=True, slots=True)
class Peak:
    """A lag, px to the right and upwards, and how much alike the pattern is there."""

    right: float
    up: float
    alike: float

    @property
    def length(self) -> float:
        """Of the lag, px."""
        return math.hypot(self.right, self.up)


@dataclass(frozen=True, slots=True)
class Periods:
    """The lattice of a pattern in px: its two pitches, how it is turned anticlockwise, how much alike it is."""

    pitch_x: float
    pitch_y: float
    angle_rad: float
    alike: float


def periods_of(layers: Sequence[Float32s]) -> Periods:
    """Of layers [row, col] that show one pattern, NaN where unknown.

    Raises MeasureError where nothing repeats along an axis within half of its side, where it is open whether a pitch
    or a part of it is the period, and where the lattice is turned by more than LIMIT_DEG.
    """
    shorter = min(layers[0].shape)
    rough = [_rough(layers, size) for size in sorted({max(3, round(share * shorter)) for share in SIZES})]
    found = [pair for pair in rough if pair is not None]
    if not found:
        raise nothing_repeats(layers)
    across, up = max(found, key=lambda pair: min(pair[0].alike, pair[1].alike))
    alike = alike_of(layers, max(3, round(math.sqrt(across.length * up.length))))
    peaks = peaks_of(alike)
    across, up = (settled(alike, cone(alike, peaks, upright, SEARCHED_DEG), axis) for upright, axis in AXES)
    found = fitted(alike, across, up)
    return _checked(found, _askew_deg(alike, peaks))


def _rough(layers: Sequence[Float32s], size: int) -> tuple[Peak, Peak] | None:
    alike = alike_of(layers, size)
    peaks = peaks_of(alike)
    right, up = (lasting(alike, cone(alike, peaks, upright, SEARCHED_DEG)) for upright, _ in AXES)
    return (shortest(right), shortest(up)) if right and up else None


def alike_of(layers: Sequence[Float32s], size: int) -> Floats:
    """The mean autocorrelation of the layers that show any contrast, for lags up to half of the sides."""
    found = [autocorrelation(detail) for layer in layers if (detail := _detail(layer, size)) is not None]
    if not found:
        raise MeasureError(f"The surface shows no contrast that dies could be found by: {MEND}.")
    return np.mean(found, axis=0)


def _detail(layer: Float32s, size: int) -> Floats | None:
    known = np.isfinite(layer)
    if not known.any() or float(np.ptp(layer[known])) == 0:
        return None
    detail = contrast(layer, known, size).astype(np.float64)
    return np.where(known, detail - detail[known].mean(), np.nan)


def peaks_of(alike: Floats) -> list[Peak]:
    """Local maxima of an autocorrelation, apart from the one in its middle."""
    from scipy.ndimage import gaussian_filter, maximum_filter

    smooth = np.asarray(gaussian_filter(np.nan_to_num(alike, nan=-1.0), 0.7))
    tops = (smooth == np.asarray(maximum_filter(smooth, 5))) & (smooth > LEAST_ALIKE)
    rows, cols = np.nonzero(tops)
    middle_row, middle_col = (n // 2 for n in alike.shape)
    lags = zip((cols - middle_col).tolist(), (middle_row - rows).tolist(), smooth[rows, cols].tolist(), strict=True)
    return [Peak(*lag) for lag in lags if math.hypot(lag[0], lag[1]) >= SHORTEST_PX]


def cone(alike: Floats, peaks: Sequence[Peak], upright: bool, half_deg: float) -> list[Peak]:
    """The peaks near the x axis, to the right, or near the y axis, upwards, that stand out of the ridge there.

    A pattern that goes on along an axis, as a street does, is like itself at every lag along it: a peak counts by what
    it has over the median of all lags near the axis.
    """
    steep = math.tan(math.radians(half_deg))
    ridge = _ridge(alike.T[::-1, ::-1] if upright else alike, steep)

    def within(along: float, aside: float) -> bool:
        return along >= SHORTEST_PX and abs(aside) <= steep * along + 1

    near = [peak for peak in peaks if within(*((peak.up, peak.right) if upright else (peak.right, peak.up)))]
    over = [Peak(peak.right, peak.up, peak.alike - ridge) for peak in near]
    return [peak for peak in over if peak.alike >= STANDS_OUT * max(LEAST_ALIKE, peak.alike + ridge)]


def _ridge(alike: Floats, steep: float) -> float:
    """The median over all lags to the right of the most alike within a cone about the axis; at least 0."""
    row, col = (n // 2 for n in alike.shape)
    most = [
        float(np.nanmax(alike[max(0, row - aside) : row + aside + 1, col + along], initial=-1.0))
        for along in range(SHORTEST_PX, col + 1)
        for aside in [min(row, math.floor(steep * along + 1))]
    ]
    return max(0.0, float(np.median(most)) if most else 0.0)


def shortest(peaks: Sequence[Peak]) -> Peak:
    """The shortest lag that is as much alike as the best."""
    best = max(peak.alike for peak in peaks)
    return min((peak for peak in peaks if peak.alike >= AS_ALIKE * best), key=lambda peak: peak.length)


def lasting(alike: Floats, peaks: Sequence[Peak]) -> list[Peak]:
    """The lags that go on over the surface: what repeats within a die, pads say, ends with the die."""
    return [peak for peak in peaks if _goes_on(alike, peak)]


def _goes_on(alike: Floats, peak: Peak) -> bool:
    """Whether the far multiples stand out of the lags half a period before and after them as the first does.

    On a round wafer all lags are less alike the longer they are, peaks and valleys: so it is by what stands out.
    """
    middle = np.array([n // 2 for n in alike.shape])
    step = np.array([-peak.up, peak.right])
    most = math.floor(float(np.min((middle - 2) / np.maximum(1, np.abs(step))) - 0.5))
    over = [_stands_out(alike, middle + times * step, step / 2) for times in range(1, most + 1)]
    return len(over) < 2 or float(np.median(over[len(over) // 2 :])) >= GOES_ON * over[0]


def _stands_out(alike: Floats, place: Floats, half: Floats) -> float:
    near = max(1, round(0.15 * 2 * float(np.hypot(*half))))
    row, col = (max(0, round(float(k))) for k in place)
    top = float(np.nanmax(alike[max(0, row - near) : row + near + 1, max(0, col - near) : col + near + 1], initial=-1))
    valleys = [alike[tuple(np.rint(place + side * half).astype(int))] for side in (-1, 1)]
    return top - float(np.mean(valleys))


def settled(alike: Floats, peaks: Sequence[Peak], axis: str) -> Peak:
    """The period along an axis. Raises MeasureError where there is none, or a part of it is nearly as much alike."""
    if not (periods := lasting(alike, peaks)):
        raise MeasureError(
            f"Nothing repeats along {axis} within half of the surface, and at least two dies are needed along each "
            f"axis: scan more dies, or {MEND}."
        )
    period = shortest(periods)
    part = next((peak for peak in periods if _is_part(peak, period) and peak.alike >= HALF_ALIKE * period.alike), None)
    if part is not None:
        raise MeasureError(
            f"The pitch along {axis} may be all or 1/{round(period.length / part.length)} of what repeats best, for "
            f"neighbours are {100 * part.alike / period.alike:.0f} % as much alike: {MEND}."
        )
    return period


def _is_part(peak: Peak, period: Peak) -> bool:
    times = period.length / peak.length
    return round(times) in (2, 3) and abs(times - round(times)) < 0.05 * times


def fitted(alike: Floats, across: Peak, up: Peak) -> tuple[Floats, Floats, float]:
    """Both periods [right, up] in px by all lags of their lattice that are as much alike, and how much those are."""
    basis = np.array([[across.right, across.up], [up.right, up.up]])
    reach = 1
    while True:
        nodes, places = _nodes_near(alike, basis, reach)
        if len(nodes) > 2:
            basis = np.asarray(np.linalg.lstsq(nodes, places, rcond=None)[0], np.float64)
        limits = [half / (2 * reach) for half in (alike.shape[1] // 2, alike.shape[0] // 2)]
        if reach > 32 or all(abs(basis[k, k]) > limits[k] for k in (0, 1)):
            return basis[0], basis[1], min(across.alike, up.alike)
        reach *= 2


def _nodes_near(alike: Floats, basis: Floats, reach: int) -> tuple[Floats, Floats]:
    """Multiples (i, j) of the periods, and the lag of the local maximum near each, between the pixels."""
    middle = np.array([n // 2 for n in alike.shape])
    near = max(2, round(0.15 * float(np.abs(np.diag(basis)).min())))
    nodes: list[tuple[int, int]] = []
    places: list[tuple[float, float]] = []
    for i in range(-reach, reach + 1):
        for j in range(reach + 1):
            right, up = np.array([i, j]) @ basis
            row, col = round(middle[0] - up), round(middle[1] + right)
            if (j > 0 or i > 0) and (top := top_near(alike, row, col, near)) is not None:
                nodes.append((i, j))
                places.append((top[1] - middle[1], middle[0] - top[0]))
    return np.array(nodes, float), np.array(places, float)


def top_near(alike: Floats, row: int, col: int, near: int) -> tuple[float, float] | None:
    """(row, col) of the largest value near a place, between pixels by parabolas; None at the border or if too low."""
    low_row, low_col = row - near, col - near
    part = alike[max(0, low_row) : row + near + 1, max(0, low_col) : col + near + 1]
    if low_row < 1 or low_col < 1 or row + near + 2 > alike.shape[0] or col + near + 2 > alike.shape[1]:
        return None
    if np.isnan(part).any() or part.max() < LEAST_ALIKE / 2:
        return None
    r, c = (int(k) for k in np.unravel_index(int(np.argmax(part)), part.shape))
    r, c = r + low_row, c + low_col
    return r + vertex(*alike[r - 1 : r + 2, c].tolist()), c + vertex(*alike[r, c - 1 : c + 2].tolist())


def vertex(before: float, at: float, after: float) -> float:
    """Where a parabola through three values has its top, counted from the middle one."""
    bend = before - 2 * at + after
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def _checked(found: tuple[Floats, Floats, float], askew_deg: float | None) -> Periods:
    """Raises MeasureError where the lattice is turned too far or its periods are not square to each other."""
    across, up, alike = found
    turn_x, turn_y = math.atan2(across[1], across[0]), math.atan2(-up[0], up[1])
    if abs(turn_x - turn_y) > OFF_SQUARE_RAD + 2 / math.hypot(*across) + 2 / math.hypot(*up):
        if askew_deg is not None:
            raise turned_too_far(askew_deg)
        raise MeasureError(
            f"What repeats along x and y is {math.degrees(abs(turn_x - turn_y)):.1f} degrees off square and dies are "
            f"not: {MEND}."
        )
    lengths = float(np.hypot(*across)), float(np.hypot(*up))
    angle = (turn_x * lengths[0] + turn_y * lengths[1]) / sum(lengths)
    if abs(math.degrees(angle)) > LIMIT_DEG:
        raise turned_too_far(math.degrees(angle))
    return Periods(*lengths, angle, alike)


def turned_too_far(angle_deg: float) -> MeasureError:
    """What to say of a wafer that lies askew."""
    return MeasureError(
        f"The dies are turned by {angle_deg:.1f} degrees and at most {LIMIT_DEG:g} can be found: turn the wafer, or "
        f"{MEND}."
    )


def nothing_repeats(layers: Sequence[Float32s]) -> MeasureError:
    """What to say where no lattice is found: along which axis, or that it is turned too far."""
    alike = alike_of(layers, max(3, min(layers[0].shape) // 6))
    peaks = peaks_of(alike)
    right, up = (lasting(alike, cone(alike, peaks, upright, SEARCHED_DEG)) for upright, _ in AXES)
    if (askew := _askew_deg(alike, peaks)) is not None:
        return turned_too_far(askew)
    axes = " or ".join(name for name, some in (("x", right), ("y", up)) if not some) or "x and y together"
    return MeasureError(
        f"No dies are found, for nothing repeats along {axes} within half of the surface, and at least two dies are "
        f"needed along each axis: scan more dies, or {MEND}."
    )


def _askew_deg(alike: Floats, peaks: Sequence[Peak]) -> float | None:
    """How far the shortest lags about both axes are turned together, degrees; None where they are not, or little."""
    wide = [cone(alike, peaks, upright, WIDE_DEG) for upright in (False, True)]
    if not all(wide):
        return None
    across, up = map(shortest, wide)
    turn_x, turn_y = (math.degrees(math.atan2(*lag)) for lag in ((across.up, across.right), (-up.right, up.up)))
    return turn_x if abs(turn_x - turn_y) < 2 and abs(turn_x) > LIMIT_DEG else None
