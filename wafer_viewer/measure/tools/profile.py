"""Profile of a surface along a line: sampled every pixel, averaged across the line, from measured pixels only."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wafer_viewer.measure.base.height_samples import (
    Floats,
    Layer,
    height_window,
    layer_of,
    length_without_budget,
    level_note,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Heights, Mosaic, pixel_window

MAX_SAMPLES = 8192
"""Largest number of samples; longer lines are read at a coarser pyramid level."""
_PIECE = 512
"""Samples per read, so that a slanted line never reads its complete bounding rectangle."""
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
    """Return the profile along a line and its numbers.

    The profile has one sample per pixel, from measured pixels only, averaged over the `width_um` of the line.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    line : Region
        Line, in stage um; its `width_um` is the width of averaging across it, 0 for none.
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
        Pt (peak to valley) and the rise from the first to the last measured sample, in um. Their uncertainty is not
        evaluated.
    ProfileCurve
        Distance along the line, height, and stage x and y of each sample: float64 [n], in um; heights are NaN where the
        surface is unmeasured.

    Raises
    ------
    MeasureError
        If the region is no line, has no length, or lies outside the surface.
    MeasureError
        If fewer than two samples along the line were measured.

    Notes
    -----
    Heights are interpolated bilinearly between measured pixels. A sample is measured where at least half of the weight
    of its pixels is measured. Pt is a parameter of ISO 21920-2 [1]_.

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
    z_um = curve.z_um[finite]
    return Profile(
        name=name,
        surface=measured_on,
        filter=about,
        simulated=surface.provenance.simulated,
        notes=level_note(surface, level),
        line=line,
        length_um=length_um_of(line),
        pt=length_without_budget(float(z_um.max() - z_um.min()), surface.provenance, calibration_valid),
        rise=length_without_budget(float(z_um[-1] - z_um[0]), surface.provenance, calibration_valid),
        measured_fraction=len(finite) / len(curve.z_um),
    )


def sampled(surface: Mosaic, line: Region, layer: Layer, level: int) -> ProfileCurve:
    """Return points along a line, one per pixel of a level; NaN where unmeasured or outside the surface."""
    pixel_um = surface.pixel_um * 2**level
    curve = samples_along(line, pixel_um)
    x_all, y_all = places_across(line, curve.x_um, curve.y_um, pixel_um)
    pieces = [_mean_across(surface, x_all[part], y_all[part], layer, level) for part in _pieces(len(curve.x_um))]
    return replace(curve, z_um=np.concatenate(pieces))


def places_across(line: Region, x_um: Floats, y_um: Floats, pixel_um: float) -> tuple[Floats, Floats]:
    """Return the places [sample, across] over which samples of a line at x, y [sample] are averaged."""
    (xa, ya), (xb, yb), length_um = *((p.x_um, p.y_um) for p in line.points), length_um_of(line)
    across = _offsets_um(line.width_um, pixel_um)
    return x_um[:, None] - across * (yb - ya) / length_um, y_um[:, None] + across * (xb - xa) / length_um


def samples_along(line: Region, pixel_um: float) -> ProfileCurve:
    """Return sample places along a line, about a pixel apart, with heights NaN."""
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in line.points)
    length_um = length_um_of(line)
    # A line between pixel centres contains exactly these pixels, whatever the rounding of its length.
    share = np.linspace(0.0, 1.0, max(2, math.ceil(length_um / pixel_um - 1e-9) + 1))
    x_um, y_um = xa + share * (xb - xa), ya + share * (yb - ya)
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
    """Return the length of a line in um. Raises MeasureError for another region, and for zero length."""
    if line.kind != "line":
        raise MeasureError(f"A profile needs a line, this region is a {line.kind}: draw a line.")
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in line.points)
    if (length := math.hypot(xb - xa, yb - ya)) == 0:
        raise MeasureError(f"The line begins and ends at ({xa:.1f}, {ya:.1f}) um: draw it longer.")
    return length


def _level_for(surface: Mosaic, length_um: float) -> int:
    samples = length_um / surface.pixel_um
    return min(surface.levels - 1, max(0, math.ceil(math.log2(samples / MAX_SAMPLES)))) if samples > 0 else 0


def _offsets_um(width_um: float, pixel_um: float) -> Floats:
    """Return offsets across a line of a width, about a pixel apart, symmetric about it."""
    n = max(1, round(width_um / pixel_um))
    return (np.arange(n) - (n - 1) / 2) * width_um / n


def _pieces(n: int) -> Iterator[slice]:
    return (slice(start, min(start + _PIECE, n)) for start in range(0, n, _PIECE))
