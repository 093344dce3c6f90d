"""State of the dies of a lattice: whole, cut, partly scanned, not scanned or missing. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, layer_of, pictured_window
from wafer_viewer.measure.base.robust_fit import least_squares
from wafer_viewer.measure.dies.lattice_evidence import CellLattice, bounds_of, coarse_level, median_of
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, DieState, DieStatus
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic, Origin
from wafer_viewer.numerics.jit import Float32s


@dataclass(frozen=True, slots=True)
class DieStatusParameters:
    """Limits of the states of dies.

    Parameters
    ----------
    die_px : int, px
        Approximate number of pixels of the shorter pitch at the level that is read.
    places : int
        Sample points along the longer side of a cell.
    window_pixels : int, px
        Largest number of pixels read at once; it bounds the memory.
    median_of : int
        Approximate largest number of dies for the median die.
    all_scanned : float
        Fraction of a die's sample points from which it counts as completely scanned.
    least_measured : float
        Smallest measured fraction of a whole die, and of a cell for the median die.
    least_similarity : float
        Smallest correlation with the median die, relative to the typical one, of a place that holds a die. A
        typical correlation below half of this number is no pattern.
    as_clear : float
        Smallest typical correlation of a layer relative to the better layer, for its use.
    half_similarity : float
        Smallest correlation of an entire cell for a whole die, relative to the typical one.
    least_judged : float
        Smallest known fraction of a cell for a decision whether a die is present.
    cut_off : float
        Excess fraction of deviating sample points from which a die at the rim of the lattice is cut.
    least_form_points : int
        Smallest number of known sample points for a form, which is then subtracted.
    most_form_points : int
        Approximate largest number of sample points to which the form is fitted.
    contrast_percentiles : tuple[float, float]
        Percentiles of the median die between which its contrast lies.
    differs_by : float
        Deviation from the median die, in contrasts, from which a sample point deviates.
    usual_percentile : float
        Percentile of the correlation of well-known cells that is taken as typical.

    Notes
    -----
    `tests/bench/bench_defects_truth.py` inspects wafers of the virtual optics with these values.
    """

    die_px: int = 200
    places: int = 32
    window_pixels: int = 4_000_000
    median_of: int = 200
    all_scanned: float = 0.998
    least_measured: float = 0.5
    least_similarity: float = 0.6
    as_clear: float = 0.7
    half_similarity: float = 0.4
    least_judged: float = 0.1
    cut_off: float = 0.1
    least_form_points: int = 100
    most_form_points: int = 100_000
    contrast_percentiles: tuple[float, float] = (95, 5)
    differs_by: float = 0.5
    usual_percentile: float = 75


STATUS = DieStatusParameters()
BESIDE_CORNER = 2
"""Number of dies beside a corner of an array."""
Places = Sequence[tuple[int, int]]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class DieCoverage:
    """Cells of n dies: layers [n, row, col], NaN where unknown, and mask of scanned points, bool."""

    layers: tuple[Float32s, ...]
    scanned: Bools
    x_um: Floats
    y_um: Floats


def statuses(surface: Mosaic, grid: DieGrid) -> tuple[DieStatus, ...]:
    """Return the state of every die of a lattice.

    The surface is read by rows of dies, at the level with a pitch of about 200 px.

    Parameters
    ----------
    surface : Mosaic
        The surface; heights are read from the layer that its recipe measures on.
    grid : DieGrid
        The lattice of dies, in stage um.

    Returns
    -------
    tuple of DieStatus
        One status for each place of the lattice, row by row from the lowest; places in `left_out` have none.
        `measured_fraction` (0 to 1) is taken over the sample points of the die, without its street, at the level that
        is read; points beyond the surface count as unmeasured.

    Raises
    ------
    MeasureError
        If no die of the lattice lies on the surface.

    Notes
    -----
    The first of these states that applies is given:

    - not scanned: no sample point of the die is scanned;
    - missing: the place is scanned but not like the median die, in height or image. Without a pattern to compare, every
      place is taken to hold a die, as is a place of which less than a tenth is known;
    - cut: the die extends beyond the border of the surface by more than half a pixel;
    - partly scanned: less than 99.8 % of the die is scanned, or less than half of it is measured, unless the latter is
      due to a cut;
    - cut: the die is next to a place without a die, as at the rim of a wafer, and by over a tenth of its area more than
      usual deviates from the median die;
    - whole.
    """
    places = grid.places
    lattice = CellLattice.of(grid, max(grid.pitch_x_um, grid.pitch_y_um) / STATUS.places)
    coverage = _coverage(surface, grid, places, lattice)
    if not coverage.scanned.any():
        raise MeasureError("No die of the lattice lies on the surface: give an origin and a pitch that fit it.")
    on_die = _on_die(grid, lattice)
    scanned = coverage.scanned[:, on_die].mean(axis=1)
    measured = np.isfinite(coverage.layers[0][:, on_die]).mean(axis=1)
    shows_die, cut_off = _examined(coverage, on_die)
    beyond = _beyond(surface, grid, places)
    states = _states(places, scanned, measured, shows_die, cut_off, beyond)
    return tuple(
        DieStatus(name=grid.name(*die), col=die[0], row=die[1], state=state, measured_fraction=float(share))
        for die, state, share in zip(places, states, measured, strict=True)
    )


def without_bare_rim(surface: Mosaic, grid: DieGrid, dies: Sequence[DieStatus]) -> DieGrid:
    """Return the lattice without empty places connected to its rim, as around the dies of a round wafer.

    A missing die among others stays in, and so does every place of a lattice that names its dies. At the rim a place
    misses a die if it lies wholly on the surface, and between dies of its row or column or at the only open corner of
    the array. The content of slivers at the border of the surface is unknown: next to an empty place they are taken as
    empty.
    """
    if grid.named:
        return grid
    places = {(die.col, die.row): die.state for die in dies}
    empty = {place for place, state in places.items() if state in ("missing", "not scanned")}
    waiting = [place for place in empty if not places.keys() >= set(_adjacent(place))]
    rim = set(waiting)
    while waiting:
        met = (empty - rim).intersection(_adjacent(waiting.pop()))
        rim |= met
        waiting.extend(met)
    bare = {place for place in rim if places[place] == "missing"} - _missed(surface, grid, places)
    slivers = {(die.col, die.row) for die in dies if die.state == "cut" and die.measured_fraction < STATUS.least_judged}
    bare |= {place for place in slivers if bare.intersection(_adjacent(place))}
    return replace(grid, left_out=(*grid.left_out, *sorted(grid.name(*place) for place in bare)))


def _missed(surface: Mosaic, grid: DieGrid, places: Mapping[tuple[int, int], str]) -> set[tuple[int, int]]:
    """Return the places on the surface where the array of dies has a gap: it is convex along rows and columns."""
    present = {place for place, state in places.items() if state in ("whole", "cut", "partly scanned")}
    empty = [place for place, state in places.items() if state == "missing"]
    if not present or not empty:
        return set()
    lowest, highest = np.min(list(present), axis=0).tolist(), np.max(list(present), axis=0).tolist()
    corners = {(col, row) for col in (lowest[0], highest[0]) for row in (lowest[1], highest[1])}
    open_corners = corners - present
    beyond = _beyond(surface, grid, empty)
    return {
        (col, row)
        for (col, row), off in zip(empty, beyond, strict=True)
        if not off
        and (
            _between(col, [c for c, r in present if r == row])
            or _between(row, [r for c, r in present if c == col])
            or (open_corners == {(col, row)} and len(present.intersection(_adjacent((col, row)))) == BESIDE_CORNER)
        )
    }


def _between(value: int, others: Sequence[int]) -> bool:
    return bool(others) and min(others) < value < max(others)


def _adjacent(die: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    col, row = die
    return (col - 1, row), (col + 1, row), (col, row - 1), (col, row + 1)


def not_scanned_mm2(surface: Mosaic) -> float:
    """Return the area of the surface's rectangle that no field covers, at a level of about a million pixels."""
    rows, cols = surface.shape
    share = float((surface.window(None, coarse_level(surface)).origin == Origin.NOT_COVERED).mean())
    return share * rows * cols * (surface.pixel_um / 1000) ** 2


def _coverage(surface: Mosaic, grid: DieGrid, places: Places, lattice: CellLattice) -> DieCoverage:
    shorter_px = min(grid.pitch_x_um, grid.pitch_y_um) / surface.pixel_um
    level = min(surface.levels - 1, max(0, math.floor(math.log2(max(1.0, shorter_px / STATUS.die_px)))))
    parts = [_piece(surface, grid, piece, lattice, level) for piece in _pieces(surface, grid, places, level)]
    layers = tuple(np.concatenate([part.layers[k] for part in parts]) for k in range(2))
    rest = (np.concatenate([getattr(part, name) for part in parts]) for name in ("scanned", "x_um", "y_um"))
    return DieCoverage(layers, *rest)


def _pieces(surface: Mosaic, grid: DieGrid, places: Places, level: int) -> Iterator[Places]:
    """Yield adjacent dies of a row, as many as a window holds."""
    pixel_um = surface.pixel_um * 2**level
    width_px, height_px = grid.pitch_x_um / pixel_um, grid.pitch_y_um / pixel_um
    rise = abs(math.tan(grid.angle_rad))
    most = max(1, math.floor(STATUS.window_pixels / (width_px * (height_px + rise * grid.cols * width_px))))
    for row in range(grid.first_row, grid.first_row + grid.rows):
        of_row = [at for at in places if at[1] == row]
        for first in range(0, len(of_row), most):
            yield of_row[first : first + most]


def _piece(surface: Mosaic, grid: DieGrid, places: Places, lattice: CellLattice, level: int) -> DieCoverage:
    cells = np.array(places)[:, :, None, None]
    x_um, y_um = grid.to_stage(cells[:, 0], cells[:, 1], *lattice.places(grid))
    low_x, low_y, high_x, high_y = bounds_of(surface)
    inside = (x_um >= low_x) & (x_um <= high_x) & (y_um >= low_y) & (y_um <= high_y)
    if not inside.any():
        unknown = np.full(inside.shape, np.nan, np.float32)
        return DieCoverage((unknown, unknown), inside, x_um, y_um)
    box = Region.rectangle(x_um[inside].min(), y_um[inside].min(), x_um[inside].max(), y_um[inside].max())
    part = pictured_window(surface, layer_of(surface.provenance.recipe, None), box, level)
    rows = np.rint((part.y0_um - y_um) / part.pixel_um).astype(np.intp).clip(0, part.z_um.shape[0] - 1)
    cols = np.rint((x_um - part.x0_um) / part.pixel_um).astype(np.intp).clip(0, part.z_um.shape[1] - 1)
    z_um, picture = (np.where(inside, layer[rows, cols], np.float32(np.nan)) for layer in (part.z_um, part.picture))
    return DieCoverage((z_um, picture), np.isfinite(picture), x_um, y_um)


def _on_die(grid: DieGrid, lattice: CellLattice) -> Bools:
    """Return the mask of the sample points of a cell that lie on the die."""
    u_um, v_um = lattice.places(grid)
    return (u_um >= 0) & (u_um <= grid.width_um) & (v_um >= 0) & (v_um <= grid.height_um)


def _examined(coverage: DieCoverage, on_die: Bools) -> tuple[Bools, Floats]:
    """Return which places hold a die, and each place's excess fraction of deviation from the median die.

    A die is present where the layers with good contrast correlate with the median one, on average. The deviation is
    that of the best layer. Without a pattern every place is taken to hold a die.
    """
    levelled = _without_form(coverage)
    compared = [_compared(layer, on_die) for layer in (levelled, coverage.layers[1])]
    best = max(compared, key=lambda one: one[2])
    if best[2] < STATUS.least_similarity / 2:
        return np.ones(len(best[0]), bool), np.zeros(len(best[0]))
    clear = [one[0] / one[2] for one in compared if one[2] >= STATUS.as_clear * best[2]]
    finite = np.maximum(*(np.isfinite(layer).mean(axis=(1, 2)) for layer in coverage.layers))
    shows_die = (np.mean(clear, axis=0) >= STATUS.least_similarity) | (finite < STATUS.least_judged)
    return shows_die, best[1] - np.median(best[1][shows_die] if shows_die.any() else best[1])


def _without_form(coverage: DieCoverage) -> Float32s:
    """Subtract tilt and bow from the heights."""
    z_um = coverage.layers[0]
    finite = np.isfinite(z_um)
    if finite.sum() < STATUS.least_form_points:
        return z_um
    x_um, y_um = ((a - a.mean()) / max(float(np.ptp(a)), 1.0) for a in (coverage.x_um, coverage.y_um))
    powers = np.stack([np.ones_like(x_um), x_um, y_um, x_um**2, x_um * y_um, y_um**2], axis=-1)
    some = powers[finite], z_um[finite].astype(np.float64)
    step = max(1, len(some[1]) // STATUS.most_form_points)
    form = powers @ least_squares(some[0][::step], some[1][::step])
    return (z_um - form).astype(np.float32)


def _compared(layer: Float32s, on_die: Bools) -> tuple[Floats, Floats, float]:
    """Return correlation with the median cell or half of it, deviating fraction, [n] each, and typical correlation."""
    middle = np.array([float(np.median(one[np.isfinite(one)])) if np.isfinite(one).any() else 0.0 for one in layer])
    cells = layer - middle[:, None, None].astype(np.float32)
    some = [one for one in cells if np.isfinite(one).mean() > STATUS.least_measured] or list(cells)
    median = median_of(np.stack(some[:: max(1, len(some) // STATUS.median_of)]))
    n_valid = (np.isfinite(cells) & np.isfinite(median)).sum(axis=(1, 2))
    each = np.array([_alike(cells[:, rows, cols], median[rows, cols]) for rows, cols in _parts(median.shape)])
    usual = _usual(each[0], n_valid)
    # A place that matches the median die in only one half is not a complete die, whatever its levels.
    unlike = np.where(each[0] < STATUS.half_similarity * usual, 1.0, _unlike(cells, median, on_die))
    return each.max(axis=0), unlike, usual


def _parts(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Return slices of the entire cell and its four halves; the rest of a cut die still correlates."""
    (rows, cols), full = shape, slice(None)
    first, last = (slice(rows // 2), slice(cols // 2)), (slice(rows // 2, None), slice(cols // 2, None))
    return [(full, full), (first[0], full), (last[0], full), (full, first[1]), (full, last[1])]


def _alike(cells: Float32s, median: Float32s) -> Floats:
    """Return the correlation of each of n cells with the median one."""
    both = np.isfinite(cells) & np.isfinite(median)
    a, b = np.where(both, cells, 0.0), np.where(both, median, 0.0)
    n = np.maximum(both.sum(axis=(1, 2)), 1)
    mean_a, mean_b = a.sum(axis=(1, 2)) / n, b.sum(axis=(1, 2)) / n
    covariance = (a * b).sum(axis=(1, 2)) / n - mean_a * mean_b
    spread = ((a**2).sum(axis=(1, 2)) / n - mean_a**2) * ((b**2).sum(axis=(1, 2)) / n - mean_b**2)
    return np.divide(covariance, np.sqrt(np.maximum(spread, 0)), out=np.zeros(len(n)), where=spread > 0)


def _unlike(cells: Float32s, median: Float32s, on_die: Bools) -> Floats:
    """Return the fraction of each die's points that deviate by half of the contrast, or are unknown."""
    finite = median[np.isfinite(median)]
    contrast = float(np.subtract(*np.percentile(finite, STATUS.contrast_percentiles))) if finite.size else 0.0
    like = np.abs(cells - median) <= STATUS.differs_by * contrast
    return cast("Floats", 1 - like[:, on_die].mean(axis=1))


def _usual(similarity: Floats, n_valid: NDArray[np.int_]) -> float:
    """Return the 75th percentile of the correlation of well-known cells; many places at a round rim hold no die."""
    well = similarity[n_valid > 0.5 * n_valid.max()]
    return float(np.percentile(well, STATUS.usual_percentile)) if well.size else 0.0


def _beyond(surface: Mosaic, grid: DieGrid, places: Places) -> Bools:
    """Return which dies extend beyond the border of the surface by more than half a pixel."""
    low_x, low_y, high_x, high_y = bounds_of(surface)
    half = surface.pixel_um / 2
    cells = np.array(places)[:, :, None]
    u, v = grid.width_um * np.array([0, 1, 1, 0]), grid.height_um * np.array([0, 0, 1, 1])
    x_um, y_um = grid.to_stage(cells[:, 0], cells[:, 1], u, v)
    off = (x_um < low_x - half) | (x_um > high_x + half) | (y_um < low_y - half) | (y_um > high_y + half)
    return np.asarray(off.any(axis=1))


def _states(
    places: Places, scanned: Floats, measured: Floats, shows_die: Bools, cut_off: Floats, beyond: Bools
) -> list[DieState]:
    present = {place for place, share, die in zip(places, scanned, shows_die, strict=True) if share > 0 and die}
    rim = [any((col + i, row + j) not in present for i in (-1, 0, 1) for j in (-1, 0, 1)) for col, row in places]
    facts = zip(scanned, measured, shows_die, (cut_off > STATUS.cut_off) & np.array(rim), beyond, strict=True)
    return [_state(*fact) for fact in facts]


def _state(scanned: float, measured: float, present: bool, cut: bool, beyond: bool) -> DieState:
    if scanned == 0:
        return "not scanned"
    if not present:
        return "missing"
    if beyond:
        return "cut"
    if scanned < STATUS.all_scanned or (measured < STATUS.least_measured and not cut):
        return "partly scanned"
    return "cut" if cut else "whole"
