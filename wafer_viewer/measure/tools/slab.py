"""Slab section of a surface: every measured point between two planes, and their running median."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, Layer, height_window, layer_of
from wafer_viewer.measure.tools.profile import length_um_of, numbers_of, samples_along
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.sections import SlabPoints
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Heights, Mosaic, pixel_window

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
    surface
        Any surface; only a band along the line is read.
    line
        Middle of the slab; its width_um is the width of the slab, and 0 is one pixel.
    calibration_valid
        Whether a calibration holds for the surface.
    layer
        Heights to take, as the recipe of the surface says when left out.

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
    length_um = length_um_of(line)
    level = _level_for(surface, line, length_um)
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
    distance_um, z_um
        Points in um, in any order; none is NaN.
    length_um
        Length of the line; the places run from 0 to it.
    n
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


def _level_for(surface: Mosaic, line: Region, length_um: float) -> int:
    pixels = length_um * max(line.width_um, surface.pixel_um) / surface.pixel_um**2
    return min(surface.levels - 1, max(0, math.ceil(math.log(max(pixels, 1) / MAX_POINTS, 4))))
