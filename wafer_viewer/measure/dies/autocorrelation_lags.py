"""Lags at which a pattern is like itself: the peaks of its autocorrelation, and which of them go on over it. Pure."""

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
"""Autocorrelation of a lag at which a pattern repeats, at least."""
AS_ALIKE, HALF_ALIKE = 0.85, 0.5
"""Of the best lag: a shorter one that is as much alike is the period; one in between leaves it open which is."""
SHORTEST_PX = 5
STANDS_OUT = 0.2
"""Of how much alike a lag is: so much it has at least over the lags round it."""
GOES_ON = 0.3
"""Of how the first lag stands out: the far multiples of a period do, those of what repeats within a die do not."""
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


def alike_of(layers: Sequence[Float32s], size: int) -> Floats:
    """The mean autocorrelation of the layers that show any contrast, for lags up to half of the sides."""
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


def part_of(periods: Sequence[Peak]) -> Peak | None:
    """A half or a third of the period that might be it as well; None where it is plain."""
    period = shortest(periods)
    near = (peak for peak in periods if _is_part(peak, period) and peak.alike >= HALF_ALIKE * period.alike)
    return next(near, None)


def _is_part(peak: Peak, period: Peak) -> bool:
    times = period.length / peak.length
    return round(times) in (2, 3) and abs(times - round(times)) < 0.05 * times
