"""Periods of a pattern along the axes of its dies, from the similarity of its columns and of its rows. Pure.

The gradients of heights and image are compared, which removes tilt, film and brightness. After the rotation is removed,
the columns at x and x + lag are correlated for every x and lag. At the pitch of dies all columns resemble each other;
at the pitch of pads, lines or memory cells those at the streets do not. Rows follow in the same way, so that the pitch
along one axis needs no repetition along the other.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.dies.pattern_gradients import (
    GRADIENTS,
    MEND,
    Gradients,
    active_pixels,
    gradients_of,
    rotation_of,
    turned,
    turned_too_far,
    vertex,
)
from wafer_viewer.model.errors import DiesNotFound
from wafer_viewer.numerics.jit import Bools, Float32s


@dataclass(frozen=True, slots=True)
class PeriodicityParameters:
    """Limits of the search for the periods of a pattern.

    Parameters
    ----------
    shortest_px : int, px
        Shortest period.
    longest : float
        Longest period relative to the extent of the pattern.
    segments : int
        Segments of a column that are compared one by one; missing dies spoil some of them.
    similar : float
        Smallest correlation of similar segments.
    nearly : float
        Weight of a correlation one pixel off, which is larger by chance.
    majority : float
        Fraction of a column's dissimilar segments from which the column is dissimilar.
    repeating : float
        Smallest share of a layer's energy that counts as repeating.
    energy : float
        Smallest energy of a compared column relative to the columns rich in edges.
    least_correlation : float
        Smallest correlation at a lag that may be a period.
    scatters : float
        Smallest energy of a compared segment, in standard deviations of its products due to noise.
    gap : float
        Largest energy of the edges across a street, relative to the lower quartile of all columns.
    calm : float
        The same for the place where a street recurs.
    end_px : int, px
        Distance from the ends of the pattern within which there is no street between dies.
    recurs : float
        Smallest fraction of streets that recur at the period.
    unbroken : float
        Smallest unbroken run of similar columns relative to the extent, for a period of dies.
    partly : float
        The same where it exceeds that of all shorter lags clearly.
    clearer : float
        Ratio from which it does.
    without_streets : float
        The same where no streets recur.
    longest_die : float
        Largest ratio of the sides of the dies of a single row.
    few : float
        Largest period relative to the extent for a period by clearness alone.
    doubtful : float
        Unbroken run from which what repeats coarsely within a single row may be dies.
    fine : float
        Period relative to the extent above which it is coarse.
    apart : float
        Ratio of two lags below which only the better one may be the period.
    as_similar : float
        Correlation of a shorter lag, relative to that of the period, from which the period is doubtful without streets.
    off_px : float, px
        Largest distance of a multiple of the period from its expected place.
    better : float
        Excess of the correlation at a multiple of a lag over that at the lag, from which the period is doubtful.
    expected_within : float
        Relative distance from a given pitch within which the period is searched.

    Notes
    -----
    `tests/bench/bench_dies.py` counts the lattices found, missed and wrong with these values on made-up wafers.
    """

    shortest_px: int = 6
    longest: float = 0.85
    segments: int = 6
    similar: float = 0.5
    nearly: float = 0.8
    majority: float = 0.6
    repeating: float = 0.4
    energy: float = 0.1
    least_correlation: float = 0.3
    scatters: float = 4.0
    gap: float = 0.25
    calm: float = 0.6
    end_px: int = 6
    recurs: float = 0.7
    unbroken: float = 0.65
    partly: float = 0.3
    clearer: float = 3.0
    without_streets: float = 0.96
    longest_die: float = 4.0
    few: float = 0.26
    doubtful: float = 0.88
    fine: float = 0.25
    apart: float = 1.6
    as_similar: float = 0.85
    off_px: float = 1.5
    better: float = 0.12
    expected_within: float = 0.03


PERIODICITY = PeriodicityParameters()


@dataclass(frozen=True, slots=True)
class Periods:
    """Pitches along x and y in px, None where nothing repeats, and the rotation, anticlockwise.

    right, up: (low, high) of the pattern along both axes, px from the centre of the surface. streets: along x and y,
    whether strips recur that no edge crosses.
    """

    pitch_x: float | None
    pitch_y: float | None
    angle_rad: float
    right: tuple[float, float]
    up: tuple[float, float]
    streets: tuple[bool, bool]


def periods_of(layers: Sequence[Float32s], expected_px: tuple[float, float] | None = None) -> Periods:
    """Return the periods of layers [row, col] that show one pattern, NaN where unknown.

    expected_px: known pitches along x and y, next to which the periods are taken.

    Raises DiesNotFound where there is no contrast, where nothing repeats along either axis, where a period is doubtful,
    and where the pattern is rotated by more than `GRADIENTS.limit_deg`.
    """
    seen = gradients_of(layers)
    angle_deg = rotation_of(seen)
    straight = gradients_of([turned(layer, math.radians(angle_deg)) for layer in layers])
    active = active_pixels(straight)
    across = similarity(straight, active)
    down = similarity([one.transposed for one in straight], active.T)
    up = -down.extent[1], -down.extent[0]
    streets = across.recurring is not None, down.recurring is not None
    if expected_px is not None:
        pitch_x, pitch_y = _expected(across, expected_px[0]), _expected(down, expected_px[1])
        return Periods(pitch_x, pitch_y, math.radians(angle_deg), across.extent, up, streets)
    pitch_x, pitch_y = period_of(across, "x"), period_of(down, "y")
    if pitch_x is None and pitch_y is None:
        raise DiesNotFound(
            f"No dies are found, because nothing repeats along x or y: scan at least two dies, or {MEND}."
        )
    if abs(angle_deg) > GRADIENTS.limit_deg:
        raise turned_too_far(angle_deg)
    if pitch_x is None and pitch_y is not None:
        _require_shape(pitch_y, across.extent, "x")
    if pitch_y is None and pitch_x is not None:
        _require_shape(pitch_x, up, "y")
    return Periods(pitch_x, pitch_y, math.radians(angle_deg), across.extent, up, streets)


# ----------------------------------------------------------------------------------------------------------- similarity


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """Similarity of columns by lag in px, within the extent of the pattern, px from the centre.

    unbroken: longest run of similar columns, relative to the extent; correlation: of all columns together.
    recurring: fraction of the columns without edges across them, as in a street, that recur one lag further; None where
    the extent has no such column.
    """

    extent: tuple[float, float]
    unbroken: Floats
    correlation: Floats
    recurring: Floats | None


def similarity(seen: Sequence[Gradients], active: Bools) -> Similarity:
    """Return the similarity of the columns of a pattern whose rotation is removed."""
    from scipy.ndimage import uniform_filter1d

    parts = _segments(seen, active)
    n = active.shape[1]
    energies = [part.energy for part in parts]
    energy = np.asarray(uniform_filter1d(np.diag(np.sum(energies, axis=0)), 3))
    on = np.flatnonzero(energy > PERIODICITY.energy * float(np.percentile(energy, 90)))
    first, last = (int(on[0]), int(on[-1])) if on.size else (0, 0)
    floors = [max(PERIODICITY.energy * float(np.percentile(np.diag(p.energy), 90)), p.scatter) for p in parts]
    crossings = _crossings(seen, active, first, last)
    street = _streets(crossings)
    rich = float(np.percentile(energy, 90))
    scatter = sum(part.scatter for part in parts) / 2
    unbroken, correlation, recurring = np.zeros(n), np.zeros(n), np.zeros(n)
    lags = range(PERIODICITY.shortest_px, math.floor(PERIODICITY.longest * (last - first)))
    products = [
        np.array([_diagonal(part.product, lag, first, last) for part in parts])
        for lag in range(lags.start - 1, lags.stop + 1)
    ]
    for n_before, lag in enumerate(lags):
        before, alike, after = products[n_before : n_before + 3]
        total = np.array([_diagonal(part.energy, lag, first, last) for part in parts])
        rich_enough = total.sum(axis=0) > PERIODICITY.energy * rich
        unbroken[lag] = _longest_run(_dissimilar(_within_a_pixel(alike, before, after), total, floors) & rich_enough)
        correlation[lag] = _positive(alike) / max(_positive(total), scatter * total.shape[1], 1e-9)
        recurring[lag] = _recurring(street, crossings, lag)
    middle = (n - 1) / 2
    ends = first - 0.5 - middle, last + 0.5 - middle
    return Similarity(ends, unbroken, correlation, recurring if street.any() else None)


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Products and energies, [col, col] each, of all pairs of columns, over some rows, and the scatter due to noise.

    An energy is the mean of both columns where both are known, less the noise.
    """

    product: Floats
    energy: Floats
    scatter: float


def _segments(seen: Sequence[Gradients], active: Bools) -> list[Segment]:
    """Return the products of the columns over bands of rows; of a layer, what repeats nowhere is no energy."""
    layers = [list(_segments_of(one, active)) for one in seen]
    return [_joined(parts, list(map(_repeating, layers))) for parts in zip(*layers, strict=True)]


def _segments_of(one: Gradients, active: Bools) -> Iterator[Segment]:
    for rows in np.array_split(np.arange(active.shape[0]), PERIODICITY.segments):
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        known = np.concatenate([(one.known & active)[part]] * 2).astype(np.float32)
        values = np.concatenate([one.right[part], one.down[part]]) * known
        energy = ((values * values - np.float32(one.noise)) * known).T @ known
        scatter = PERIODICITY.scatters * math.sqrt(2 * rows.size) * one.noise
        yield Segment(np.asarray(values.T @ values), np.asarray((energy + energy.T) / 2), scatter)


def _repeating(parts: Sequence[Segment]) -> float:
    """Return the share of a layer's energy that is alike at the best of all lags, `PERIODICITY.repeating` at least.

    Edges of what is measured differ from die to die: they are strong, and no noise of a pixel.
    """
    product, energy = np.sum([part.product for part in parts], axis=0), np.sum([part.energy for part in parts], axis=0)
    lags = range(PERIODICITY.shortest_px, math.floor(PERIODICITY.longest * len(product)))
    shares = [_positive(np.diag(product, lag)[None]) / max(_positive(np.diag(energy, lag)[None]), 1e-9) for lag in lags]
    return float(np.clip(max(shares, default=1.0), PERIODICITY.repeating, 1.0))


def _joined(parts: Sequence[Segment], shares: Sequence[float]) -> Segment:
    """Return the sums over layers, of whose energies the given shares count."""
    energies = [share * part.energy for share, part in zip(shares, parts, strict=True)]
    return Segment(
        np.sum([part.product for part in parts], axis=0),
        np.sum(energies, axis=0),
        math.hypot(*(part.scatter for part in parts)),
    )


def _crossings(seen: Sequence[Gradients], active: Bools, first: int, last: int) -> Floats:
    """Return the energy of the edges across each column within the extent, relative to the lower quartile."""
    total = sum((np.where(one.known & active, one.down**2 - one.noise, 0).sum(axis=0) for one in seen), np.zeros(1))
    inside = np.asarray(total[first : last + 1], np.float64)
    return inside / max(float(np.percentile(inside, 25)), 1e-9)


def _streets(crossings: Floats) -> Bools:
    """Return the columns that no edge crosses, as in a street, without those at the ends of the extent."""
    from skimage.measure import label

    low = crossings < PERIODICITY.gap
    bands: Any = label(low)
    ends = {int(band) for band in (*bands[: PERIODICITY.end_px], *bands[-PERIODICITY.end_px :])}
    return low & ~np.isin(bands, list(ends))


def _widest(street: Bools) -> int:
    """Return the length of the longest run of True."""
    ends = np.flatnonzero(np.concatenate([[True], ~street, [True]]))
    return int((np.diff(ends) - 1).max())


def _recurring(street: Bools, crossings: Floats, lag: int) -> float:
    """Return the fraction of streets with another place that hardly any edge crosses at a lag, to a pixel."""
    from scipy.ndimage import minimum_filter1d

    calm = np.asarray(minimum_filter1d(crossings, 3)) < PERIODICITY.calm
    before, after = street[:-lag], street[lag:]
    n = int(before.sum() + after.sum())
    if lag <= 2 * _widest(street):
        return 0.0
    return float((before & calm[lag:]).sum() + (after & calm[:-lag]).sum()) / n if n else 0.0


def _diagonal(plane: Floats, lag: int, first: int, last: int) -> Floats:
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(np.diag(plane, lag), 3), np.float64)[first : last - lag + 1]


def _within_a_pixel(alike: Floats, *nearby: Floats) -> Floats:
    """Return the largest products [segment, col] at a lag and next to it: a pitch is no whole number of pixels."""
    best = alike.copy()
    for near in nearby:
        part = best[:, : near.shape[1]]
        np.maximum(part, PERIODICITY.nearly * near[:, : part.shape[1]], out=part)
    return best


def _dissimilar(alike: Floats, total: Floats, floors: Sequence[float]) -> Bools:
    """Return which columns differ as a whole, and in most of their segments, from those one lag further."""
    judged = total > np.array(floors)[:, None]
    other = judged & (alike < PERIODICITY.similar * total)
    n_judged, n_other = judged.sum(axis=0), other.sum(axis=0)
    most = (n_other > 0) & (n_other >= PERIODICITY.majority * n_judged)
    return most & (alike.sum(axis=0) < PERIODICITY.similar * total.sum(axis=0))


def _positive(by_segment: Floats) -> float:
    return float(np.clip(by_segment.sum(axis=0), 0, None).sum())


def _longest_run(broken: Bools) -> float:
    """Return the longest run of False relative to the length."""
    ends = np.flatnonzero(np.concatenate([[True], broken, [True]]))
    return float((np.diff(ends) - 1).max()) / len(broken)


def period_of(found: Similarity, axis: str) -> float | None:
    """Return the period in px, the shortest lag at which all columns are similar; None where there is none.

    Raises DiesNotFound where it is doubtful.
    """
    maxima = _maxima(found)
    lags = _clear(found, maxima)
    if not lags:
        lags = _by_streets(found, maxima) if found.recurring is not None else _without_streets(found, maxima)
    if not lags and _single(found, maxima):
        return None
    if not lags:
        raise _doubtful(axis)
    near = [lag for lag in lags if lag < PERIODICITY.apart * min(lags)]
    lag = max(near, key=lambda one: _whole(found, one) + _top(found, one))
    streets = found.recurring is not None
    better = max(
        (_top(found, one) - _top(found, lag) for one in lags if not streets or _multiple(one, lag)), default=0.0
    )
    if better > (PERIODICITY.better if streets else PERIODICITY.better / 3):
        raise _doubtful(axis)
    shorter = max((_top(found, one) for one in maxima if one < lag - PERIODICITY.shortest_px), default=0.0)
    if not streets and shorter > PERIODICITY.as_similar * _top(found, lag):
        raise _doubtful(axis)
    return _over_multiples(found, maxima, lag)


def _expected(found: Similarity, pitch_px: float) -> float:
    """Return the period next to a known pitch; the pitch itself where no lag next to it stands out."""
    reach = max(PERIODICITY.off_px, PERIODICITY.expected_within * pitch_px)
    maxima = _maxima(found)
    near = [lag for lag in maxima if abs(lag - pitch_px) <= reach]
    return _over_multiples(found, maxima, max(near, key=lambda lag: _top(found, lag))) if near else pitch_px


def _over_multiples(found: Similarity, maxima: Sequence[int], lag: int) -> float:
    """Return the period to subpixels, from the farthest of its successive multiples that correlate."""
    period, times = lag + vertex(*found.correlation[lag - 1 : lag + 2].tolist()), 2
    while True:
        near = [one for one in maxima if abs(one - times * period) <= PERIODICITY.off_px]
        if not near or _top(found, near[0]) < _top(found, lag) / 2:
            return period
        period = (near[0] + vertex(*found.correlation[near[0] - 1 : near[0] + 2].tolist())) / times
        times += 1


def _multiple(longer: int, lag: int) -> bool:
    return any(abs(longer - times * lag) <= times for times in (2, 3))


def _clear(found: Similarity, maxima: Sequence[int]) -> list[int]:
    """Return the lags from the first one on at which the columns are similar and at shorter ones they are not."""
    limit, most = PERIODICITY, PERIODICITY.few * (found.extent[1] - found.extent[0])
    if found.recurring is None:
        limit = dataclasses.replace(limit, unbroken=limit.without_streets)
    for lag in (lag for lag in maxima if _whole(found, lag) >= limit.unbroken):
        shorter = max((_whole(found, one) for one in maxima if one < lag - limit.shortest_px), default=1.0)
        if _whole(found, lag) < limit.clearer * shorter or lag > most:
            return []
        return [one for one in maxima if one >= lag and _whole(found, one) >= limit.unbroken]
    return []


def _by_streets(found: Similarity, maxima: Sequence[int]) -> list[int]:
    """Return the lags at which streets recur and the columns between them are similar."""
    recurring = found.recurring if found.recurring is not None else np.zeros(1)
    lags: list[int] = []
    for lag in maxima:
        unbroken = _whole(found, lag)
        shorter = max((_whole(found, one) for one in maxima if one < lag - PERIODICITY.shortest_px), default=1.0)
        clear = unbroken >= max(PERIODICITY.partly, PERIODICITY.clearer * shorter)
        recurs = float(recurring[lag - 1 : lag + 2].max()) >= PERIODICITY.recurs
        if recurs and (unbroken >= PERIODICITY.unbroken or (clear and not lags)):
            lags.append(lag)
    return lags


def _without_streets(found: Similarity, maxima: Sequence[int]) -> list[int]:
    """Return the lags at which all columns up to both ends are similar; pads and lines end before their die does."""
    sure = [lag for lag in maxima if _whole(found, lag) >= PERIODICITY.without_streets]
    if not sure or min(sure) < PERIODICITY.fine * (found.extent[1] - found.extent[0]):
        return []
    possible = [lag for lag in maxima if _whole(found, lag) >= PERIODICITY.unbroken]
    return [] if min(possible) < min(sure) - PERIODICITY.shortest_px else sure


def _single(found: Similarity, maxima: Sequence[int]) -> bool:
    """Return whether the pattern is that of one die: what repeats in it is fine, and does not reach both ends."""
    fine = PERIODICITY.fine * (found.extent[1] - found.extent[0])
    if any(_whole(found, lag) >= PERIODICITY.without_streets for lag in maxima):
        return False
    most = PERIODICITY.doubtful if found.recurring is None else PERIODICITY.unbroken
    return all(_whole(found, lag) < most for lag in maxima if lag > fine)


def _require_shape(pitch_px: float, extent_px: tuple[float, float], axis: str) -> None:
    """Raise DiesNotFound where the only die along an axis would be too long or too short for a die."""
    length_px = extent_px[1] - extent_px[0]
    if not 1 / PERIODICITY.longest_die < length_px / pitch_px < PERIODICITY.longest_die:
        raise _doubtful(axis)


def _doubtful(axis: str) -> DiesNotFound:
    return DiesNotFound(
        f"The pitch along {axis} is ambiguous, because what repeats may be dies or a pattern within a die: {MEND}."
    )


def _maxima(found: Similarity) -> list[int]:
    """Return the lags at local maxima of the correlation."""
    values = found.correlation
    inner = (values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])
    inner &= values[1:-1] > PERIODICITY.least_correlation
    return (np.flatnonzero(inner) + 1).tolist()


def _whole(found: Similarity, lag: int) -> float:
    return float(found.unbroken[lag - 1 : lag + 2].max())


def _top(found: Similarity, lag: int) -> float:
    """Return the correlation at the vertex of a maximum."""
    before, middle, after = found.correlation[lag - 1 : lag + 2].tolist()
    return middle + (after - before) * vertex(before, middle, after) / 4
