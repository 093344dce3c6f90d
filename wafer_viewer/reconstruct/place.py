"""Where fields lie in a mosaic, in its pixels, and how much each counts where they overlap."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface import Outline

SNAP_PX = 1e-3
"""A field within a thousandth of a pixel of the mosaic's lattice lies on it: nothing is gained by resampling."""

SAME_PIXEL_FRACTION = 1e-6
LEAST_WEIGHT = 1e-6
"""A border pixel counts almost nothing beside a neighbour, and fully where the neighbour saw nothing."""


@dataclass(frozen=True, slots=True)
class Place:
    """One field in the mosaic: where its pixel (0, 0) lies, in pixels, and the length of its four ramps."""

    row: float
    col: float
    rows: int
    cols: int
    top_px: float = 0.0
    bottom_px: float = 0.0
    left_px: float = 0.0
    right_px: float = 0.0

    @property
    def last_row(self) -> float:
        """The row of its lowest pixels."""
        return self.row + self.rows - 1

    @property
    def last_col(self) -> float:
        """The column of its rightmost pixels."""
        return self.col + self.cols - 1

    def row_weights(self, rows: NDArray[np.float64]) -> NDArray[np.float32]:
        """Its weight along y at rows of the mosaic."""
        return _ramp(rows - self.row, self.last_row - rows, self.top_px, self.bottom_px)

    def col_weights(self, cols: NDArray[np.float64]) -> NDArray[np.float32]:
        """Its weight along x at columns of the mosaic."""
        return _ramp(cols - self.col, self.last_col - cols, self.left_px, self.right_px)


@dataclass(frozen=True, slots=True)
class Layout:
    """The lattice of a mosaic and the places of its fields, in the order they were given."""

    pixel_um: float
    x0_um: float
    y0_um: float
    shape: tuple[int, int]
    places: tuple[Place, ...]

    def touching(self, rows: slice, cols: slice) -> list[int]:
        """The numbers (from 0) of the fields with pixels in a window."""
        return [
            n
            for n, p in enumerate(self.places)
            if p.row < rows.stop and p.last_row >= rows.start and p.col < cols.stop and p.last_col >= cols.start
        ]


def layout(outlines: Sequence[Outline]) -> Layout:
    """The smallest lattice that holds all fields, and the linear ramps over their overlaps (eq. 15).

    Raises ComputeError when there is no field or when the pixel sizes differ.
    """
    if not outlines:
        raise ComputeError("There is no field to stitch: give at least one height map.")
    pixel_um = outlines[0].pixel_um
    for outline in outlines:
        if abs(outline.pixel_um / pixel_um - 1) > SAME_PIXEL_FRACTION:
            raise ComputeError(
                f"Fields of {pixel_um:g} and of {outline.pixel_um:g} um a pixel cannot be stitched: "
                "reconstruct them with one pixel size."
            )
    x0_um, y0_um = min(o.x0_um for o in outlines), max(o.y0_um for o in outlines)
    places = [
        Place(_snapped((y0_um - o.y0_um) / pixel_um), _snapped((o.x0_um - x0_um) / pixel_um), *o.shape)
        for o in outlines
    ]
    shape = int(max(p.last_row for p in places)) + 1, int(max(p.last_col for p in places)) + 1
    return Layout(pixel_um, x0_um, y0_um, shape, _with_ramps(places))


def _snapped(px: float) -> float:
    return float(round(px)) if abs(px - round(px)) < SNAP_PX else px


def _ramp(
    from_start: NDArray[np.float64], to_end: NDArray[np.float64], start_px: float, end_px: float
) -> NDArray[np.float32]:
    """Eq. 15: from 0 at the field's own border to 1 at the border of its neighbour."""
    weight = np.ones(from_start.shape)
    if start_px > 0:
        weight = np.minimum(weight, from_start / start_px)
    if end_px > 0:
        weight = np.minimum(weight, to_end / end_px)
    return np.maximum(weight, LEAST_WEIGHT).astype(np.float32)


def _with_ramps(places: Sequence[Place]) -> tuple[Place, ...]:
    """Each place with ramps as long as its overlap with the neighbour on that side."""
    row, col, last_row, last_col = (
        np.array([getattr(p, name) for p in places]) for name in ("row", "col", "last_row", "last_col")
    )
    return tuple(
        dataclasses.replace(
            place,
            left_px=_overlap(last_col - place.col, _beside(place.col - col, row, last_row, place.row, place.last_row)),
            right_px=_overlap(place.last_col - col, _beside(col - place.col, row, last_row, place.row, place.last_row)),
            top_px=_overlap(last_row - place.row, _beside(place.row - row, col, last_col, place.col, place.last_col)),
            bottom_px=_overlap(
                place.last_row - row, _beside(row - place.row, col, last_col, place.col, place.last_col)
            ),
        )
        for place in places
    )


def _beside(
    ahead: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64], own_start: float, own_end: float
) -> NDArray[np.bool_]:
    """The fields further on in one direction that share at least half of this field's side."""
    shared = np.minimum(end, own_end) - np.maximum(start, own_start)
    return (ahead > 0) & (shared >= 0.5 * (own_end - own_start))


def _overlap(overlaps: NDArray[np.float64], beside: NDArray[np.bool_]) -> float:
    """The overlap with the nearest neighbour on a side; 0 without one."""
    return max(0.0, float(overlaps[beside].max())) if beside.any() else 0.0
