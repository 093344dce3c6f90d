"""Steps of a grid of fields whose overlap was assumed, estimated from the images of neighbours.

Opposite halves of neighbours are correlated at every overlap from 2 to 50 %, at a low resolution. All pairs along one
direction have the same step, apart from errors of the stage: their correlations are added, each taken at its largest
nearby. A step is believed only if it stands out against all others; where a pattern repeats, or shows only lines, none
does. The exact positions are found by registration, which begins at these steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.registration.overlap_strips import binned_valid, picture_of

Cell = tuple[int, int]
"""Row and column of a field in its grid."""
Step = tuple[int, int]
"""Distance between neighbours, in whole pixels down and to the right."""
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StepSearchParameters:
    """Limits of the search for the steps of a grid.

    Parameters
    ----------
    least_overlap : float
        Smallest overlap that is searched, as a fraction of a field.
    most_overlap : float
        Largest overlap that is searched, as a fraction of a field.
    sideways : float
        Largest displacement across the step, as a fraction of a field.
    side : int, search pixels
        Smallest side of the halves that are correlated, which sets the binning.
    most_pairs : int
        Largest number of pairs along one direction.
    around : int, search pixels
        Side of the square whose mean is subtracted before images are correlated.
    stage_px : float, px
        Displacement of pairs against each other up to which their correlations count together.
    sideways_px : float, px
        The same of small fields.
    least_sigmas : float
        Smallest excess of the best step over the median of all, in their scatter.
    most_rival : float
        Largest excess of another step, relative to the best.

    Notes
    -----
    Set on 299 drawn grids of seeds below 400 with overlaps of 2 to 48 %: random ground had 30 sigmas and more and a
    rival of at most 0.11, dies and lines with a wrong step as many but a rival of 0.25, or 13 sigmas and 0.12.
    """

    least_overlap: float = 0.02
    most_overlap: float = 0.5
    sideways: float = 0.1
    side: int = 96
    most_pairs: int = 16
    around: int = 11
    stage_px: float = 12.0
    sideways_px: float = 40.0
    least_sigmas: float = 20.0
    most_rival: float = 0.18


STEP_SEARCH = StepSearchParameters()


@dataclass(frozen=True, slots=True)
class GridSteps:
    """Steps of a regular grid of fields to the next column and to the next row."""

    next_col: Step
    next_row: Step

    @classmethod
    def of(cls, next_col: Step | None, next_row: Step | None, shape: tuple[int, int]) -> GridSteps | None:
        """Return the steps of a grid of fields of a shape; an unknown one has the overlap of the other, if known."""
        rows, cols = shape
        if next_col is None and next_row is None:
            return None
        if next_col is None and next_row is not None:
            next_col = 0, round(next_row[0] / rows * cols)
        if next_row is None and next_col is not None:
            next_row = round(next_col[1] / cols * rows), 0
        return None if next_col is None or next_row is None else cls(next_col, next_row)

    @classmethod
    def between(cls, cells: Sequence[Cell], at_px: Floats, shape: tuple[int, int]) -> GridSteps | None:
        """Return the steps of fields in cells at (down, right) `at_px`, [n, 2]; None for a single field."""
        row, col = (
            (round(down), round(right)) if np.isfinite(down) else None
            for down, right in mean_steps(cells, at_px).tolist()
        )
        return cls.of(col, row, shape)

    def at_px(self, cell: Cell) -> tuple[int, int]:
        """Return the place (down, right) of a cell from that of row 0, column 0."""
        (row, col), (a, b), (c, d) = cell, self.next_row, self.next_col
        return row * a + col * c, row * b + col * d

    def is_near(self, other: GridSteps, px: int) -> bool:
        """Return whether no component differs by more than some pixels."""
        pairs = zip((*self.next_col, *self.next_row), (*other.next_col, *other.next_row), strict=True)
        return all(abs(a - b) <= px for a, b in pairs)


def mean_steps(cells: Sequence[Cell], at_px: Floats) -> Floats:
    """Return the mean step (down, right) to the next row and to the next column, [2, 2], of fields at `at_px`, [n, 2].

    NaN where all fields are in one row or in one column.
    """
    arm = np.asarray(cells, np.float64).reshape(-1, 2)
    arm, off = arm - arm.mean(axis=0), at_px - at_px.mean(axis=0)
    steps = np.linalg.lstsq(arm, off, rcond=None)[0]
    return np.where(np.ptp(arm, axis=0)[:, None] > 0, steps, np.nan)


def find_steps(cells: Sequence[Cell], opened: Callable[[int], HeightMap]) -> GridSteps | None:
    """Estimate the steps of a grid from the images of some neighbours; None where these do not tell.

    Parameters
    ----------
    cells : sequence of (row, column)
        Cells of the fields; row 0 is at the top, column 0 to the left.
    opened : callable
        Returns the height map of a field by its index, all of one shape.
    """
    next_col, next_row = (_step(_neighbours(cells, axis), opened, axis) for axis in (1, 0))
    return GridSteps.of(next_col, next_row, opened(0).shape)


def _neighbours(cells: Sequence[Cell], axis: int) -> list[tuple[int, int]]:
    """Return the indices of some pairs of neighbours along an axis, from all over the grid."""
    index = {cell: n for n, cell in enumerate(cells)}
    nexts = (((row + (axis == 0), col + (axis == 1)), n) for (row, col), n in index.items())
    pairs = [(n, index[cell]) for cell, n in nexts if cell in index]
    some = np.linspace(0, len(pairs) - 1, min(len(pairs), STEP_SEARCH.most_pairs))
    return [pairs[n] for n in some.astype(int).tolist()]


class _Sigmas(NamedTuple):
    """Significance of the correlation of a pair, [across, overlap], and the search pixels of its rows and columns."""

    values: NDArray[np.float32]
    across: NDArray[np.intp]
    overlap: NDArray[np.intp]


def _step(pairs: Sequence[tuple[int, int]], opened: Callable[[int], HeightMap], axis: int) -> Step | None:
    """Return the step along an axis on which pairs of neighbours agree, if it stands out."""
    from wafer_viewer.numerics.filters.sliding_filters import highest

    if not pairs:
        return None
    shape = opened(pairs[0][0]).shape
    factor = max(1, min(shape) // 2 // STEP_SEARCH.side)
    near = max(1, round(STEP_SEARCH.stage_px / factor))
    found = [_sigmas(opened(one), opened(other), axis, factor) for one, other in pairs]
    most = np.float32(np.median([one.values.max() for one in found]))
    total = np.sum([highest(np.minimum(one.values, most), 2 * near + 1) for one in found], axis=0)
    at = round(float(np.nonzero(total >= 0.98 * total.max())[1].mean()))
    elsewhere = total[:, np.abs(np.arange(total.shape[1]) - at) > 3 * near]
    if not elsewhere.size:
        return None
    middle = float(np.median(elsewhere))
    scatter, rival = MAD_TO_SIGMA * float(np.median(np.abs(elsewhere - middle))), float(elsewhere.max()) - middle
    best = float(total.max()) - middle
    if best < STEP_SEARCH.least_sigmas * scatter or rival > STEP_SEARCH.most_rival * best:
        return None
    sideways, overlap = (factor * np.median([_best(one, at, 2 * near) for one in found], axis=0)).tolist()
    along = round(shape[axis] - overlap)
    return (along, round(sideways)) if axis == 0 else (round(sideways), along)


def _best(found: _Sigmas, at: int, reach: int) -> tuple[int, int]:
    """Return the displacement across and the overlap of the best match of a pair near a column, in search pixels."""
    cols = slice(max(0, at - reach), at + reach + 1)
    row, col = np.unravel_index(int(found.values[:, cols].argmax()), found.values[:, cols].shape)
    return int(found.across[row]), int(found.overlap[cols][col])


def _sigmas(first: HeightMap, second: HeightMap, axis: int, factor: int) -> _Sigmas:
    """Correlate the half of a field with the opposite one of its neighbour at all overlaps."""
    size, other = first.shape[axis], first.shape[1 - axis]
    ends = slice(size - size // 2, size), slice(0, size // 2)
    parts = [(end, slice(None)) if axis == 0 else (slice(None), end) for end in ends]
    pictures = [binned_valid(picture_of(h, *part), factor) for h, part in zip((first, second), parts, strict=True)]
    valids = [picture.valid > 0 for picture in pictures]
    one, two = (contrast(p.values, known, STEP_SEARCH.around) for p, known in zip(pictures, valids, strict=True))
    half = one.shape[axis]
    lag, reach = half // 2, half // 2 + 1
    likeness = normalised_cross_correlation(one, valids[0], two, valids[1], (lag, 0) if axis == 0 else (0, lag), reach)
    off = np.arange(-reach, reach + 1)
    overlap = half - lag - off
    limits = (STEP_SEARCH.least_overlap * size / factor - 1, STEP_SEARCH.most_overlap * size / factor)
    searched = (overlap >= limits[0]) & (overlap <= limits[1])
    straight = np.abs(off) <= max(STEP_SEARCH.sideways * other, STEP_SEARCH.sideways_px) / factor
    sigmas = likeness.sigmas if axis == 1 else likeness.sigmas.T
    return _Sigmas(sigmas[straight][:, searched].astype(np.float32), off[straight], overlap[searched])
