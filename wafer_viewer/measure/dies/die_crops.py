"""The same patch of several dies, or of another scan, resampled, aligned and levelled. Pure.

A patch is a small view for a person, with heights and the all-in-focus image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.robust_fit import robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.golden_die import GoldenDie
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin
from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation
from wafer_viewer.numerics.grids.die_cell_kernels import fill_single_pixels, median_and_spread, read_affine
from wafer_viewer.numerics.subpixel_registration import RegisteredImage, align

Plane = NDArray[np.float32]
Floats = NDArray[np.float64]
Place = tuple[int, int]
MARGIN_PX = 4
"""Margin read around a patch for its interpolation, in pixels of the patch."""
DETAIL_PX = 15
"""Window of the high-pass before alignment, px; slower brightness changes do not locate a patch."""
BLOCK_PX = 15
"""Side of the blocks of the subpixel alignment, px: one that holds a defect then counts little beside the others."""
LEAST_SIMILARITY = 0.35
"""Correlation below which two patches do not show the same place."""
AS_GOOD = 0.95
"""Fraction of the best correlation above which the place nearest to the stage position is taken: patterns repeat."""
LEAST_POINTS = 50
"""Smallest number of common pixels for a plane between two crops."""

FURTHEST_PX = 1.5
"""Largest distance of the subpixel lag from the correlation maximum; a further one is not taken."""
LEAST_SIDE_PX = 8
"""Smallest side of a patch, px."""


@dataclass(frozen=True, slots=True)
class DiePatch:
    """Sampling geometry about a stage position, turned anticlockwise; shape is (rows, cols)."""

    x_um: float
    y_um: float
    pixel_um: float
    shape: tuple[int, int]
    angle_rad: float = 0.0

    @classmethod
    def of_box(cls, surface: Mosaic, box_um: tuple[float, float, float, float], most_px: int) -> DiePatch:
        """Return the patch of a stage box (x low, y low, x high, y high), with at most `most_px` pixels a side."""
        x0, y0, x1, y1 = box_um
        return cls._over(surface, ((x0 + x1) / 2, (y0 + y1) / 2), (x1 - x0, y1 - y0), most_px)

    @classmethod
    def of_die(cls, surface: Mosaic, grid: DieGrid, place: Place, most_px: int) -> DiePatch:
        """Return the patch of a die without its streets, along the die's own axes."""
        x_um, y_um = grid.to_stage(*place, grid.width_um / 2, grid.height_um / 2)
        size = grid.width_um, grid.height_um
        return replace(cls._over(surface, (float(x_um), float(y_um)), size, most_px), angle_rad=grid.angle_rad)

    @classmethod
    def _over(
        cls, surface: Mosaic, center: tuple[float, float], size_um: tuple[float, float], most_px: int
    ) -> DiePatch:
        coarser = max(0, math.ceil(math.log2(max(size_um) / surface.pixel_um / most_px)))
        pixel_um = surface.pixel_um * 2**coarser
        cols, rows = (max(LEAST_SIDE_PX, round(side / pixel_um)) for side in size_um)
        return cls(*center, pixel_um, (rows, cols))

    def to_stage(self, rows: Floats, cols: Floats) -> tuple[Floats, Floats]:
        """Return stage (x_um, y_um) of pixels."""
        right = (cols - (self.shape[1] - 1) / 2) * self.pixel_um
        up = ((self.shape[0] - 1) / 2 - rows) * self.pixel_um
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return self.x_um + c * right - s * up, self.y_um + s * right + c * up

    def moved(self, down_px: float, right_px: float) -> DiePatch:
        """Return the patch shifted by `down_px` and `right_px` of its pixels."""
        rows, cols = (np.array([(n - 1) / 2]) for n in self.shape)
        x_um, y_um = self.to_stage(rows + down_px, cols + right_px)
        return replace(self, x_um=float(x_um[0]), y_um=float(y_um[0]))

    def on_die(self, grid: DieGrid, die: Place, other: Place) -> DiePatch:
        """Return the corresponding patch of another die."""
        (xa, ya), (xb, yb) = grid.corner(*die), grid.corner(*other)
        return replace(self, x_um=self.x_um + xb - xa, y_um=self.y_um + yb - ya)

    def around(self, spare_px: float) -> Region:
        """Return the stage region to read for the patch."""
        rows, cols = self.shape
        x_um, y_um = self.to_stage(np.array([0.0, 0.0, rows, rows]), np.array([0.0, cols, 0.0, cols]))
        spare = spare_px * self.pixel_um
        return Region.rectangle(x_um.min() - spare, y_um.min() - spare, x_um.max() + spare, y_um.max() + spare)


@dataclass(frozen=True, slots=True, eq=False)
class DieCrop:
    """Content of a patch: heights in um and grey values, float32 [row, col], NaN where unknown."""

    z_um: Plane
    picture: Plane

    @property
    def measured(self) -> float:
        """Fraction of pixels with heights."""
        return float(np.isfinite(self.z_um).mean())


@dataclass(frozen=True, slots=True, eq=False)
class AlignedPatch:
    """A patch aligned with another: the crop, its shift (down, right) in um, and the correlation."""

    cut: DieCrop
    moved_um: tuple[float, float]
    similarity: float


def crop(surface: Mosaic, patch: DiePatch) -> DieCrop | None:
    """Return the crop of a surface at a patch; None where the surface does not cover it."""
    part = _window(surface, patch, MARGIN_PX)
    return None if part is None else _sampled(part, patch)


def align_crop(own: DieCrop, surface: Mosaic, patch: DiePatch, reach_px: int) -> AlignedPatch | None:
    """Return the crop of a surface near a patch, aligned with `own` within `reach_px` pixels and levelled on it.

    Alignment uses the image, or heights if there is none. Without a match the crop is not shifted, and `similarity`
    is below LEAST_SIMILARITY. None where the surface does not cover the patch.
    """
    part = _window(surface, patch, reach_px + MARGIN_PX)
    if part is None:
        return None
    sampled = _sampled(part, patch)
    lag, similarity = _lag(own, sampled, reach_px)
    moved = patch.moved(-lag[0], -lag[1])
    found = levelled_on(own, _sampled(part, moved) if any(lag) else sampled)
    return AlignedPatch(found, (-lag[0] * patch.pixel_um, -lag[1] * patch.pixel_um), similarity)


def median_crop(own: DieCrop, cuts: Sequence[DieCrop]) -> DieCrop:
    """Return the median of several crops, each levelled on `own`; unknown where less than half of them are known."""
    layers = [np.empty(own.z_um.shape, np.float32) for _ in range(2)]
    for layer, name in zip(layers, ("z_um", "picture"), strict=True):
        stack = np.stack([getattr(one, name) for one in cuts])
        median_and_spread(stack, (len(cuts) + 1) // 2, layer, np.empty_like(layer))
    return DieCrop(*layers)


def cut_of_golden(golden: GoldenDie, grid: DieGrid, place: Place, patch: DiePatch) -> DieCrop:
    """Return the crop of a stored golden die at a patch, for the die at a place of the lattice."""
    pixel_um = golden.header.pixel_um
    c, s = math.cos(grid.angle_rad), math.sin(grid.angle_rad)
    x0, y0 = grid.corner(*place)

    def to_pixels(x_um: Floats, y_um: Floats) -> tuple[Floats, Floats]:
        u_um, v_um = c * (x_um - x0) + s * (y_um - y0), c * (y_um - y0) - s * (x_um - x0)
        return (golden.header.height_um - v_um) / pixel_um - 0.5, u_um / pixel_um - 0.5

    affine = _affine(patch, to_pixels)
    return DieCrop(_read(golden.z_um, affine, patch.shape), _read(golden.picture, affine, patch.shape))


def levelled_on(own: DieCrop, other: DieCrop) -> DieCrop:
    """Correct the other crop to its own's plane and brightness."""
    return DieCrop(other.z_um + _difference(own.z_um, other.z_um), other.picture * np.float32(_brighter(own, other)))


def _window(surface: Mosaic, patch: DiePatch, spare_px: int) -> HeightMap | None:
    level = min(surface.levels - 1, max(0, round(math.log2(patch.pixel_um / surface.pixel_um))))
    try:
        part = surface.window(patch.around(spare_px), level)
    except MeasureError:
        return None
    return part if 0 not in part.shape else None


def _sampled(part: HeightMap, patch: DiePatch) -> DieCrop:
    picture = part.all_in_focus.astype(np.float32)
    picture[part.origin == Origin.NOT_COVERED] = np.nan

    def to_pixels(x_um: Floats, y_um: Floats) -> tuple[Floats, Floats]:
        return (part.y0_um - y_um) / part.pixel_um, (x_um - part.x0_um) / part.pixel_um

    affine = _affine(patch, to_pixels)
    z_um = np.where(part.measured, part.z_um, np.float32(np.nan))
    return DieCrop(_read(z_um, affine, patch.shape), _read(picture, affine, patch.shape))


def _affine(patch: DiePatch, to_pixels: Callable[[Floats, Floats], tuple[Floats, Floats]]) -> Floats:
    """Return the affine map from patch pixels to raster pixels, as `read_affine` takes it."""
    x_um, y_um = patch.to_stage(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    return np.concatenate([[v[0], v[1] - v[0], v[2] - v[0]] for v in to_pixels(x_um, y_um)])


def _read(plane: Plane, affine: Floats, shape: tuple[int, int]) -> Plane:
    out = np.empty(shape, np.float32)
    finite = np.ascontiguousarray(plane, np.float32)
    read_affine(finite, fill_single_pixels(finite), affine, out)
    return out


def _lag(own: DieCrop, other: DieCrop, reach_px: int) -> tuple[tuple[float, float], float]:
    """Return the shift in pixels (rows, cols) that aligns the other crop with its own, and their correlation."""
    one, two = _telling(own, other)
    if not (one.valid.sum() and two.valid.sum()):
        return (0.0, 0.0), 0.0
    contrasts = (contrast(p.values, p.valid > 0, DETAIL_PX) for p in (one, two))
    found = normalised_cross_correlation(
        next(contrasts), one.valid > 0, next(contrasts), two.valid > 0, (0, 0), reach_px
    )
    good = found.correlation >= AS_GOOD * max(float(found.correlation.max()), LEAST_SIMILARITY)
    if not good.any():
        return (0.0, 0.0), float(found.correlation.max())
    rows, cols = np.nonzero(good)
    nearest = int(np.argmin((rows - reach_px) ** 2 + (cols - reach_px) ** 2))
    row, col = _summit(found.correlation, int(rows[nearest]), int(cols[nearest]))
    begun = float(row - reach_px), float(col - reach_px)
    lag = align(one, two, begun, BLOCK_PX).lag
    near = max(abs(lag[0] - begun[0]), abs(lag[1] - begun[1])) <= FURTHEST_PX
    return (lag if near else begun), float(found.correlation[row, col])


def _summit(correlation: Floats, row: int, col: int) -> tuple[int, int]:
    """Climb from a place to a local maximum over eight neighbours."""
    while True:
        r0, c0 = max(0, row - 1), max(0, col - 1)
        near = correlation[r0 : row + 2, c0 : col + 2]
        down, right = np.unravel_index(int(near.argmax()), near.shape)
        if near[down, right] <= correlation[row, col]:
            return row, col
        row, col = r0 + int(down), c0 + int(right)


def _telling(own: DieCrop, other: DieCrop) -> tuple[RegisteredImage, RegisteredImage]:
    """Return the images to register: pictures, or heights if a picture has no contrast."""
    by_picture = all(float(np.nanstd(one.picture)) > 0 for one in (own, other) if np.isfinite(one.picture).any())
    planes = [one.picture if by_picture else one.z_um for one in (own, other)]
    return _picture(planes[0]), _picture(planes[1])


def _picture(plane: Plane) -> RegisteredImage:
    finite = np.isfinite(plane)
    middle = float(np.median(plane[finite])) if finite.any() else 0.0
    values = np.where(finite, plane - np.float32(middle), np.float32(0))
    return RegisteredImage(values.astype(np.float32), finite.astype(np.float32), 0.0)


def _difference(own: Plane, other: Plane) -> Plane:
    """Return the plane from the other's heights to its own; a constant where no plane is determined."""
    rows, cols = np.nonzero(np.isfinite(own) & np.isfinite(other))
    if len(rows) < LEAST_POINTS:
        return np.zeros_like(own)
    apart = (own - other)[rows, cols].astype(np.float64)
    half_r, half_c = own.shape[0] / 2, own.shape[1] / 2
    design = np.stack([np.ones(len(rows)), rows / half_r - 1, cols / half_c - 1], axis=1)
    try:
        level, down, right = robust_fit(design, apart).coefficients.tolist()
    except MeasureError:
        return np.full_like(own, np.median(apart))
    r, c = np.arange(own.shape[0])[:, None] / half_r - 1, np.arange(own.shape[1])[None, :] / half_c - 1
    return (level + down * r + right * c).astype(np.float32)


def _brighter(own: DieCrop, other: DieCrop) -> float:
    both = np.isfinite(own.picture) & np.isfinite(other.picture)
    if not both.any():
        return 1.0
    mine, theirs = (float(np.median(one.picture[both])) for one in (own, other))
    return mine / theirs if theirs > 0 and mine > 0 else 1.0
