"""Profile of a surface along a path, of measured points only; and slab sections, of every point between two planes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import WeightedHeights, errors_round
from wafer_viewer.measure.base.height_samples import Floats, Layer, height_window, layer_of
from wafer_viewer.measure.base.measurement_context import Z_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import noise_um, pixel_noise_um
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.sections import SlabPoints
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Heights, Mosaic, pixel_window

# -------------------------------------------------------------------------------------------------------------- profile


MAX_SAMPLES = 8192
"""Largest number of samples; longer lines are read at a coarser pyramid level."""
_PIECE = 512
"""Samples per read, so that a slanted line never reads its complete bounding rectangle."""
SELECTION = "selection of the highest and the lowest point"
NOISE = "noise and form round the points"
EXTREMES = ("Pt: noise draws the highest and the lowest point apart. A false height among them is not in its budget.",)
_DRAWS = 64
"""Number of draws of noise by which the growth of a range is estimated."""
MIN_WEIGHT = 0.5
"""Smallest measured fraction of the pixels that contribute to a measured sample."""


def profile(
    surface: Mosaic,
    line: Region,
    *,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    level: int | None = None,
    name: str = "",
) -> tuple[Profile, ProfileCurve]:
    """Return the profile along a line or a polyline and its numbers.

    The profile has one sample per pixel, from measured pixels only, averaged over the `width_um` of the line.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    line : Region
        Line or polyline, in stage um; its `width_um` is the width of averaging across it, 0 for none.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    level : int, optional
        Pyramid level to read. Default None: the finest level with at most 8192 samples.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Profile
        Pt (peak to valley) and the rise from the first to the last measured sample, in um, with expanded uncertainties
        (k = 2). These are not evaluated where fewer than 100 points are measured round one of the samples.
    ProfileCurve
        Distance along the line (the arc length of a polyline), height, and stage x and y of each sample: float64 [n],
        in um; heights are NaN where the surface is unmeasured.

    Raises
    ------
    MeasureError
        If the region is no line, has no length, or lies outside the surface.
    MeasureError
        If fewer than two samples along the line were measured.

    Notes
    -----
    Heights are interpolated bilinearly between measured pixels. A sample is measured where at least half of the weight
    of its pixels is measured. Across a polyline, heights are averaged at right angles to the path between the two
    neighbours of a sample, so the width turns at corners. A curve is a polyline of many points: points a distance d
    apart on a radius R shorten it by the fraction d**2 / (24 R**2). Pt is a parameter of ISO 21920-2 [1]_.

    References
    ----------
    .. [1] ISO 21920-2, Surface texture: Profile - Part 2: Terms, definitions and surface texture parameters.
    """
    length_um = length_um_of(line)
    at_level = _level_for(surface, length_um) if level is None else level
    pixel_window(surface, line, at_level)
    measured_on = layer_of(surface.provenance.recipe, layer)
    curve = sampled(surface, line, measured_on, at_level)
    about = f"mean over {line.width_um:g} um across the line" if line.width_um else "none"
    return numbers_of(surface, line, curve, measured_on, at_level, about, calibration_valid, name), curve


def section(surface: Mosaic, line: Region, *, calibration_valid: bool = True) -> Profile:
    """Return the profile along a line without its curve."""
    return profile(surface, line, calibration_valid=calibration_valid)[0]


def numbers_of(
    surface: Mosaic,
    line: Region,
    curve: ProfileCurve,
    measured_on: Layer,
    level: int,
    about: str,
    calibration_valid: bool = True,
    name: str = "",
) -> Profile:
    """Return the numbers of a curve along a line; `about` describes its filter.

    Raises
    ------
    MeasureError
        If fewer than two of its points were measured.
    """
    finite = np.flatnonzero(np.isfinite(curve.z_um))
    if len(finite) < 2:
        raise MeasureError("No heights were measured along the line: draw it where the surface has no holes.")
    reading = MeasurementContext.of(surface, measured_on, calibration_valid)
    z_um, noise = curve.z_um[finite], _SampleNoise(reading, line, curve, level)
    lowest, highest = (int(finite[end(z_um)]) for end in (np.argmin, np.argmax))
    first, last = int(finite[0]), int(finite[-1])
    pt_um, rise_um = float(curve.z_um[highest] - curve.z_um[lowest]), float(curve.z_um[last] - curve.z_um[first])
    fields: dict[str, Any] = {**reading.result_fields(name, level, *reading.not_in_budget(*EXTREMES)), "filter": about}
    return Profile(
        **fields,
        line=line,
        length_um=length_um_of(line),
        pt=reading.length(pt_um, noise.between(lowest, highest, pt_um, selected_from=z_um)),
        rise=reading.length(rise_um, noise.between(first, last, rise_um)),
        measured_fraction=len(finite) / len(curve.z_um),
    )


@dataclass(frozen=True, slots=True)
class _SampleNoise:
    """Noise of the samples of a curve, found round them where it is asked for."""

    reading: MeasurementContext
    line: Region
    curve: ProfileCurve
    level: int

    def between(self, one: int, other: int, difference_um: float, selected_from: Floats | None = None) -> Lines | None:
        """Return the budget of a difference of two samples; None where there is none.

        selected_from: heights of all measured samples, where the two are the lowest and the highest of them.
        """
        if not self.reading.calibrated:
            return None
        found = [self._of(sample) for sample in (one, other)]
        noise_um = [each for each in found if each is not None]
        if len(noise_um) < len(found):
            return None
        lines: dict[str, float | Scatter] = {
            Z_SCALE: self.reading.u_z_scale * abs(difference_um),
            NOISE: Scatter.joined(*noise_um),
            **self.reading.frame_lines(),
        }
        if selected_from is not None:
            single_um = math.hypot(*(each.u for each in noise_um)) / math.sqrt(2)
            lines[SELECTION] = growth_um(selected_from, single_um, self._alike_samples)
        return lines

    def _of(self, sample: int) -> Scatter | None:
        x_um, y_um = self.curve.x_um, self.curve.y_um
        errors = errors_round(self.reading, float(x_um[sample]), float(y_um[sample]))
        if errors is None:
            return None
        surface = self.reading.surface
        x_all, y_all = places_across(self.line, x_um, y_um, surface.pixel_um * 2**self.level)
        heights = _interpolated(surface, x_all[sample], y_all[sample])
        return noise_um(errors.scatter(heights), pixel_noise_um(self.reading, heights))

    @property
    def _alike_samples(self) -> int:
        """Number of neighbouring samples within a focus window; 1 where it is not known."""
        window = self.reading.surface.provenance.recipe.window
        return 1 if isinstance(window, str) else max(1, round(window / 2**self.level))


def _interpolated(surface: Mosaic, x_um: Floats, y_um: Floats) -> WeightedHeights:
    """Return the mean of heights at places [n], each interpolated between the four pixels round it, as their sum."""
    col, row = (x_um - surface.x0_um) / surface.pixel_um, (surface.y0_um - y_um) / surface.pixel_um
    left, top = np.floor(col), np.floor(row)
    corners = [
        (left + right, top + down, np.abs(1 - right - (col - left)) * np.abs(1 - down - (row - top)))
        for right, down in itertools.product((0, 1), repeat=2)
    ]
    cols, rows, weight = (np.concatenate(each) for each in zip(*corners, strict=True))
    return WeightedHeights(
        surface.x0_um + cols * surface.pixel_um, surface.y0_um - rows * surface.pixel_um, weight / len(x_um)
    )


def growth_um(z_um: Floats, noise_um: float, alike: int) -> float:
    """Return by how much the range of heights along a line grows by their noise, on average.

    Parameters
    ----------
    z_um : ndarray [sample]
        Heights with their noise, um. Their scatter is reduced by that of the noise before noise is added anew.
    noise_um : float
        Standard deviation of the noise, um.
    alike : int
        Number of neighbouring samples whose noise is alike, by two passes of a mean.

    Returns
    -------
    float
        Mean growth of highest minus lowest, um, not below 0.
    """
    from scipy.ndimage import uniform_filter1d

    variance_um2 = float(np.var(z_um))
    share = math.sqrt(max(0.0, 1 - noise_um**2 / variance_um2)) if variance_um2 > 0 else 0.0
    quiet_um = share * (z_um - z_um.mean())
    errors = np.random.default_rng(0).standard_normal((_DRAWS, len(z_um) + 2 * alike))
    for _ in range(2):
        errors = uniform_filter1d(errors, alike, axis=1)
    errors = errors[:, alike : alike + len(z_um)]
    errors *= noise_um / float(np.sqrt(np.mean(errors**2)))
    return max(0.0, float(np.mean(np.ptp(quiet_um + errors, axis=1))) - float(np.ptp(quiet_um)))


def sampled(surface: Mosaic, line: Region, layer: Layer, level: int) -> ProfileCurve:
    """Return points along a line, one per pixel of a level; NaN where unmeasured or outside the surface."""
    pixel_um = surface.pixel_um * 2**level
    curve = samples_along(line, pixel_um)
    x_all, y_all = places_across(line, curve.x_um, curve.y_um, pixel_um)
    pieces = [_mean_across(surface, x_all[part], y_all[part], layer, level) for part in _pieces(len(curve.x_um))]
    return replace(curve, z_um=np.concatenate(pieces))


def places_across(line: Region, x_um: Floats, y_um: Floats, pixel_um: float) -> tuple[Floats, Floats]:
    """Return the places [sample, across] over which samples of a line at x, y [sample] are averaged."""
    across = _offsets_um(line.width_um, pixel_um)
    if line.kind == "polyline":
        dx, dy = np.gradient(x_um)[:, None], np.gradient(y_um)[:, None]
        length_um = np.maximum(np.hypot(dx, dy), 1e-9)
    else:
        (xa, ya), (xb, yb), length_um = *((p.x_um, p.y_um) for p in line.points), length_um_of(line)
        dx, dy = xb - xa, yb - ya
    return x_um[:, None] - across * dy / length_um, y_um[:, None] + across * dx / length_um


def samples_along(line: Region, pixel_um: float) -> ProfileCurve:
    """Return sample places along a line, about a pixel apart, with heights NaN."""
    length_um, places = length_um_of(line), np.array([(p.x_um, p.y_um) for p in line.points])
    # A line between pixel centres contains exactly these pixels, whatever the rounding of its length.
    share = np.linspace(0.0, 1.0, max(2, math.ceil(length_um / pixel_um - 1e-9) + 1))
    passed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    x_um, y_um = (np.interp(share, passed / passed[-1], along) for along in places.T)
    return ProfileCurve(distance_um=share * length_um, z_um=np.full(len(share), np.nan), x_um=x_um, y_um=y_um)


def _mean_across(surface: Mosaic, x_um: Floats, y_um: Floats, layer: Layer, level: int) -> Floats:
    """Return the mean height over the second axis of points [sample, across], where enough is measured."""
    pixel_um = surface.pixel_um * 2**level
    low, high = (x_um.min() - pixel_um, y_um.min() - pixel_um), (x_um.max() + pixel_um, y_um.max() + pixel_um)
    try:
        part = height_window(surface, layer, Region.rectangle(*map(float, (*low, *high))), level)
    except MeasureError:  # this piece lies outside, others do not
        return np.full(len(x_um), np.nan)
    total, weight = _bilinear(part, x_um, y_um)
    share = weight.mean(axis=1)
    return np.divide(total.sum(axis=1), weight.sum(axis=1), out=np.full(len(share), np.nan), where=share >= MIN_WEIGHT)


def _bilinear(part: Heights, x_um: Floats, y_um: Floats) -> tuple[Floats, Floats]:
    """Return weighted heights and weights of the measured pixels among the four around each point."""
    z_um = part.z_um
    row, col = (part.y0_um - y_um) / part.pixel_um, (x_um - part.x0_um) / part.pixel_um
    top, left = np.floor(row).astype(np.intp), np.floor(col).astype(np.intp)
    down, right = row - top, col - left
    total, weight = np.zeros(x_um.shape), np.zeros(x_um.shape)
    for r, row_weight in ((top, 1 - down), (top + 1, down)):
        for c, col_weight in ((left, 1 - right), (left + 1, right)):
            inside = (r >= 0) & (r < z_um.shape[0]) & (c >= 0) & (c < z_um.shape[1])
            z = z_um[np.where(inside, r, 0), np.where(inside, c, 0)]
            w = np.where(inside & np.isfinite(z), row_weight * col_weight, 0.0)
            total += w * np.nan_to_num(z)
            weight += w
    return total, weight


def length_um_of(line: Region) -> float:
    """Return the length of a line or polyline in um. Raises MeasureError for another region, and for zero length."""
    if not line.is_path:
        raise MeasureError(f"A profile needs a line, this region is a {line.kind}: draw a line.")
    places = [(p.x_um, p.y_um) for p in line.points]
    if (length := math.fsum(itertools.starmap(math.dist, itertools.pairwise(places)))) == 0:
        raise MeasureError("The line begins and ends at ({:.1f}, {:.1f}) um: draw it longer.".format(*places[0]))
    return length


def require_straight(line: Region) -> None:
    """Raise MeasureError for a path that is not a straight line."""
    if line.kind == "polyline":
        raise MeasureError("This needs a straight line, and the region is a polyline: only a profile follows one.")


def _level_for(surface: Mosaic, length_um: float) -> int:
    samples = length_um / surface.pixel_um
    return min(surface.levels - 1, max(0, math.ceil(math.log2(samples / MAX_SAMPLES)))) if samples > 0 else 0


def _offsets_um(width_um: float, pixel_um: float) -> Floats:
    """Return offsets across a line of a width, about a pixel apart, symmetric about it."""
    n = max(1, round(width_um / pixel_um))
    return (np.arange(n) - (n - 1) / 2) * width_um / n


def _pieces(n: int) -> Iterator[slice]:
    return (slice(start, min(start + _PIECE, n)) for start in range(0, n, _PIECE))


# ----------------------------------------------------------------------------------------------------------------- slab


MAX_POINTS = 1_000_000
"""Largest number of pixels of a slab; larger ones are read at a coarser level, whose pixels are means."""
MEDIAN_SAMPLES = 3
"""Window of the running median, in pixels along the line."""
SPREAD_PERCENT = 68.27
"""Percentage of points within the spread about the line: one standard deviation of a normal distribution."""
_LEAST_PIECE_PX = 256
"""Smallest length of the pieces along the line in which a slab is read, px; it is four widths of a wide slab."""


def slab_profile(
    surface: Mosaic, line: Region, *, calibration_valid: bool = True, layer: Layer | None = None
) -> tuple[Profile, ProfileCurve, SlabPoints]:
    """Return the section through the slab along a line.

    Parameters
    ----------
    surface : Mosaic
        Any surface; only a band along the line is read.
    line : Region
        Middle of the slab; its width_um is the width of the slab, and 0 is one pixel.
    calibration_valid : bool, default True
        Whether a calibration holds for the surface.
    layer : Layer, optional
        Heights to take. Default: as the recipe of the surface says.

    Returns
    -------
    Profile
        Numbers of the running median: Pt and rise in um.
    ProfileCurve
        The running median, one value a pixel along the line.
    SlabPoints
        Every measured point of the slab, in um along the line.

    Raises
    ------
    MeasureError
        When the region is no line, has no length, lies outside, or fewer than two pixels along it were measured.
    """
    require_straight(line)
    length_um = length_um_of(line)
    level = _slab_level(surface, line, length_um)
    pixel_window(surface, line, level)
    measured_on = layer_of(surface.provenance.recipe, layer)
    pixel_um = surface.pixel_um * 2**level
    width_um = max(line.width_um, pixel_um)
    distance_um, z_um = _points(surface, line, measured_on, level, width_um)
    places = samples_along(line, pixel_um)
    curve = replace(places, z_um=running_median(distance_um, z_um, length_um, len(places.z_um)))
    about = f"median over {width_um:g} um across the line"
    found = numbers_of(surface, line, curve, measured_on, level, about, calibration_valid)
    spread_um = _spread_um(distance_um, z_um, curve)
    points = SlabPoints(distance_um.astype(np.float32), z_um.astype(np.float32), width_um, spread_um)
    return found, curve, points


def running_median(distance_um: Floats, z_um: Floats, length_um: float, n: int) -> Floats:
    """Return the median height round each of `n` places along a line, over `MEDIAN_SAMPLES` of them.

    Parameters
    ----------
    distance_um, z_um : ndarray [point]
        Points in um, in any order; none is NaN.
    length_um : float
        Length of the line; the places run from 0 to it.
    n : int
        Number of places.

    Returns
    -------
    Floats
        Heights in um, [n]; NaN where no point is near.
    """
    own = _nearest(distance_um, length_um, n)
    reach = MEDIAN_SAMPLES // 2
    place = np.concatenate([own + k for k in range(-reach, reach + 1)])
    z = np.tile(z_um, MEDIAN_SAMPLES)
    order = np.lexsort((z, place))
    place, z = place[order], z[order]
    wanted = np.arange(n)
    first, end = np.searchsorted(place, wanted), np.searchsorted(place, wanted, side="right")
    occupied = first < end
    low, high = (
        first[occupied] + (end[occupied] - first[occupied] - 1) // 2,
        first[occupied] + (end[occupied] - first[occupied]) // 2,
    )
    out = np.full(n, np.nan)
    out[occupied] = (z[low] + z[high]) / 2
    return out


def _points(surface: Mosaic, line: Region, layer: Layer, level: int, width_um: float) -> tuple[Floats, Floats]:
    """Return distances along the line and heights of the measured points of a slab; read in pieces along the line."""
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in line.points)
    length_um, pixel_um = length_um_of(line), surface.pixel_um * 2**level
    ux, uy = (xb - xa) / length_um, (yb - ya) / length_um
    n_pieces = max(1, math.ceil(length_um / max(4 * width_um, _LEAST_PIECE_PX * pixel_um)))
    ends = np.linspace(0.0, length_um, n_pieces + 1)
    found: list[tuple[Floats, Floats]] = []
    for low, high in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        dx, dy = abs(uy) * width_um / 2, abs(ux) * width_um / 2
        xs, ys = (xa + low * ux, xa + high * ux), (ya + low * uy, ya + high * uy)
        box = Region.rectangle(min(xs) - dx, min(ys) - dy, max(xs) + dx, max(ys) + dy)
        try:
            part = height_window(surface, layer, box, level)
        except MeasureError:  # this piece lies outside, others do not
            continue
        along, z_um = _between(part, line, width_um)
        last = high == length_um
        inside = (along >= low) & ((along <= high) if last else (along < high))
        found.append((along[inside], z_um[inside]))
    if not found:
        return np.empty(0), np.empty(0)
    return np.concatenate([along for along, _ in found]), np.concatenate([z_um for _, z_um in found])


def _between(part: Heights, line: Region, width_um: float) -> tuple[Floats, Floats]:
    """Return distances along a line and heights of the measured points of a part that lie in the slab."""
    along, across = line.along_and_across_um(part.x_um[None, :], part.y_um[:, None])
    inside: NDArray[np.bool_] = (np.abs(across) <= width_um / 2) & np.isfinite(part.z_um)
    return along[inside], part.z_um[inside].astype(np.float64)


def _nearest(distance_um: Floats, length_um: float, n: int) -> NDArray[np.int64]:
    """Return the index of the nearest of `n` places from 0 to a length, for each distance."""
    return np.rint(distance_um / length_um * (n - 1)).astype(np.int64)


def _spread_um(distance_um: Floats, z_um: Floats, curve: ProfileCurve) -> float:
    """Return the `SPREAD_PERCENT` percentile of the distance of points from the line."""
    if not len(z_um):
        return 0.0
    place = _nearest(distance_um, float(curve.distance_um[-1]), len(curve.z_um))
    return float(np.nanpercentile(np.abs(z_um - curve.z_um[place]), SPREAD_PERCENT))


def _slab_level(surface: Mosaic, line: Region, length_um: float) -> int:
    pixels = length_um * max(line.width_um, surface.pixel_um) / surface.pixel_um**2
    return min(surface.levels - 1, max(0, math.ceil(math.log(max(pixels, 1) / MAX_POINTS, 4))))
