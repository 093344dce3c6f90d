"""Which dies of a lattice lie on a surface: whole, cut by an edge, in a gap of the scan, or not there at all. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, layer_of, pictured_window
from wafer_viewer.measure.base.robust_plane import least_squares
from wafer_viewer.measure.dies.lattice_evidence import CellLattice, bounds_of, coarse_level, median_of
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, DieState, DieStatus
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic, Origin
from wafer_viewer.numerics.array_types import Float32s

DIE_PX = 200
"""The shorter pitch is read at a level that gives it about as many pixels."""
PLACES = 32
"""Of a cell along its longer side, at which it is looked at."""
WINDOW_PIXELS = 4_000_000
"""Rows of dies are read in pieces of so many pixels at most."""
MEDIAN_OF = 200
"""So many dies make the median one, at most."""
ALL = 0.998
"""Of a die's places: with so many scanned all of it was."""
LEAST_MEASURED = 0.5
LEAST_ALIKE, AS_CLEAR = 0.6, 0.7
"""Of what dies are usually like their median: a place with less holds no die. A layer in which dies are less alike than
so much of the other says nothing of that."""
HALF_ALIKE = 0.4
"""Of that: a place that is less like the median die as a whole is no whole die."""
LEAST_JUDGED = 0.1
"""Of a cell: with less of it known it is not said whether a die is there."""
CUT_OFF = 0.1
"""More of its places that are unlike the median die than on other dies: at the rim of the lattice a die is cut."""
Places = Sequence[tuple[int, int]]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class DieCoverage:
    """Cells of n dies at their places: layers [n, row, col], NaN where unknown, and which were scanned, bool."""

    layers: tuple[Float32s, ...]
    scanned: Bools
    x_um: Floats
    y_um: Floats


def statuses(surface: Mosaic, grid: DieGrid) -> tuple[DieStatus, ...]:
    """The state of every die of a lattice, row by row from the lowest; the surface is read by rows of dies.

    measured_fraction: of the die's places, without its street, at the level that gives a pitch about 200 px; those
    beyond the surface count as unmeasured. Raises MeasureError where no die of the lattice lies on the surface.
    """
    places = grid.places
    lattice = CellLattice.of(grid, max(grid.pitch_x_um, grid.pitch_y_um) / PLACES)
    seen = _seen(surface, grid, places, lattice)
    if not seen.scanned.any():
        raise MeasureError("No die of the lattice lies on the surface: give an origin and a pitch that fit it.")
    on_die = _on_die(grid, lattice)
    scanned = seen.scanned[:, on_die].mean(axis=1)
    measured = np.isfinite(seen.layers[0][:, on_die]).mean(axis=1)
    there, cut_off = _looked_at(seen, on_die)
    beyond = _beyond(surface, grid, places)
    states = _states(places, scanned, measured, there, cut_off, beyond)
    return tuple(
        DieStatus(name=grid.name(*at), col=at[0], row=at[1], state=state, measured_fraction=float(share))
        for at, state, share in zip(places, states, measured, strict=True)
    )


def without_bare_rim(grid: DieGrid, dies: Sequence[DieStatus]) -> DieGrid:
    """The lattice less its places that hold no die and hang together with its rim: beyond the dies of a round wafer.

    A die that is missing among others stays in, and so does every place of a lattice that names its dies. Of slivers at
    the border of the surface nobody can say what they hold: beside a bare place it is nothing.
    """
    if grid.named:
        return grid
    places = {(die.col, die.row): die.state for die in dies}
    empty = {at for at, state in places.items() if state in ("missing", "not scanned")}
    waiting = [at for at in empty if not places.keys() >= set(_beside(at))]
    rim = set(waiting)
    while waiting:
        met = (empty - rim).intersection(_beside(waiting.pop()))
        rim |= met
        waiting.extend(met)
    bare = {at for at in rim if places[at] == "missing"}
    slivers = {(die.col, die.row) for die in dies if die.state == "cut" and die.measured_fraction < LEAST_JUDGED}
    bare |= {at for at in slivers if bare.intersection(_beside(at))}
    return replace(grid, left_out=(*grid.left_out, *sorted(grid.name(*at) for at in bare)))


def _beside(at: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    col, row = at
    return (col - 1, row), (col + 1, row), (col, row - 1), (col, row + 1)


def not_scanned_mm2(surface: Mosaic) -> float:
    """How much of the rectangle that a surface fills no field covers, at a level of a million pixels or so."""
    rows, cols = surface.shape
    share = float((surface.window(None, coarse_level(surface)).origin == Origin.NOT_COVERED).mean())
    return share * rows * cols * (surface.pixel_um / 1000) ** 2


def _seen(surface: Mosaic, grid: DieGrid, places: Places, lattice: CellLattice) -> DieCoverage:
    shorter_px = min(grid.pitch_x_um, grid.pitch_y_um) / surface.pixel_um
    level = min(surface.levels - 1, max(0, math.floor(math.log2(max(1.0, shorter_px / DIE_PX)))))
    parts = [_piece(surface, grid, piece, lattice, level) for piece in _pieces(surface, grid, places, level)]
    layers = tuple(np.concatenate([part.layers[k] for part in parts]) for k in range(2))
    rest = (np.concatenate([getattr(part, name) for part in parts]) for name in ("scanned", "x_um", "y_um"))
    return DieCoverage(layers, *rest)


def _pieces(surface: Mosaic, grid: DieGrid, places: Places, level: int) -> Iterator[Places]:
    """Dies of a row next to each other, as many as a window holds."""
    pixel_um = surface.pixel_um * 2**level
    width_px, height_px = grid.pitch_x_um / pixel_um, grid.pitch_y_um / pixel_um
    rise = abs(math.tan(grid.angle_rad))
    most = max(1, math.floor(WINDOW_PIXELS / (width_px * (height_px + rise * grid.cols * width_px))))
    for row in range(grid.first_row, grid.first_row + grid.rows):
        of_row = [at for at in places if at[1] == row]
        for first in range(0, len(of_row), most):
            yield of_row[first : first + most]


def _piece(surface: Mosaic, grid: DieGrid, places: Places, lattice: CellLattice, level: int) -> DieCoverage:
    at = np.array(places)[:, :, None, None]
    x_um, y_um = grid.to_stage(at[:, 0], at[:, 1], *lattice.places(grid))
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
    """Which places of a cell lie on the die."""
    u_um, v_um = lattice.places(grid)
    return (u_um >= 0) & (u_um <= grid.width_um) & (v_um >= 0) & (v_um <= grid.height_um)


def _looked_at(seen: DieCoverage, on_die: Bools) -> tuple[Bools, Floats]:
    """Which places hold a die, and how much more of each is unlike the median die than is usual.

    A die is there where the layers that show dies well are like the median one, taken together; what is unlike
    is that of the best of them. Without a pattern every place is taken to hold one.
    """
    levelled = _without_form(seen)
    compared = [_compared(layer, on_die) for layer in (levelled, seen.layers[1])]
    best = max(compared, key=lambda one: one[2])
    if best[2] < LEAST_ALIKE / 2:
        return np.ones(len(best[0]), bool), np.zeros(len(best[0]))
    clear = [one[0] / one[2] for one in compared if one[2] >= AS_CLEAR * best[2]]
    known = np.maximum(*(np.isfinite(layer).mean(axis=(1, 2)) for layer in seen.layers))
    there = (np.mean(clear, axis=0) >= LEAST_ALIKE) | (known < LEAST_JUDGED)
    return there, best[1] - np.median(best[1][there] if there.any() else best[1])


def _without_form(seen: DieCoverage) -> Float32s:
    """The heights without tilt and bow."""
    z_um = seen.layers[0]
    known = np.isfinite(z_um)
    if known.sum() < 100:
        return z_um
    x_um, y_um = ((a - a.mean()) / max(float(np.ptp(a)), 1.0) for a in (seen.x_um, seen.y_um))
    powers = np.stack([np.ones_like(x_um), x_um, y_um, x_um**2, x_um * y_um, y_um**2], axis=-1)
    some = powers[known], z_um[known].astype(np.float64)
    step = max(1, len(some[1]) // 100_000)
    form = powers @ least_squares(some[0][::step], some[1][::step])
    return (z_um - form).astype(np.float32)


def _compared(layer: Float32s, on_die: Bools) -> tuple[Floats, Floats, float]:
    """(correlation with the median cell or half of it, share of the die unlike it), [n] each, and the usual one."""
    middle = np.array([float(np.median(one[np.isfinite(one)])) if np.isfinite(one).any() else 0.0 for one in layer])
    cells = layer - middle[:, None, None].astype(np.float32)
    some = [one for one in cells if np.isfinite(one).mean() > LEAST_MEASURED] or list(cells)
    median = median_of(np.stack(some[:: max(1, len(some) // MEDIAN_OF)]))
    n_known = (np.isfinite(cells) & np.isfinite(median)).sum(axis=(1, 2))
    each = np.array([_alike(cells[:, rows, cols], median[rows, cols]) for rows, cols in _parts(median.shape)])
    usual = _usual(each[0], n_known)
    # A place that is like the median die in one half only is no whole die, whatever its levels are.
    unlike = np.where(each[0] < HALF_ALIKE * usual, 1.0, _unlike(cells, median, on_die))
    return each.max(axis=0), unlike, usual


def _parts(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """The whole cell and its four halves: what is left of a die that is cut is still like it."""
    (rows, cols), whole = shape, slice(None)
    first, last = (slice(rows // 2), slice(cols // 2)), (slice(rows // 2, None), slice(cols // 2, None))
    return [(whole, whole), (first[0], whole), (last[0], whole), (whole, first[1]), (whole, last[1])]


def _alike(cells: Float32s, median: Float32s) -> Floats:
    """Correlation of each of n cells with the median one."""
    both = np.isfinite(cells) & np.isfinite(median)
    a, b = np.where(both, cells, 0.0), np.where(both, median, 0.0)
    n = np.maximum(both.sum(axis=(1, 2)), 1)
    mean_a, mean_b = a.sum(axis=(1, 2)) / n, b.sum(axis=(1, 2)) / n
    covariance = (a * b).sum(axis=(1, 2)) / n - mean_a * mean_b
    spread = ((a**2).sum(axis=(1, 2)) / n - mean_a**2) * ((b**2).sum(axis=(1, 2)) / n - mean_b**2)
    return np.divide(covariance, np.sqrt(np.maximum(spread, 0)), out=np.zeros(len(n)), where=spread > 0)


def _unlike(cells: Float32s, median: Float32s, on_die: Bools) -> Floats:
    """The share of the places of each die that differ from the median die by half of its contrast, or are unknown."""
    known = median[np.isfinite(median)]
    contrast = float(np.subtract(*np.percentile(known, (95, 5)))) if known.size else 0.0
    like = np.abs(cells - median) <= 0.5 * contrast
    return cast("Floats", 1 - like[:, on_die].mean(axis=1))


def _usual(alike: Floats, n_known: NDArray[np.int_]) -> float:
    """Of the better half of the cells that are known well: many places at the rim of a round wafer hold no die."""
    well = alike[n_known > 0.5 * n_known.max()]
    return float(np.percentile(well, 75)) if well.size else 0.0


def _beyond(surface: Mosaic, grid: DieGrid, places: Places) -> Bools:
    """Which dies reach beyond the border of the surface by more than half a pixel."""
    low_x, low_y, high_x, high_y = bounds_of(surface)
    half = surface.pixel_um / 2
    at = np.array(places)[:, :, None]
    u, v = grid.width_um * np.array([0, 1, 1, 0]), grid.height_um * np.array([0, 0, 1, 1])
    x_um, y_um = grid.to_stage(at[:, 0], at[:, 1], u, v)
    off = (x_um < low_x - half) | (x_um > high_x + half) | (y_um < low_y - half) | (y_um > high_y + half)
    return np.asarray(off.any(axis=1))


def _states(
    places: Places, scanned: Floats, measured: Floats, there: Bools, cut_off: Floats, beyond: Bools
) -> list[DieState]:
    present = {at for at, share, die in zip(places, scanned, there, strict=True) if share > 0 and die}
    rim = [any((col + i, row + j) not in present for i in (-1, 0, 1) for j in (-1, 0, 1)) for col, row in places]
    facts = zip(scanned, measured, there, (cut_off > CUT_OFF) & np.array(rim), beyond, strict=True)
    return [_state(*fact) for fact in facts]


def _state(scanned: float, measured: float, there: bool, cut: bool, beyond: bool) -> DieState:
    if scanned == 0:
        return "not scanned"
    if not there:
        return "missing"
    if beyond:
        return "cut"
    if scanned < ALL or (measured < LEAST_MEASURED and not cut):
        return "partly scanned"
    return "cut" if cut else "whole"
