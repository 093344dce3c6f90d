"""Levels of a surface without dies, such as die tops and streets, each at its own height over one form. Pure.

A polynomial alone cannot represent a surface with two levels: either all of one level is a defect, or none is. The form
is fitted together with an offset for each level, and every pixel is compared with its own level.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.robust_fit import robust_fit
from wafer_viewer.measure.dies.die_cells import CellSource, Plane, form_powers, sample_of
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.region import Point
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA


@dataclass(frozen=True, slots=True)
class TerraceParameters:
    """Limits of the search for the levels of a surface.

    Parameters
    ----------
    bins : int
        Number of bins of the histogram of heights over the form.
    percentiles : tuple[float, float]
        Percentiles of those heights between which the histogram lies.
    least_share : float
        Smallest fraction of the measured pixels of a level; fewer are defects or lie between two levels.
    valley : float
        Largest histogram count between two levels, relative to the lower of their maxima.
    apart_sigma : float
        Smallest separation of levels, in their own deviations.
    most_levels : int
        Largest number of levels; with more, a surface counts as one.
    island_px : int, px
        Smallest area of a patch of a level; a smaller patch at another level is a defect.
    wall_px : int, px
        Distance from a wall between levels that is not compared: focus errors occur there, and edges are
        bevelled.
    rounds : int
        Number of fits of the form with an offset for each level.
    """

    bins: int = 200
    percentiles: tuple[float, float] = (0.5, 99.5)
    least_share: float = 0.05
    valley: float = 0.25
    apart_sigma: float = 8.0
    most_levels: int = 6
    island_px: int = 2500
    wall_px: int = 12
    rounds: int = 2


TERRACES = TerraceParameters()
SEVERAL_LEVELS = "The surface has {} levels, each compared with its own height; {} px beside walls were left out."
Labels = NDArray[np.intp]
Mask = NDArray[np.bool_]


def terraced(source: CellSource, order: int) -> CellSource:
    """Return the source over the form of its levels; unchanged if it has one level only."""
    points, _ = sample_of(source.surface, source.layer)
    powers, center = form_powers(order), source.form.center
    u, v = points.x_um - center.x_um, points.y_um - center.y_um
    terms = np.stack([u**i * v**j for i, j in powers], axis=1)
    left = points.z_um - source.form.at(points.x_um, points.y_um)
    levels_um = levels_of(left)
    for _ in range(TERRACES.rounds if len(levels_um) > 1 else 0):
        on = nearest(left, levels_um)
        offsets = (on[:, None] == np.arange(1, len(levels_um))).astype(float)
        try:
            found = robust_fit(np.concatenate([terms, offsets], axis=1), points.z_um).coefficients
        except MeasureError:
            break
        left = points.z_um - terms @ found[: len(powers)]
        levels_um = levels_of(left)
        point = Point(x_um=center.x_um, y_um=center.y_um)
        datum = Datum(center=point, powers=powers, coefficients=tuple(found[: len(powers)].tolist()))
        source = replace(source, form=datum, levels_um=levels_um)
    return source


def levels_of(left_um: Floats) -> tuple[float, ...]:
    """Return the modal heights of a surface, ascending; the median alone if no levels are clearly separate."""
    from scipy.signal import find_peaks, peak_prominences

    low, high = np.percentile(left_um, TERRACES.percentiles)
    middle = (float(np.median(left_um)),)
    if not high > low:
        return middle
    counts, edges = np.histogram(left_um, TERRACES.bins, (low, high))
    smooth = np.pad(np.convolve(counts, np.ones(3) / 3, "same"), 1)
    tops, _ = find_peaks(smooth)
    tops = tops[peak_prominences(smooth, tops)[0] >= (1 - TERRACES.valley) * smooth[tops]] - 1
    borders = [a + int(np.argmin(counts[a : b + 1])) for a, b in itertools.pairwise(tops.tolist())]
    parts = np.split(np.sort(left_um), np.searchsorted(np.sort(left_um), edges[borders]))
    parts = [part for part in parts if len(part) >= TERRACES.least_share * len(left_um)]
    levels = [float(np.median(part)) for part in parts]
    sigmas = [MAD_TO_SIGMA * float(np.median(np.abs(part - level))) for part, level in zip(parts, levels, strict=True)]
    pairs = itertools.pairwise(zip(levels, sigmas, strict=True))
    apart = all(b - a > TERRACES.apart_sigma * max(s, t) for (a, s), (b, t) in pairs)
    return tuple(levels) if apart and 1 < len(levels) <= TERRACES.most_levels else middle


def nearest(z_um: NDArray[np.floating], levels_um: tuple[float, ...]) -> Labels:
    """Return the index of the level nearest to each height."""
    borders = (np.array(levels_um[:-1]) + np.array(levels_um[1:])) / 2
    return np.searchsorted(borders, z_um)


def over_levels(z_um: Plane, levels_um: tuple[float, ...]) -> tuple[Plane, Mask | None]:
    """Return the heights over each pixel's level, and the mask of pixels at a wall between two levels.

    The heights unchanged, and None, if there is one level only.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

    if len(levels_um) < 2:
        return z_um, None
    finite = np.isfinite(z_um)
    if not finite.any():
        return z_um, None
    index: Any = distance_transform_edt(~finite, return_distances=False, return_indices=True)
    on = _without_islands(nearest(z_um[tuple(index)], levels_um), len(levels_um)).astype(np.uint8)
    side = 2 * TERRACES.wall_px + 1
    walls = maximum_filter(on, side) != minimum_filter(on, side)
    return z_um - np.array(levels_um, np.float32)[on], walls


def _without_islands(on: Labels, n: int) -> Labels:
    """Assign small patches to the most frequent level around them."""
    from scipy.ndimage import binary_dilation, find_objects, label

    out = on.copy()
    for level in range(n):
        patches = np.zeros(on.shape, np.int32)
        label(on == level, np.ones((3, 3), int), output=patches)
        small = np.bincount(patches.ravel()) < TERRACES.island_px
        for k, box in enumerate(find_objects(patches), 1):
            if not small[k]:
                continue
            rows, cols = (slice(max(0, side.start - 2), side.stop + 2) for side in box)
            inside = patches[rows, cols] == k
            ring = on[rows, cols][binary_dilation(inside, np.ones((3, 3), bool), 2) & ~inside]
            if ring.size:
                out[rows, cols][inside] = int(np.bincount(ring).argmax())
    return out
