"""Layout of fields in a mosaic: pixel positions, tilts and feather widths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import Outline
from wafer_viewer.numerics.jit import Float64s, Int64s

# ---------------------------------------------------------------------------------------------------- rectangle overlap


@dataclass(frozen=True, slots=True, eq=False)
class Rectangles:
    """Rectangles float64 [n] by their borders, indexed by the cell of their upper left corner.

    A cell is as large as the largest rectangle, so one that contains a point starts in its cell or in the previous one.
    Rectangles of NaN are ignored.
    """

    top: Float64s
    bottom: Float64s
    left: Float64s
    right: Float64s
    cell: tuple[float, float]
    keys: Int64s
    order: Int64s

    @classmethod
    def of(cls, top: Float64s, bottom: Float64s, left: Float64s, right: Float64s) -> Rectangles:
        """Return the rectangles with these borders, inclusive row and column numbers."""
        placed = np.flatnonzero(np.isfinite(top + left))
        tallest, widest = (float(np.max((b - a)[placed], initial=0.0)) + 1 for a, b in ((top, bottom), (left, right)))
        keys = _keys(np.floor(top[placed] / tallest), np.floor(left[placed] / widest))
        order = np.argsort(keys, kind="stable")
        return cls(top, bottom, left, right, (tallest, widest), keys[order], placed[order])

    def intersecting(self, top: float, bottom: float, left: float, right: float) -> list[int]:
        """Return the indices of the rectangles that intersect a window, ascending."""
        rows = np.arange(np.floor(top / self.cell[0]) - 1, np.floor(bottom / self.cell[0]) + 1)
        first = np.searchsorted(self.keys, _keys(rows, np.floor(left / self.cell[1]) - 1))
        last = np.searchsorted(self.keys, _keys(rows, np.floor(right / self.cell[1])), "right")
        near = np.concatenate([self.order[a:b] for a, b in zip(first, last, strict=True)])
        meets = (self.top[near] <= bottom) & (self.bottom[near] >= top)
        meets &= (self.left[near] <= right) & (self.right[near] >= left)
        return sorted(near[meets].tolist())

    def pairs(self) -> tuple[Int64s, Int64s]:
        """Return the indices of all intersecting pairs, each pair once."""
        rows, cols = np.floor(self.top[self.order] / self.cell[0]), np.floor(self.left[self.order] / self.cell[1])
        found = [
            self._pairs_in_cells(_keys(rows + down, cols + right)) for down, right in ((0, 1), (1, -1), (1, 0), (1, 1))
        ]
        found.append(self._pairs_in_own_cell())
        a, b = (np.concatenate([pair[side] for pair in found]) for side in (0, 1))
        meets = (self.top[a] <= self.bottom[b]) & (self.top[b] <= self.bottom[a])
        meets &= (self.left[a] <= self.right[b]) & (self.left[b] <= self.right[a])
        return a[meets], b[meets]

    def _pairs_in_cells(self, keys: Int64s) -> tuple[Int64s, Int64s]:
        """Pair each rectangle with all those in the cell of its key."""
        return self._with(np.searchsorted(self.keys, keys), np.searchsorted(self.keys, keys, "right"))

    def _pairs_in_own_cell(self) -> tuple[Int64s, Int64s]:
        """Pair each rectangle with the later ones in its own cell."""
        return self._with(np.arange(1, self.keys.size + 1), np.searchsorted(self.keys, self.keys, "right"))

    def _with(self, start: Int64s, stop: Int64s) -> tuple[Int64s, Int64s]:
        """Pair each rectangle with those from `start` up to `stop`, in the order of their cells."""
        n = stop - start
        first = np.repeat(np.arange(n.size), n)
        second = np.arange(first.size) - np.repeat(np.cumsum(n) - n, n) + np.repeat(start, n)
        return self.order[first], self.order[second]


def _keys(rows: Float64s, cols: Float64s | float) -> Int64s:
    """Return one number per cell, ascending along its row and then from row to row."""
    return (np.asarray(rows) * 2.0**31 + cols).astype(np.int64)


# -------------------------------------------------------------------------------------------------------- mosaic layout


Lengths = NDArray[np.float64]
"""[n, 4]: ramp lengths of n fields at their top, bottom, left and right border, in pixels; 0 without a neighbour."""
TOP, BOTTOM, LEFT, RIGHT = range(4)
"""Columns of `Lengths`."""
DIAGONAL = 0.25
"""Neighbours whose distances along x and y differ by less than this fraction of a field are diagonal."""


def feather_widths(fields: Rectangles) -> Lengths:
    """Return the lengths of all ramps, from a field's border to the start of its nearest neighbour on that side.

    A neighbour belongs to the side on which it is furthest away, relative to the size of the field; a diagonal
    neighbour belongs to both.
    """
    first, second = fields.pairs()
    lengths = np.zeros((fields.top.size, 4))
    _lengthen(lengths, fields, first, second)
    _lengthen(lengths, fields, second, first)
    return lengths


def _lengthen(lengths: Lengths, fields: Rectangles, own: NDArray[np.int64], other: NDArray[np.int64]) -> None:
    """Extend the ramps of each field to its overlap with another one."""
    height, width = fields.bottom[own] - fields.top[own] + 1, fields.right[own] - fields.left[own] + 1
    down = (fields.top[other] + fields.bottom[other] - fields.top[own] - fields.bottom[own]) / 2 / height
    right = (fields.left[other] + fields.right[other] - fields.left[own] - fields.right[own]) / 2 / width
    upright, across = np.abs(down) >= np.abs(right) - DIAGONAL, np.abs(right) >= np.abs(down) - DIAGONAL
    for side, counts, overlap in (
        (TOP, upright & (down < 0), fields.bottom[other] - fields.top[own]),
        (BOTTOM, upright & (down > 0), fields.bottom[own] - fields.top[other]),
        (LEFT, across & (right < 0), fields.right[other] - fields.left[own]),
        (RIGHT, across & (right > 0), fields.right[own] - fields.left[other]),
    ):
        np.maximum.at(lengths[:, side], own[counts], overlap[counts])


SNAP_PX = 1e-3
"""A field this close to the mosaic lattice is snapped to it; resampling would gain nothing."""
MARGIN_PX = 32
"""Margin around the planned fields, for fields that are added later or found elsewhere."""
SAME_PIXEL_FRACTION = 1e-6
"""Largest relative difference between the pixel sizes of the fields of a mosaic."""

Numbers = NDArray[np.float64]
Part = tuple[slice, slice]
"""Rows and columns of a mosaic."""


@dataclass(frozen=True, slots=True)
class PixelLattice:
    """Pixel lattice of a mosaic: (x0_um, y0_um) is the centre of pixel (0, 0)."""

    pixel_um: float
    x0_um: float
    y0_um: float
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True)
class FieldTilt:
    """Height correction subtracted from a field: z_um at its centre, gradients per pixel right and up, and sag.

    sag_um: the coefficients of u^2, u v and v^2, with u to the right and v upwards, both 1 at so_far_px from the
    centre.
    """

    z_um: float = 0.0
    right_um_px: float = 0.0
    up_um_px: float = 0.0
    sag_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    so_far_px: tuple[float, float] = (1.0, 1.0)

    def at(self, up_px: Numbers, right_px: Numbers) -> Numbers:
        """Return the correction to be subtracted, um, at a given distance in pixels above and right of the centre."""
        u, v = right_px / self.so_far_px[0], up_px / self.so_far_px[1]
        a, b, c = self.sag_um
        return self.z_um + self.up_um_px * up_px + self.right_um_px * right_px + a * u**2 + b * u * v + c * v**2


@dataclass(frozen=True, slots=True)
class FieldPlacement:
    """Position of a field's pixel (0, 0) in the mosaic, in pixels, with its ramps and tilt.

    ramps_px: top, bottom, left, right.
    """

    row: float
    col: float
    rows: int
    cols: int
    ramps_px: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    lean: FieldTilt = FieldTilt()

    @property
    def part(self) -> Part:
        """Pixels of the mosaic that the field covers."""
        return (
            slice(math.ceil(self.row), math.floor(self.row + self.rows - 1) + 1),
            slice(math.ceil(self.col), math.floor(self.col + self.cols - 1) + 1),
        )

    @property
    def covers_any(self) -> bool:
        """True if the field covers any pixel of the mosaic."""
        return all(run.start < run.stop for run in self.part)


@dataclass(frozen=True, slots=True, eq=False)
class MosaicLayout:
    """Lattice of a mosaic and the placements of its fields, in the given order.

    borders: first and last rows and columns of the fields, NaN for excluded fields; ramps_px: [n, 4].
    """

    lattice: PixelLattice
    outlines: Sequence[Outline]
    borders: Rectangles
    ramps_px: Lengths
    poses: Poses | None = None

    @property
    def pixel_um(self) -> float:
        """Pixel size of the lattice."""
        return self.lattice.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of pixel (0, 0)."""
        return self.lattice.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of pixel (0, 0)."""
        return self.lattice.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.lattice.shape

    def touching(self, rows: slice, cols: slice) -> list[int]:
        """Return the indices of the fields with pixels in a window."""
        return self.borders.intersecting(rows.start, rows.stop - 1, cols.start, cols.stop - 1)

    def place(self, n: int) -> FieldPlacement | None:
        """Return the placement of field n; None if it is excluded."""
        row, col = float(self.borders.top[n]), float(self.borders.left[n])
        if math.isnan(row):
            return None
        top, bottom, left, right = (float(self.ramps_px[n, side]) for side in (TOP, BOTTOM, LEFT, RIGHT))
        return FieldPlacement(row, col, *self.outlines[n].shape, (top, bottom, left, right), self._lean(n))

    def window_of(self, n: int) -> Part | None:
        """Return the pixels of the mosaic that field n covers; None if it is excluded or outside."""
        place = self.place(n)
        if place is None:
            return None
        rows, cols = (_within(part, size) for part, size in zip(place.part, self.shape, strict=True))
        return (rows, cols) if rows.start < rows.stop and cols.start < cols.stop else None

    def _lean(self, n: int) -> FieldTilt:
        if (poses := self.poses) is None:
            return FieldTilt()
        right_um_px, up_um_px = (float(tilt[n]) * self.pixel_um for tilt in (poses.tilt_x, poses.tilt_y))
        width_px, height_px = (size_um / 2 / self.pixel_um for size_um in poses.form.field_size_um)
        return FieldTilt(float(poses.z_um[n]), right_um_px, up_um_px, poses.form.field_form_um, (width_px, height_px))


def layout(
    outlines: Sequence[Outline], poses: Poses | None = None, lattice: PixelLattice | None = None
) -> MosaicLayout:
    """Arrange fields in a mosaic, at their own positions or centred on `poses` of the same fields.

    Without a lattice the smallest one that holds all fields is used; with a given one, fields are cut off at its
    border. Raises ComputeError when there is no field, when all are excluded or when the pixel sizes differ.
    """
    pixel_um = _pixel_um(outlines)
    rows, cols = _sizes(outlines)
    x0_um, y0_um = _corners(outlines) if poses is None else _solved(poses, rows, cols, pixel_um)
    if not np.isfinite(x0_um).any():
        raise ComputeError("All fields are left out of the mosaic: none of them fits its neighbours.")
    lattice = lattice or _smallest(x0_um, y0_um, rows, cols, pixel_um)
    top, left = _snapped((lattice.y0_um - y0_um) / pixel_um), _snapped((x0_um - lattice.x0_um) / pixel_um)
    borders = Rectangles.of(top, top + rows - 1, left, left + cols - 1)
    return MosaicLayout(lattice, outlines, borders, feather_widths(borders), poses)


def planned_lattice(outlines: Sequence[Outline], margin_px: int = MARGIN_PX) -> PixelLattice:
    """Return the smallest lattice that holds all planned fields, plus a margin for later changes.

    outlines: as planned. Raises ComputeError when there is none or when the pixel sizes differ.
    """
    pixel_um = _pixel_um(outlines)
    tight = _smallest(*_corners(outlines), *_sizes(outlines), pixel_um)
    shape = tight.shape[0] + 2 * margin_px, tight.shape[1] + 2 * margin_px
    return PixelLattice(pixel_um, tight.x0_um - margin_px * pixel_um, tight.y0_um + margin_px * pixel_um, shape)


def _pixel_um(outlines: Sequence[Outline]) -> float:
    """Return the common pixel size of all fields."""
    if not outlines:
        raise ComputeError("There is no field to stitch: give at least one height map.")
    pixel_um = outlines[0].pixel_um
    for outline in outlines:
        if abs(outline.pixel_um / pixel_um - 1) > SAME_PIXEL_FRACTION:
            raise ComputeError(
                f"Fields of {pixel_um:g} and of {outline.pixel_um:g} um per pixel cannot be stitched: "
                "reconstruct them with one pixel size."
            )
    return pixel_um


def _sizes(outlines: Sequence[Outline]) -> tuple[Numbers, Numbers]:
    shapes = np.array([o.shape for o in outlines], np.float64)
    return shapes[:, 0], shapes[:, 1]


def _corners(outlines: Sequence[Outline]) -> tuple[Numbers, Numbers]:
    """Return stage x and y of the first pixels."""
    return np.array([o.x0_um for o in outlines]), np.array([o.y0_um for o in outlines])


def _solved(poses: Poses, rows: Numbers, cols: Numbers, pixel_um: float) -> tuple[Numbers, Numbers]:
    """Return stage x and y of the first pixels for centres at the poses; NaN for excluded fields."""
    if poses.x_um.size != rows.size:
        raise ComputeError(f"There are {rows.size} fields and {poses.x_um.size} poses: give one pose for each field.")
    x0_um, y0_um = poses.x_um - (cols - 1) / 2 * pixel_um, poses.y_um + (rows - 1) / 2 * pixel_um
    return np.where(poses.left_out, np.nan, x0_um), np.where(poses.left_out, np.nan, y0_um)


def _smallest(x0_um: Numbers, y0_um: Numbers, rows: Numbers, cols: Numbers, pixel_um: float) -> PixelLattice:
    left_um, top_um = float(np.nanmin(x0_um)), float(np.nanmax(y0_um))
    last_row = np.nanmax(_snapped((top_um - y0_um) / pixel_um) + rows - 1)
    last_col = np.nanmax(_snapped((x0_um - left_um) / pixel_um) + cols - 1)
    return PixelLattice(pixel_um, left_um, top_um, (int(last_row) + 1, int(last_col) + 1))


def _snapped(px: Numbers) -> Numbers:
    return np.where(np.abs(px - np.round(px)) < SNAP_PX, np.round(px), px)


def _within(part: slice, size: int) -> slice:
    return slice(max(0, part.start), min(size, part.stop))
