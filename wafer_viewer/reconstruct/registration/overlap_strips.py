"""Pairs of fields with sufficient overlap, and the overlap regions of two fields."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap, Origin, Outline
from wafer_viewer.numerics.filters.gaussian import binned
from wafer_viewer.numerics.normal_statistics import HALF_NORMAL_MEDIAN, median
from wafer_viewer.numerics.subpixel_registration import RegisteredImage

Read = Callable[[HeightMap, slice, slice], RegisteredImage]
"""Function that reads the compared image of a field from a range of rows and columns."""

_SEEN = np.array([origin not in (Origin.NOT_COVERED, Origin.TOO_FEW_FRAMES) for origin in range(256)], np.float32)
"""Whether a pixel of an origin counts: the image repeats its border where a drifting field was not covered in all
frames."""
_PERCENT = np.float32(100)
"""Unit of the logarithm of grey: a difference of 1 is one percent of the light."""
_DARKEST = 0.015
"""Grey below this part of the brightest is cut off: its logarithm would be that of noise."""
_FOCUS_NOISE = 1e3
"""Height errors are correlated over a focus window instead of varying per pixel, so contrast alone counts."""
_AROUND_PX = 31
"""Side of the square whose mean height is subtracted, in pixels."""
_ENOUGH = 20000
"""Approximate number of pixels from which the noise of an image is estimated."""
_STEEPEST = 6.0
"""Limit at which heights are clipped, in medians of their absolute values."""


@dataclass(frozen=True, slots=True)
class OverlapWindow:
    """Rows and columns of both fields to be compared, and the lag between them.

    lag: pixel (r, c) of the second's part lies at (r + lag row, c + lag col) of the first's by the stage, except for
    `part` of a pixel. common: rows and columns of both in the nominal overlap.
    """

    first: tuple[slice, slice]
    second: tuple[slice, slice]
    lag: tuple[int, int]
    part: tuple[float, float]
    common: tuple[tuple[slice, slice], tuple[slice, slice]]

    @property
    def overlap(self) -> tuple[int, int]:
        """Rows and columns of the nominal overlap; 0 or less where there is none."""
        rows, cols = self.common[0]
        return rows.stop - rows.start, cols.stop - cols.start

    @property
    def nominal(self) -> tuple[float, float]:
        """Lag by the stage."""
        return self.lag[0] + self.part[0], self.lag[1] + self.part[1]

    @classmethod
    def of(cls, first: HeightMap, second: HeightMap, reach: int, step: int) -> OverlapWindow:
        """Return the possible overlap for a stage error of up to `reach` pixels; lags are multiples of `step`."""
        down = (first.y0_um - second.y0_um) / first.pixel_um
        right = (second.x0_um - first.x0_um) / first.pixel_um
        rows = _part(first.shape[0], second.shape[0], down, reach, step)
        cols = _part(first.shape[1], second.shape[1], right, reach, step)
        both = (rows.first, cols.first), (rows.second, cols.second)
        common = (rows.common, cols.common), (rows.common_of_second, cols.common_of_second)
        return cls(*both, (rows.lag, cols.lag), (rows.part, cols.part), common)


class _Part(NamedTuple):
    """`OverlapWindow` along one axis."""

    first: slice
    second: slice
    lag: int
    part: float
    common: slice
    common_of_second: slice


def _part(first: int, second: int, offset: float, reach: int, step: int) -> _Part:
    nearest = round(offset)
    start, stop = max(0, nearest - reach), min(first, nearest + second + reach)
    other, other_stop = max(0, -nearest - reach), min(second, first - nearest + reach)
    other += (start - nearest - other) % step
    common = slice(max(0, nearest), min(first, nearest + second))
    of_second = slice(common.start - nearest, common.stop - nearest)
    lag = nearest + other - start
    return _Part(slice(start, stop), slice(other, other_stop), lag, offset - nearest, common, of_second)


def picture_of(height: HeightMap, rows: slice, cols: slice) -> RegisteredImage:
    """Return the logarithm of the all-in-focus image, in hundredths, so that light only adds a smooth plane to it."""
    grey = _logarithm(np.asarray(height.all_in_focus[rows, cols]))
    grey -= np.float32(grey[::7, ::7].mean(dtype=np.float64))
    return RegisteredImage(grey, _SEEN[np.asarray(height.origin[rows, cols])], _noise(grey))


def _logarithm(grey: NDArray[Any]) -> NDArray[np.float32]:
    """Return the logarithm of grey in hundredths; of 8 bits from a table."""
    darkest = np.float32(max(1.0, _DARKEST * float(grey[::7, ::7].max(initial=0))))
    if grey.dtype == np.uint8:
        return (_PERCENT * np.log(np.maximum(np.arange(256, dtype=np.float32), darkest)))[grey]
    return np.asarray(_PERCENT * np.log(np.maximum(grey.astype(np.float32), darkest)), np.float32)


def _noise(plane: NDArray[np.float32]) -> float:
    """Return the standard deviation of pixel noise; fine texture increases it.

    Source: J. Immerkaer, Fast noise variance estimation, Comput. Vis. Image Underst. 64 (1996) 300; here by a median.
    """
    stride = max(3, plane.size // _ENOUGH)
    some = plane[: len(plane) - 2 : stride], plane[1 : len(plane) - 1 : stride], plane[2::stride]
    down = some[0] - 2 * some[1] + some[2]
    curved = down[:, 2:] - 2 * down[:, 1:-1] + down[:, :-2]
    return median(np.abs(curved)) / (HALF_NORMAL_MEDIAN * 6) if curved.size else 0.0


def height_of(height: HeightMap, rows: slice, cols: slice) -> RegisteredImage:
    """Return the high-pass filtered measured heights with clipped outliers; 0 where nothing is measured nearby."""
    from wafer_viewer.numerics.filters.sliding_filters import mean, mean_of_valid

    z = np.asarray(height.z_raw_um[rows, cols])
    valid = np.isfinite(z)
    if not valid.any():
        return RegisteredImage(np.zeros(z.shape, np.float32), valid.astype(np.float32), _FOCUS_NOISE)
    z = np.where(valid, z - np.float32(np.median(z[valid][::5])), np.float32(0))
    usual = _STEEPEST * float(np.median(np.abs(z[valid][::5]))) + 1e-6
    around = mean_of_valid(z.clip(-usual, usual), valid, _AROUND_PX)
    detail = np.where(valid, z - around, np.float32(0))
    usual = _STEEPEST * float(np.median(np.abs(detail[valid][::5]))) + 1e-6
    detail = detail.clip(-usual, usual)
    near = mean(detail, 3) / np.maximum(mean(valid, 3), np.float32(0.1))
    return RegisteredImage(np.where(valid, detail, near), valid.astype(np.float32), _FOCUS_NOISE)


def binned_valid(picture: RegisteredImage, factor: int) -> RegisteredImage:
    """Return means of the known ones of factor x factor pixels; known where at least half of them are."""
    if factor == 1:
        return picture
    if picture.valid.all():
        total = binned(picture.values, factor) * np.float32(factor**-2)
        return RegisteredImage(total, np.ones_like(total), picture.noise / factor)
    total, valid = binned(picture.values * picture.valid, factor), binned(picture.valid, factor)
    mean = np.divide(total, valid, out=np.zeros_like(total), where=valid > 0)
    return RegisteredImage(mean, (valid >= 0.5 * factor**2).astype(np.float32), picture.noise / factor)


LEAST_SIDE_FRACTION = 0.5
"""Minimum shared fraction of a side; corner overlaps have little to compare and others are more informative."""
LEAST_WIDTH_PX = 12.0
"""A narrower overlap vanishes when the stage is off by a typical error."""

Numbers = NDArray[np.float64]


def neighbours(outlines: Sequence[Outline]) -> NDArray[np.int32]:
    """Return the pairs of fields with sufficient overlap, int32 [n, 2] indices with first < second.

    They share at least half of a side (of the shorter one where they differ), along an overlap of at least 12 px.
    Candidates, whose centres are closer to each other than the width and height of the largest field, are found by a
    k-d tree, so that a million fields take seconds. The pairs are sorted.
    """
    low, high, pixel_um = _boxes(outlines)
    pairs = _near(low, high)
    first, second = pairs[:, 0], pairs[:, 1]
    shared = np.minimum(high[first], high[second]) - np.maximum(low[first], low[second])
    side = np.minimum(high[first] - low[first], high[second] - low[second])
    adjacent = (shared >= LEAST_SIDE_FRACTION * side).any(axis=1)
    enough = (shared >= LEAST_WIDTH_PX * pixel_um[first, None]).all(axis=1)
    overlapping = pairs[adjacent & enough]
    return overlapping[np.lexsort((overlapping[:, 1], overlapping[:, 0]))].astype(np.int32)


def _boxes(outlines: Sequence[Outline]) -> tuple[Numbers, Numbers, Numbers]:
    """Return the low and high corners (x, y) of all fields, [n, 2], including border pixels, and pixel sizes."""
    table = np.array([(o.x0_um, o.y0_um, o.pixel_um, *o.shape) for o in outlines], np.float64).reshape(-1, 5)
    x0, y0, pixel, rows, cols = table.T
    low = np.stack([x0 - pixel / 2, y0 - (rows - 0.5) * pixel], axis=1)
    high = np.stack([x0 + (cols - 0.5) * pixel, y0 + pixel / 2], axis=1)
    return low, high, pixel


def _near(low: Numbers, high: Numbers) -> NDArray[np.intp]:
    """Return the pairs whose boxes may overlap, [n, 2], first < second."""
    from scipy.spatial import KDTree

    if len(low) < 2:
        return np.zeros((0, 2), np.intp)
    largest = (high - low).max(axis=0)
    tree = KDTree((low + high) / (2 * largest), balanced_tree=False, compact_nodes=False)
    pairs: NDArray[np.intp] = tree.query_pairs(1.0, p=np.inf, output_type="ndarray")
    return np.sort(pairs, axis=1)
