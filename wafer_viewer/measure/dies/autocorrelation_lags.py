"""Autocorrelation peaks of a pattern, and those that persist over the surface. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.model.errors import DiesNotFound
from wafer_viewer.numerics.array_types import Float32s
from wafer_viewer.numerics.filters.autocorrelation import autocorrelation
from wafer_viewer.numerics.registration.cross_correlation import contrast

LEAST_ALIKE = 0.15
"""Smallest autocorrelation of a lag at which a pattern repeats."""
AS_ALIKE, HALF_ALIKE = 0.85, 0.5
"""Fractions of the best autocorrelation: above the first a shorter lag is the period, in between it is ambiguous."""
SHORTEST_PX = 5
STANDS_OUT = 0.2
"""Smallest prominence of a lag over the surrounding lags, relative to its autocorrelation."""
GOES_ON = 0.3
"""Smallest prominence of far multiples relative to the first lag; patterns within a die do not reach it."""
MEND = "give pitch, origin and size of the dies instead"


@dataclass(frozen=True, slots=True)
class Peak:
    """A lag, in px to the right and upwards, and the autocorrelation there."""

    right: float
    up: float
    alike: float

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
    known = np.isfinite(layer)
    if not known.any() or float(np.ptp(layer[known])) == 0:
        return None
    detail = contrast(layer, known, size).astype(np.float64)
    return np.where(known, detail - detail[known].mean(), np.nan)


def peaks_of(alike: Floats) -> list[Peak]:
    """Return the local maxima of an autocorrelation, except the central one."""
    from scipy.ndimage import gaussian_filter, maximum_filter

    smooth = np.asarray(gaussian_filter(np.nan_to_num(alike, nan=-1.0), 0.7))
    tops = (smooth == np.asarray(maximum_filter(smooth, 5))) & (smooth > LEAST_ALIKE)
    rows, cols = np.nonzero(tops)
    middle_row, middle_col = (n // 2 for n in alike.shape)
    lags = zip((cols - middle_col).tolist(), (middle_row - rows).tolist(), smooth[rows, cols].tolist(), strict=True)
    return [Peak(*lag) for lag in lags if math.hypot(lag[0], lag[1]) >= SHORTEST_PX]


def peaks_near_axis(alike: Floats, peaks: Sequence[Peak], upright: bool, half_deg: float) -> list[Peak]:
    """Return the peaks near the x axis, to the right, or near the y axis, upwards, that are prominent over the ridge.

    A pattern that is continuous along an axis, such as a street, correlates at every lag along it. A peak therefore
    counts by its excess over the median of all lags near the axis.
    """
    steep = math.tan(math.radians(half_deg))
    ridge = _ridge(alike.T[::-1, ::-1] if upright else alike, steep)

    def within(along: float, aside: float) -> bool:
        return along >= SHORTEST_PX and abs(aside) <= steep * along + 1

    near = [peak for peak in peaks if within(*((peak.up, peak.right) if upright else (peak.right, peak.up)))]
    over = [Peak(peak.right, peak.up, peak.alike - ridge) for peak in near]
    return [peak for peak in over if peak.alike >= STANDS_OUT * max(LEAST_ALIKE, peak.alike + ridge)]


def _ridge(alike: Floats, steep: float) -> float:
    """Return the median over lags of the largest autocorrelation within a cone about the axis; at least 0."""
    row, col = (n // 2 for n in alike.shape)
    most = [
        float(np.nanmax(alike[max(0, row - aside) : row + aside + 1, col + along], initial=-1.0))
        for along in range(SHORTEST_PX, col + 1)
        for aside in [min(row, math.floor(steep * along + 1))]
    ]
    return max(0.0, float(np.median(most)) if most else 0.0)


def shortest(peaks: Sequence[Peak]) -> Peak:
    """Return the shortest lag with an autocorrelation close to the best."""
    best = max(peak.alike for peak in peaks)
    return min((peak for peak in peaks if peak.alike >= AS_ALIKE * best), key=lambda peak: peak.length)


def persistent_lags(alike: Floats, peaks: Sequence[Peak]) -> list[Peak]:
    """Return the lags that persist over the surface; patterns within a die, such as pads, end with the die."""
    return [peak for peak in peaks if _goes_on(alike, peak)]


def _goes_on(alike: Floats, peak: Peak) -> bool:
    """Return whether far multiples keep enough of the first lag's prominence over lags half a period away.

    On a round wafer the autocorrelation of peaks and valleys alike falls with the lag; prominence is independent of
    that.
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


def ambiguous_fraction(periods: Sequence[Peak]) -> Peak | None:
    """Return a half or a third of the period that may also be the period; None where unambiguous."""
    period = shortest(periods)
    near = (peak for peak in periods if _is_part(peak, period) and peak.alike >= HALF_ALIKE * period.alike)
    return next(near, None)


def _is_part(peak: Peak, period: Peak) -> bool:
    times = period.length / peak.length
    return round(times) in (2, 3) and abs(times - round(times)) < 0.05 * times
