"""Evidence for the die lattice: heights and image of a surface, coarse or die by die. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats, heights, layer_of, pictured_window
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin, picture_of
from wafer_viewer.numerics.filters.gaussian import binned
from wafer_viewer.numerics.filters.sliding_filters import blurred
from wafer_viewer.numerics.jit import Float32s

Evidence = Literal["height", "picture", "both"]
LEVEL_PIXELS = 1_000_000
"""Largest number of pixels of the pyramid level by which the scanned part of a surface is found."""
COARSE_PIXELS = 800_000
"""Largest number of pixels for the coarse read of a surface."""
SOFT_PX = 1.0
"""Standard deviation of the blur of a die before it is sampled, px of its level."""
LEAST_PIXELS = 10
"""Smallest number of known pixels for the plane of a die."""
SPARE_PX = 8.0
"""Margin of the cached part around a die, px of its level."""
LEAST_SHARE = 0.4
"""Smallest known fraction under the blur for a known pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """Layers [row, col], float32, NaN where unknown; (x0_um, y0_um) is the centre of pixel (0, 0)."""

    layers: tuple[Float32s, ...]
    pixel_um: float
    x0_um: float
    y0_um: float

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        rows, cols = self.layers[0].shape
        return rows, cols


def layers_of(part: HeightMap, evidence: Evidence) -> tuple[Float32s, ...]:
    """Return heights, image or both, as float32 with NaN where unknown."""
    z_um = heights(part, layer_of(part.provenance.recipe, None))
    return _chosen(z_um, picture_of(part.all_in_focus, part.origin), evidence)


def _chosen(z_um: Float32s, picture: Float32s, evidence: Evidence) -> tuple[Float32s, ...]:
    chosen: dict[Evidence, tuple[Float32s, ...]] = {"height": (z_um,), "picture": (picture,), "both": (z_um, picture)}
    return chosen[evidence]


def read_coarse(surface: Mosaic, evidence: Evidence, region: Region | None = None) -> Coarse:
    """Return a surface or a region of it with at most COARSE_PIXELS: a pyramid level, binned if too fine."""
    low_x, low_y, high_x, high_y = region.bounds_um if region else bounds_of(surface)
    pixels = (high_x - low_x) * (high_y - low_y) / surface.pixel_um**2
    level = min(surface.levels - 1, max(0, math.ceil(math.log(max(1.0, pixels / COARSE_PIXELS), 4))))
    part = surface.window(region, level)
    factor = math.ceil(math.sqrt(max(1.0, part.shape[0] * part.shape[1] / COARSE_PIXELS)))
    layers = tuple(_binned(layer, factor) for layer in layers_of(part, evidence))
    middle_um = (factor - 1) / 2 * part.pixel_um
    return Coarse(layers, part.pixel_um * factor, part.x0_um + middle_um, part.y0_um - middle_um)


def _binned(layer: Float32s, factor: int) -> Float32s:
    """Return the means of the known pixels in blocks of factor x factor."""
    if factor == 1:
        return layer
    finite = np.isfinite(layer)
    totals, counts = binned(np.where(finite, layer, np.float32(0)), factor), binned(finite.astype(np.float32), factor)
    return np.divide(totals, counts, out=np.full(totals.shape, np.nan, np.float32), where=counts > 0)


def bounds_of(surface: Mosaic) -> tuple[float, float, float, float]:
    """Return (x low, y low, x high, y high) of the outer pixel edges of a surface."""
    half = surface.pixel_um / 2
    rows, cols = surface.shape
    low_x, high_y = surface.x0_um - half, surface.y0_um + half
    return low_x, high_y - rows * surface.pixel_um, low_x + cols * surface.pixel_um, high_y


def scanned_bounds(surface: Mosaic) -> tuple[float, float, float, float]:
    """Return (x low, y low, x high, y high) of the scanned part of a surface's rectangle."""
    level = coarse_level(surface)
    part = surface.window(None, level)
    rows, cols = (np.flatnonzero((part.origin != Origin.NOT_COVERED).any(axis=axis)) for axis in (1, 0))
    low_x, low_y, high_x, high_y = bounds_of(surface)
    if not rows.size:
        return low_x, low_y, high_x, high_y
    half = part.pixel_um / 2
    left, right = (part.x0_um + float(col) * part.pixel_um for col in (cols[0], cols[-1]))
    upper, lower = (part.y0_um - float(row) * part.pixel_um for row in (rows[0], rows[-1]))
    return max(low_x, left - half), max(low_y, lower - half), min(high_x, right + half), min(high_y, upper + half)


def coarse_level(surface: Mosaic) -> int:
    """Return the pyramid level of a surface with about a million pixels."""
    rows, cols = surface.shape
    return min(surface.levels - 1, max(0, math.ceil(math.log(max(1.0, rows * cols / LEVEL_PIXELS), 4))))


@dataclass(frozen=True, slots=True)
class CellLattice:
    """Sample lattice of a cell (a die with half of each surrounding street); the steps divide the pitch evenly."""

    rows: int
    cols: int
    step_x_um: float
    step_y_um: float

    @classmethod
    def of(cls, grid: DieGrid, step_um: float) -> CellLattice:
        """Return the sample lattice with steps of about `step_um`."""
        rows, cols = max(1, round(grid.pitch_y_um / step_um)), max(1, round(grid.pitch_x_um / step_um))
        return cls(rows, cols, grid.pitch_x_um / cols, grid.pitch_y_um / rows)

    def places(self, grid: DieGrid) -> tuple[Floats, Floats]:
        """Return (u_um [1, col], v_um [row, 1]); row 0 is the upper edge, the cell is centred on the die."""
        u_um = grid.width_um / 2 + (np.arange(self.cols, dtype=np.float64) - (self.cols - 1) / 2) * self.step_x_um
        v_um = grid.height_um / 2 - (np.arange(self.rows, dtype=np.float64) - (self.rows - 1) / 2) * self.step_y_um
        return np.asarray(u_um[None, :], np.float64), np.asarray(v_um[:, None], np.float64)


class Cells:
    """The dies of a surface at one level, smoothed.

    Parts already read are cached, as refinement of the lattice moves dies by fractions of a pixel.
    """

    def __init__(self, surface: Mosaic, level: int, evidence: Evidence) -> None:
        self.surface, self._level = surface, level
        self._evidence: Evidence = evidence
        self._pixel_um = surface.pixel_um * 2**level
        self._held: dict[tuple[int, int], tuple[Region, Coarse]] = {}

    def lattice(self, grid: DieGrid) -> CellLattice:
        """Return the sample lattice of a cell at this level."""
        return CellLattice.of(grid, self._pixel_um)

    def read(self, grid: DieGrid, die: tuple[int, int], lattice: CellLattice) -> tuple[Float32s, ...]:
        """Return the layers of one die, bilinearly sampled on the lattice of a cell; NaN off the surface.

        Raises MeasureError where the cell lies outside the surface.
        """
        u_um, v_um = lattice.places(grid)
        x_um, y_um = grid.to_stage(*die, u_um, v_um)
        part = self._part(die, x_um, y_um)
        rows, cols = (part.y0_um - y_um) / part.pixel_um, (x_um - part.x0_um) / part.pixel_um
        return tuple(flattened(sampled(layer, rows, cols)) for layer in part.layers)

    def _part(self, die: tuple[int, int], x_um: Floats, y_um: Floats) -> Coarse:
        needed = _box(x_um, y_um, self._pixel_um)
        held = self._held.get(die)
        if held is None or not _holds(held[0], needed):
            region = _box(x_um, y_um, SPARE_PX * self._pixel_um)
            held = self._held[die] = region, self._softened(region)
        return held[1]

    def _softened(self, region: Region) -> Coarse:
        part = pictured_window(self.surface, layer_of(self.surface.provenance.recipe, None), region, self._level)
        layers = tuple(softened(layer) for layer in _chosen(part.z_um, part.picture, self._evidence))
        return Coarse(layers, part.pixel_um, part.x0_um, part.y0_um)


def _box(x_um: Floats, y_um: Floats, spare_um: float) -> Region:
    return Region.rectangle(x_um.min() - spare_um, y_um.min() - spare_um, x_um.max() + spare_um, y_um.max() + spare_um)


def _holds(outer: Region, inner: Region) -> bool:
    (a, b, c, d), (e, f, g, h) = outer.bounds_um, inner.bounds_um
    return a <= e and b <= f and c >= g and d >= h


def softened(layer: Float32s) -> Float32s:
    """Blur the known pixels by about a pixel; sharper edges shift under interpolation."""
    finite = np.isfinite(layer)
    share = blurred(finite, SOFT_PX)
    total = blurred(np.where(finite, layer, np.float32(0)), SOFT_PX)
    return np.divide(total, share, out=np.full(layer.shape, np.nan, np.float32), where=share > LEAST_SHARE)


def flattened(layer: Float32s) -> Float32s:
    """Subtract the least-squares plane of the known pixels; a bow gives each die another tilt."""
    rows, cols = np.nonzero(np.isfinite(layer))
    if rows.size < LEAST_PIXELS:
        return layer
    down, across = (np.arange(n) - (n - 1) / 2 for n in layer.shape)
    design = np.stack([down[rows], across[cols], np.ones(rows.size)], axis=1)
    slope_down, slope_across, middle = np.linalg.lstsq(design.T @ design, design.T @ layer[rows, cols], rcond=None)[0]
    return (layer - (slope_down * down[:, None] + slope_across * across + middle)).astype(np.float32)


def sampled(layer: Float32s, rows: Floats, cols: Floats) -> Float32s:
    """Sample bilinearly; NaN where one of the four pixels is unknown or beyond the border."""
    from scipy.ndimage import map_coordinates

    places = np.broadcast_arrays(rows, cols)
    values: Any = map_coordinates(layer, places, order=1, mode="constant", cval=np.nan)
    return np.asarray(values, np.float32)


def median_cell(cells: Sequence[tuple[Float32s, ...]]) -> tuple[Float32s, ...]:
    """Return the median over dies, by layer, each less its own median; NaN where under a third are known."""
    return tuple(median_of(np.stack([_centred(cell[k]) for cell in cells])) for k in range(len(cells[0])))


def _centred(layer: Float32s) -> Float32s:
    finite = layer[np.isfinite(layer)]
    return layer - np.median(finite) if finite.size else layer


def median_of(stack: Float32s) -> Float32s:
    """Return the median over the first axis; NaN where under a third of the values are known."""
    finite = np.isfinite(stack).sum(axis=0)
    ordered = np.sort(stack, axis=0)  # NaN goes last
    low, high = np.maximum(finite - 1, 0) // 2, finite // 2
    high = np.minimum(high, len(stack) - 1)
    middle = (np.take_along_axis(ordered, low[None], 0)[0] + np.take_along_axis(ordered, high[None], 0)[0]) / 2
    return np.where(finite * 3 >= len(stack), middle, np.float32(np.nan)).astype(np.float32)
