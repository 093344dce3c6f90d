"""Height offsets and tilts between overlapping fields: planes fitted to their height differences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress
from wafer_viewer.model.surface.field_poses import HeightOffsets
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.filters.gaussian import binned
from wafer_viewer.numerics.filters.sliding_filters import repeated
from wafer_viewer.numerics.grids.robust_plane import Plane, differences, fit_plane
from wafer_viewer.reconstruct.focus.focus_volume import on_threads

MAX_STEP_FRAMES = 2.0
"""Neighbouring heights that differ by over two frames of the sweep are two surfaces and are not interpolated."""

CELL_PX, STEEP = 4, 4.0
"""Walls are cells of 4 x 4 pixels that differ from a neighbour by four times the 70th percentile."""

_USUAL, _EVERY = 0.7, 4
"""Quantile of the differences between neighbouring cells that walls exceed, and stride of its sample."""
_BLOCKS, _LEAST_BLOCK, _LARGEST_BLOCK = 40, 8, 40
"""Blocks are wider than the windows of the focus measures, within which errors are correlated."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Seam:
    """Height offset measured in one overlap; the fields have the meaning of those of `HeightOffsets`."""

    mid_x_um: float = math.nan
    mid_y_um: float = math.nan
    z_um: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    information: Numbers = field(default_factory=lambda: np.zeros((3, 3)))
    n_pixels: int = 0
    rms_um: float = math.nan


def compare(
    heights: Sequence[HeightMap],
    pairs: NDArray[np.int32],
    x_um: Numbers,
    y_um: Numbers,
    threads: int | None = None,
    progress: Progress | None = None,
) -> HeightOffsets:
    """Fit planes to the height differences of pairs of fields, with all field centres at (x_um, y_um).

    Until the poses are solved step_um is z_um, and rms_um is the scatter about the plane. Only the overlaps are read.
    progress receives the finished fraction (0 ... 1); an exception raised by it ends the work. threads: all cores if
    omitted.
    """
    found = [Seam()] * len(pairs)
    done = 0

    def compare(todo: Iterator[int]) -> None:
        nonlocal done
        for n in todo:
            a, b = int(pairs[n, 0]), int(pairs[n, 1])
            found[n] = compare_pair(heights[a], heights[b], (x_um[a], y_um[a]), (x_um[b], y_um[b]))
            done += 1
            if progress is not None:
                progress(done / len(pairs))

    on_threads(compare, range(len(pairs)), threads)
    return _table(pairs, found)


def compare_pair(
    first: HeightMap, second: HeightMap, at_um: tuple[float, float], second_at_um: tuple[float, float]
) -> Seam:
    """Fit the plane by which the heights of the second field differ from those of the first, at given centres."""
    pixel_um = first.pixel_um
    corner, other_corner = _corner(first, at_um), _corner(second, second_at_um)
    rows = _common(first.shape[0], second.shape[0], (corner[1] - other_corner[1]) / pixel_um)
    cols = _common(first.shape[1], second.shape[1], (other_corner[0] - corner[0]) / pixel_um)
    if rows.length < 2 or cols.length < 2:
        return Seam()
    one, other = _part(first, rows.first, cols.first), _part(second, rows.second, cols.second)
    step_um = MAX_STEP_FRAMES * second.provenance.z_step_um or math.inf
    residuals = differences(one, other, rows.part, cols.part, step_um)
    residuals[_walls(one)] = np.nan
    plane = fit_plane(residuals, _block_side(residuals))
    return Seam() if plane is None else _seam(plane, corner, rows.first.start, cols.first.start, pixel_um)


@dataclass(frozen=True, slots=True)
class _Common:
    """Overlap along one axis: pixels of both fields, and the sub-pixel offset between them (0 ... 1)."""

    first: slice
    second: slice
    part: float

    @property
    def length(self) -> int:
        return self.first.stop - self.first.start


def _common(first: int, second: int, offset: float) -> _Common:
    """Return the pixels of the first that have neighbours in the second, whose pixel i lies at i + offset."""
    start = max(0, math.ceil(offset))
    part, integer = math.modf(start - offset)
    stop = max(start, min(first, start + second - 1 - int(integer)))
    return _Common(slice(start, stop), slice(int(integer), int(integer) + stop - start + 1), part)


def _corner(height: HeightMap, at_um: tuple[float, float]) -> tuple[float, float]:
    """Return the position of pixel (0, 0) of a field with a given centre."""
    rows, cols = height.shape
    return at_um[0] - (cols - 1) / 2 * height.pixel_um, at_um[1] + (rows - 1) / 2 * height.pixel_um


def _part(height: HeightMap, rows: slice, cols: slice) -> NDArray[np.float32]:
    return np.array(height.z_raw_um[rows, cols], np.float32)


def _walls(z_um: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return a mask of walls, where a registration error of a tenth of a pixel already changes the height.

    Walls are detected on means of several pixels, above their noise.
    """
    valid = z_um == z_um
    count = binned(valid.astype(np.float32), CELL_PX)
    total = binned(np.where(valid, z_um, np.float32(0)), CELL_PX)
    mean = np.divide(total, count, out=np.full(count.shape, np.nan, np.float32), where=count > 0)
    steep = np.zeros(mean.shape, np.bool_)
    apart = np.abs(np.diff(mean, axis=0)), np.abs(np.diff(mean, axis=1))
    steps = np.concatenate([a[a == a][::_EVERY] for a in apart])
    limit_um = STEEP * float(np.quantile(steps, _USUAL)) if steps.size else math.inf
    for off, ahead, behind in ((apart[0], steep[1:], steep[:-1]), (apart[1], steep[:, 1:], steep[:, :-1])):
        ahead |= off > limit_um
        behind |= off > limit_um
    walls = np.zeros(z_um.shape, np.bool_)
    whole = tuple(slice(CELL_PX * (n // CELL_PX)) for n in z_um.shape)
    walls[whole] = repeated(steep, CELL_PX, walls[whole].shape)
    return walls


def _block_side(plane: NDArray[np.float32]) -> int:
    return int(np.clip((plane.size / _BLOCKS) ** 0.5, _LEAST_BLOCK, _LARGEST_BLOCK))


def _seam(plane: Plane, corner: tuple[float, float], row: int, col: int, pixel_um: float) -> Seam:
    """Convert a plane from pixels of the overlap to um: x grows with the columns, y against the rows."""
    to_um = np.array([1.0, -pixel_um, pixel_um])
    information = (plane.information * np.outer(to_um, to_um))[np.ix_([0, 2, 1], [0, 2, 1])]
    return Seam(
        corner[0] + (col + plane.col0) * pixel_um,
        corner[1] - (row + plane.row0) * pixel_um,
        plane.value,
        plane.slope_right / pixel_um,
        -plane.slope_down / pixel_um,
        information,
        plane.n_pixels,
        plane.rms,
    )


def _table(pairs: NDArray[np.int32], found: Sequence[Seam]) -> HeightOffsets:
    def column(name: str) -> Numbers:
        return np.array([getattr(seam, name) for seam in found], np.float64)

    n_pixels = column("n_pixels").astype(np.int32)
    return HeightOffsets(
        first=np.array(pairs[:, 0], np.int32),
        second=np.array(pairs[:, 1], np.int32),
        mid_x_um=column("mid_x_um"),
        mid_y_um=column("mid_y_um"),
        z_um=column("z_um"),
        slope_x=column("slope_x"),
        slope_y=column("slope_y"),
        information=np.array([seam.information for seam in found], np.float64).reshape(-1, 3, 3),
        n_pixels=n_pixels,
        weight=(n_pixels > 0).astype(np.float32),
        step_um=np.where(n_pixels > 0, column("z_um"), np.nan),
        rms_um=column("rms_um"),
    )
