"""Cells of a die lattice: each die with half of the surrounding streets, resampled, and its offset and tilt.

Cell pixels have the surface's pixel size; row 0 is the upper edge. A cell has heights over the form of the wafer and
the logarithm of the all-in-focus image. Grain and uneven illumination are multiplicative, so that in the logarithm
their errors are the same in bright and dark areas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import HeightSamples, Layer, heights, pictured_window
from wafer_viewer.measure.base.robust_fit import robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Heights, Mosaic
from wafer_viewer.numerics.grids.die_cell_kernels import fill_single_pixels, read_affine, subtract_products

Plane = NDArray[np.float32]
Place = tuple[int, int]
Shift = tuple[float, float]
FORM_POINTS = 120_000
"""Approximate number of pixels to which the form of a surface is fitted."""
MARGIN_PX = 4
"""Margin read around a cell for its interpolation, px."""
REACH_PX = 4
"""Largest shift of a cell from its place, px."""
STRIP_PIXELS = 4_000_000
"""Largest number of pixels of a strip of adjacent cells, which is read at once; it bounds the memory."""
DARK_SHARE = 0.05
"""Fraction of the median grey added before the logarithm; darker values are camera noise."""

LEAST_FORM_POINTS = 100
"""Smallest number of measured pixels for a form."""


@dataclass(frozen=True, slots=True)
class CellGrid:
    """Geometry of cells: die lattice, cell shape in pixels, and street pixels above and left of the die."""

    grid: DieGrid
    pixel_um: float
    shape: tuple[int, int]
    street: tuple[int, int]

    @classmethod
    def of(cls, grid: DieGrid, pixel_um: float) -> CellGrid:
        """Return the cells of a die lattice."""
        rows, cols = round(grid.pitch_y_um / pixel_um), round(grid.pitch_x_um / pixel_um)
        return cls(grid, pixel_um, (rows, cols), (_half(grid.street_y_um, pixel_um), _half(grid.street_x_um, pixel_um)))

    @property
    def die(self) -> tuple[slice, slice]:
        """Rows and columns of the die in its cell, without the streets."""
        (top, left), grid = self.street, self.grid
        rows, cols = (round(n / self.pixel_um) for n in (grid.height_um, grid.width_um))
        return slice(top, min(top + rows, self.shape[0])), slice(left, min(left + cols, self.shape[1]))

    def in_die(self, rows: NDArray[np.float64], cols: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return die coordinates (u_um, v_um) of cell pixels."""
        u_um = (cols - self.street[1] + 0.5) * self.pixel_um
        return u_um, self.grid.height_um - (rows - self.street[0] + 0.5) * self.pixel_um

    def to_stage(
        self, place: Place, rows: NDArray[np.float64], cols: NDArray[np.float64], shift: Shift = (0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return stage (x_um, y_um) of pixels of a cell shifted by `shift` pixels (down, right) from its place."""
        return self.grid.to_stage(*place, *self.in_die(rows + shift[0], cols + shift[1]))

    def around(self, place: Place, rows: slice, cols: slice, shift: Shift, spare_px: float = MARGIN_PX) -> Region:
        """Return the stage region to read for a part of a cell."""
        r, c = np.array([rows.start, rows.stop]), np.array([cols.start, cols.stop])
        corner_rows, corner_cols = np.repeat(r, 2).astype(float), np.tile(c, 2).astype(float)
        x_um, y_um = self.to_stage(place, corner_rows, corner_cols, shift)
        spare = spare_px * self.pixel_um
        return Region.rectangle(x_um.min() - spare, y_um.min() - spare, x_um.max() + spare, y_um.max() + spare)

    def around_all(self, places: Sequence[Place]) -> Region:
        """Return the stage region to read for entire cells, with a margin for any shift within reach."""
        rows, cols = np.array([0, 0, self.shape[0], self.shape[0]]), np.array([0, self.shape[1], 0, self.shape[1]])
        cells = np.array(places)[:, :, None]
        x_um, y_um = self.grid.to_stage(cells[:, 0], cells[:, 1], *self.in_die(rows.astype(float), cols.astype(float)))
        spare = (MARGIN_PX + REACH_PX) * self.pixel_um
        return Region.rectangle(x_um.min() - spare, y_um.min() - spare, x_um.max() + spare, y_um.max() + spare)

    def side_by_side(self, places: Sequence[Place]) -> tuple[tuple[Place, ...], ...]:
        """Group adjacent cells of a row of dies into strips of at most STRIP_PIXELS, one cell at least.

        The strips do not depend on the runner, so that results are identical to the last bit.
        """
        rise, (height_px, width_px) = abs(math.tan(self.grid.angle_rad)), self.shape
        most = max(1, math.floor(STRIP_PIXELS / (width_px * (height_px + rise * self.grid.cols * width_px))))
        rows = (tuple(of_row) for _, of_row in groupby(places, lambda place: place[1]))
        return tuple(row[k : k + most] for row in rows for k in range(0, len(row), most))


class Read(Protocol):
    """Protocol of sources from which cells are read."""

    def read(self, cells: CellGrid, place: Place, rows: slice, cols: slice, shift: Shift) -> tuple[Plane, Plane] | None:
        """Return heights and image of a part of a cell shifted by `shift` pixels; None where nothing is there."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CellSource:
    """A surface for inspection: height layer and form; dark: grey value added before the logarithm.

    levels_um: heights over the form of the surface's levels, where the comparison uses them.
    """

    surface: Mosaic
    layer: Layer
    form: Datum
    dark: float = 1.0
    levels_um: tuple[float, ...] = ()

    def read(self, cells: CellGrid, place: Place, rows: slice, cols: slice, shift: Shift) -> tuple[Plane, Plane] | None:
        """Return heights and image of a part of a cell; None where the surface does not cover it."""
        strip = self.strip(cells.around(place, rows, cols, shift))
        return None if strip is None else strip.read(cells, place, rows, cols, shift)

    def strip(self, region: Region) -> CellStrip | None:
        """Return a part of the surface in memory; None where the surface does not cover it."""
        try:
            part = pictured_window(self.surface, self.layer, region)
        except MeasureError:
            return None
        z_um = np.empty(part.z_um.shape, np.float32)
        subtract_products(part.z_um, *_as_products(self.form, part), z_um)
        picture = np.log(part.picture + np.float32(self.dark))
        return CellStrip(z_um, fill_single_pixels(z_um), picture, part.pixel_um, part.x0_um, part.y0_um)


@dataclass(frozen=True, slots=True, eq=False)
class CellStrip:
    """A part of a surface in memory: heights over the form, the same `fill_single_pixels`, and the log image."""

    z_um: Plane
    complete_um: Plane
    picture: Plane
    pixel_um: float
    x0_um: float
    y0_um: float

    def read(self, cells: CellGrid, place: Place, rows: slice, cols: slice, shift: Shift) -> tuple[Plane, Plane]:
        """Return heights and image of a part of a cell, NaN beyond the strip."""
        out_z, out_picture = (np.empty((rows.stop - rows.start, cols.stop - cols.start), np.float32) for _ in range(2))
        affine = _affine(cells, place, (rows.start, cols.start), self, shift)
        read_affine(self.z_um, self.complete_um, affine, out_z)
        read_affine(self.picture, self.picture, affine, out_picture)
        return out_z, out_picture


def _as_products(form: Datum, part: Heights) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a polynomial as a sum of products of row and column factors, [term, n] each.

    It has one term for each power of y, which is faster than evaluating the polynomial at each pixel.
    """
    u, v = part.x_um - form.center.x_um, part.y_um - form.center.y_um
    highest = max((j for _, j in form.powers), default=0)
    by_col = np.zeros((highest + 1, u.size))
    for (i, j), coefficient in zip(form.powers, form.coefficients, strict=True):
        by_col[j] += coefficient * u**i
    return np.stack([v**j for j in range(highest + 1)]), by_col


def source_of(surface: Mosaic, layer: Layer, order: int) -> CellSource:
    """Return a surface with its form, a polynomial fitted with outlier rejection.

    Raises MeasureError where too little is measured to fit it.
    """
    points, grey = sample_of(surface, layer)
    if len(points) < LEAST_FORM_POINTS:
        raise MeasureError("The surface has hardly any measured pixels: there is nothing to inspect for defects.")
    powers = form_powers(order)
    center = float(points.x_um.mean()), float(points.y_um.mean())
    u, v = points.x_um - center[0], points.y_um - center[1]
    fit = robust_fit(np.stack([u**i * v**j for i, j in powers], axis=1), points.z_um)
    point = Point(x_um=center[0], y_um=center[1])
    datum = Datum(center=point, powers=powers, coefficients=tuple(fit.coefficients.tolist()))
    return CellSource(surface, layer, datum, max(1.0, DARK_SHARE * grey))


def form_powers(order: int) -> tuple[tuple[int, int], ...]:
    """Return the exponents of x and y of a polynomial of a given order."""
    return tuple((i, total - i) for total in range(order, -1, -1) for i in range(total, -1, -1))


def sample_of(surface: Mosaic, layer: Layer) -> tuple[HeightSamples, float]:
    """Return about FORM_POINTS measured pixels of the entire surface, and their median grey."""
    pixels = surface.shape[0] * surface.shape[1]
    level = min(surface.levels - 1, max(0, math.floor(math.log(max(1.0, pixels / FORM_POINTS), 4))))
    part = surface.window(None, level)
    step = max(1, round(math.sqrt(part.shape[0] * part.shape[1] / FORM_POINTS)))
    z_um = heights(part, layer)[::step, ::step]
    rows, cols = np.nonzero(np.isfinite(z_um))
    some = part.all_in_focus[::step, ::step][rows, cols]
    points = HeightSamples(part.x_um[::step][cols], part.y_um[::step][rows], z_um[rows, cols].astype(np.float64))
    return points, float(np.median(some)) if some.size else 0.0


def _half(street_um: float, pixel_um: float) -> int:
    return round(street_um / 2 / pixel_um)


def _affine(cells: CellGrid, place: Place, start: Place, part: CellStrip, shift: Shift) -> NDArray[np.float64]:
    """Return the affine map from cell pixels to strip pixels, as `read_affine` takes it."""
    corner = np.array([0.0, 1.0, 0.0]) + start[0], np.array([0.0, 0.0, 1.0]) + start[1]
    x_um, y_um = cells.to_stage(place, *corner, shift)
    rows, cols = (part.y0_um - y_um) / part.pixel_um, (x_um - part.x0_um) / part.pixel_um
    return np.array([rows[0], rows[1] - rows[0], rows[2] - rows[0], cols[0], cols[1] - cols[0], cols[2] - cols[0]])


POINTS = 6_000
"""Approximate number of pixels to which the plane of a die is fitted."""
LEAST_POINTS = 50
"""Smallest number of measured ones among them for a plane."""


@dataclass(frozen=True, slots=True)
class DiePlane:
    """Slopes in um per pixel down and right, and height in um at pixel (0, 0) of a cell."""

    down: float = 0.0
    right: float = 0.0
    zero_um: float = 0.0

    @classmethod
    def of(cls, z_um: Plane) -> DiePlane:
        """Fit a plane to the measured pixels with outlier rejection; zero with too few pixels."""
        step = max(1, round((z_um.size / POINTS) ** 0.5))
        some = z_um[::step, ::step]
        rows, cols = np.nonzero(np.isfinite(some))
        if len(rows) < LEAST_POINTS:
            return cls()
        design = np.stack([rows * float(step), cols * float(step), np.ones(len(rows))], axis=1).astype(np.float64)
        return cls(*robust_fit(design, some[rows, cols].astype(np.float64)).coefficients.tolist())

    def at(self, row: float, col: float) -> float:
        """Return the height at a pixel, um."""
        return self.down * row + self.right * col + self.zero_um

    def seen_from(self, row: float, col: float) -> DiePlane:
        """Return the same plane with another pixel as origin."""
        return replace(self, zero_um=self.at(row, col))

    def off(self, z_um: Plane) -> Plane:
        """Subtract the plane from heights."""
        rows, cols = z_um.shape
        plane = self.down * np.arange(rows)[:, None] + self.right * np.arange(cols)[None, :] + self.zero_um
        return z_um - plane.astype(np.float32)
