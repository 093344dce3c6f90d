"""A surface whose heights are read from a plane or form laid through itself, and how that is found."""

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
from wafer_viewer.measure.base.robust_plane import Fit, robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.levelling import Datum, LevelBy, Levelling
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import HeightMap, Heights, Mosaic, ReadThrough

FITTED_PIXELS = 1_000_000
"""A plane or form of the whole surface is fitted to about as many pixels at most."""
ROUND_POINT_PX = 5
"""One of three points is the median of the measured heights up to so many pixels away."""
Powers = tuple[tuple[int, int], ...]
FLAT: Powers = ((1, 0), (0, 1), (0, 0))


class Levelled(ReadThrough):
    """A surface whose heights are those over a datum; windows are levelled as they are read."""

    def __init__(self, surface: Mosaic, datum: Datum, levelling: Levelling = Levelling()) -> None:
        self.surface, self.datum, self.levelling = surface, datum, levelling

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part of a level that holds a region, its heights over the datum; raises as the surface itself does."""
        part = self.surface.window(region, level)
        if not self.datum.powers:
            return part
        zero = self.datum.at(part.x_um[None, :], part.y_um[:, None])
        z_um, z_raw_um = ((z - zero).astype(np.float32) for z in (part.z_um, part.z_raw_um))
        return dataclasses.replace(part, z_um=z_um, z_raw_um=z_raw_um)

    def one_layer(self, layer: Layer, region: Region, level: int = 0) -> Heights:
        """One layer of heights of what `window` returns; raises as the surface itself does."""
        part = height_window(self.surface, layer, region, level)
        zero = self.datum.at(part.x_um[None, :], part.y_um[:, None])
        return dataclasses.replace(part, z_um=(part.z_um - zero).astype(np.float32))


def levelled(surface: Mosaic, levelling: Levelling, layer: Layer | None = None) -> Mosaic:
    """A surface with its heights read from another zero; itself when levelled by the stage.

    Raises MeasureError as `datum` does.
    """
    return surface if levelling.by == "stage" else Levelled(surface, datum(surface, levelling, layer), levelling)


def levelling_of(surface: Mosaic) -> Levelling:
    """What the heights of a surface are read from."""
    return surface.levelling if isinstance(surface, Levelled) else Levelling()


def datum(surface: Mosaic, levelling: Levelling, layer: Layer | None = None) -> Datum:
    """The surface that counts as zero. Outliers do not disturb it: fits reject beyond 3 robust deviations.

    A plane or form of the whole is fitted at the finest level with at most a million pixels.
    Raises MeasureError where a place lies outside or unmeasured, or the points do not determine the fit.
    """
    return DATUMS[levelling.by](surface, levelling, layer_of(surface.provenance.recipe, layer))


def _stage(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    return Datum()


def _three_points(surface: Mosaic, levelling: Levelling, layer: Layer) -> Datum:
    at = [_round_point(surface, place, layer) for place in levelling.places]
    points = HeightSamples(*(np.array(column) for column in zip(*at, strict=True)))
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
"""How the zero is found, by the way of levelling."""


def _powers(order: int) -> Powers:
    return tuple((i, total - i) for total in range(order, -1, -1) for i in range(total, -1, -1))


def _round_point(surface: Mosaic, place: Region, layer: Layer) -> tuple[float, float, float]:
    """x, y and the median height of what is measured round a point."""
    at = place.points[0]
    disc = Region.circle(at.x_um, at.y_um, ROUND_POINT_PX * surface.pixel_um)
    near = points_in(surface, disc, layer, 0)
    if not len(near):
        raise MeasureError(
            f"Nothing was measured round ({at.x_um:.1f}, {at.y_um:.1f}) um: "
            "put the point for levelling where the surface has no holes."
        )
    return float(near.x_um.mean()), float(near.y_um.mean()), float(np.median(near.z_um))


def _whole(surface: Mosaic, layer: Layer) -> HeightSamples:
    """The measured points of the whole surface, thinned to about FITTED_PIXELS lattice points."""
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
