"""Levelled surfaces: heights relative to a fitted plane or form, and the fit of that datum."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from wafer_viewer.measure.base.height_samples import (
    Floats,
    HeightSamples,
    Layer,
    height_window,
    heights,
    layer_of,
    level_for,
    points_in,
    require_area,
)
from wafer_viewer.measure.base.robust_fit import Fit, robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Datum, LevelBy, Levelling
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import HeightMap, Heights, Mosaic, ReadThrough

FITTED_PIXELS = 1_000_000
"""Approximate upper limit of the pixels used for a plane or form fitted to the entire surface."""
ROUND_POINT_PX = 5
"""Radius, in pixels, over which the median height of each of three levelling points is taken."""
Powers = tuple[tuple[int, int], ...]
FLAT: Powers = ((1, 0), (0, 1), (0, 0))
"""Exponents of x and y of a plane."""


class Levelled(ReadThrough):
    """A surface with heights relative to a datum; each window is levelled when it is read."""

    def __init__(self, surface: Mosaic, datum: Datum, levelling: Levelling = Levelling()) -> None:
        self.surface, self.datum, self.levelling = surface, datum, levelling

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that contains a region, with heights over the datum.

        Raises the same errors as the underlying surface.
        """
        part = self.surface.window(region, level)
        if not self.datum.powers:
            return part
        zero = self.datum.at(part.x_um[None, :], part.y_um[:, None])
        z_um, z_raw_um = ((z - zero).astype(np.float32) for z in (part.z_um, part.z_raw_um))
        return dataclasses.replace(part, z_um=z_um, z_raw_um=z_raw_um)

    def one_layer(self, layer: Layer, region: Region, level: int = 0) -> Heights:
        """Return one height layer of what `window` returns; raises the same errors as the underlying surface."""
        part = height_window(self.surface, layer, region, level)
        zero = self.datum.at(part.x_um[None, :], part.y_um[:, None])
        return dataclasses.replace(part, z_um=(part.z_um - zero).astype(np.float32))


def levelled(surface: Mosaic, levelling: Levelling, layer: Layer | None = None) -> Mosaic:
    """Return a surface with heights relative to another zero.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to level.
    levelling : Levelling
        Method ('stage', 'three points', 'plane', 'region' or 'form'), with its regions in stage um and the order of the
        form.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer to which the datum is fitted. Default None: the layer on which the recipe of the surface measures.

    Returns
    -------
    Mosaic
        The surface with its heights over the datum, in um; `surface` itself when levelled by the stage.

    Raises
    ------
    MeasureError
        If a region of the levelling lies outside the surface, is unmeasured or, for 'region', is a line or a point.
    MeasureError
        If the measured points do not determine the fit.

    Notes
    -----
    The datum is fitted when the function is called, with rejection of outliers beyond 3 robust deviations. A plane or
    form of the entire surface is fitted at the finest level with at most a million pixels. Each window is levelled when
    it is read.
    """
    return surface if levelling.by == "stage" else Levelled(surface, datum(surface, levelling, layer), levelling)


def levelling_of(surface: Mosaic) -> Levelling:
    """Return the levelling of a surface."""
    return surface.levelling if isinstance(surface, Levelled) else Levelling()


def datum(surface: Mosaic, levelling: Levelling, layer: Layer | None = None) -> Datum:
    """Return the zero surface of a levelling, fitted with rejection of outliers beyond 3 robust deviations.

    A plane or form of the entire surface is fitted at the finest level with at most a million pixels. Raises
    MeasureError where a place lies outside or is unmeasured, or the points do not determine the fit.
    """
    return DATUMS[levelling.by](surface, levelling, layer_of(surface.provenance.recipe, layer))


def _stage(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    return Datum()


def _three_points(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    spots = [_round_point(surface, place, layer) for place in levelling.places]
    points = HeightSamples(*(np.array(column) for column in zip(*spots, strict=True)))
    return _fitted(points, FLAT)


def _plane(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    return _fitted(_whole(surface, layer), FLAT)


def _region(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    (region,) = levelling.places
    require_area(region, "levelling")
    return _fitted(points_in(surface, region, layer, level_for(surface, region)), FLAT)


def _form(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    return _fitted(_whole(surface, layer), _powers(levelling.order))


DATUMS: dict[LevelBy, Callable[[Mosaic, Levelling, Layer], Datum]] = {
    "stage": _stage,
    "three points": _three_points,
    "plane": _plane,
    "region": _region,
    "form": _form,
}
"""Datum functions by levelling method."""


def _powers(order: int) -> Powers:
    return tuple((i, total - i) for total in range(order, -1, -1) for i in range(total, -1, -1))


def _round_point(surface: Mosaic, place: Region, layer: Layer) -> tuple[float, float, float]:
    """Return x, y and the median of the heights measured around a point."""
    point = place.points[0]
    disc = Region.circle(point.x_um, point.y_um, ROUND_POINT_PX * surface.pixel_um)
    near = points_in(surface, disc, layer, 0)
    if not len(near):
        raise MeasureError(
            f"Nothing was measured round ({point.x_um:.1f}, {point.y_um:.1f}) um: "
            "put the point for levelling where the surface has no holes."
        )
    return float(near.x_um.mean()), float(near.y_um.mean()), float(np.median(near.z_um))


def _whole(surface: Mosaic, layer: Layer) -> HeightSamples:
    """Return the measured points of the entire surface, thinned to about FITTED_PIXELS lattice points."""
    pixels = surface.shape[0] * surface.shape[1]
    level = min(surface.levels - 1, max(0, math.ceil(math.log(pixels / FITTED_PIXELS, 4))))
    part = surface.window(None, level)
    step = max(1, math.ceil(math.sqrt(part.shape[0] * part.shape[1] / FITTED_PIXELS)))
    z_um, x_um, y_um = heights(part, layer)[::step, ::step], part.x_um[::step], part.y_um[::step]
    rows, cols = np.nonzero(np.isfinite(z_um))
    return HeightSamples(x_um[cols], y_um[rows], z_um[rows, cols].astype(np.float64))


def _fitted(points: HeightSamples, powers: Powers) -> Datum:
    if not len(points):
        raise MeasureError("Nothing was measured where the surface is to be levelled: choose another place or way.")
    center = float(points.x_um.mean()), float(points.y_um.mean())
    u, v = points.x_um - center[0], points.y_um - center[1]
    design: Floats = np.stack([u**i * v**j for i, j in powers], axis=1)
    fit: Fit = robust_fit(design, points.z_um)
    return Datum(
        center=Point(x_um=center[0], y_um=center[1]), powers=powers, coefficients=tuple(fit.coefficients.tolist())
    )
