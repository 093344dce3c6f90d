"""Refinement of a die lattice: registration of dies to their median, and a lattice fit. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.robust_fit import exact_fit, robust_fit
from wafer_viewer.measure.dies.lattice_evidence import CellLattice, Cells, Evidence, bounds_of, median_cell
from wafer_viewer.model.errors import DiesNotFound
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation
from wafer_viewer.numerics.jit import Bools, Float32s


@dataclass(frozen=True, slots=True)
class LatticeRefinementParameters:
    """Limits of the refinement of a lattice by registered dies.

    Parameters
    ----------
    most_dies : int
        Largest number of registered dies.
    least_dies : int
        Number of dies that are registered whatever their size.
    enough_inner : float
        Fraction of similar cells without a dissimilar neighbour above which the others are omitted.
    cells_pixels : int, px
        Largest number of pixels of all registered cells together; it limits the number of dies.
    cell_px : int, px
        Largest number of pixels along the longer side of a cell at the level that is read.
    reach_px : int, px
        Largest shift of a cell from its place, in pixels of the cell.
    least_valid : float
        Smallest measured fraction of a cell for registration; half of it for a layer.
    least_correlation : float
        Smallest correlation of a cell with the median die.
    as_clear : float
        Smallest correlation of a layer relative to the best layer; weaker layers are noise.
    least_share : float
        Smallest fraction of similar cells for a lattice of dies. A round wafer fills 0.78 of its bounding
        square; patterns within a large die fill hardly half of a surface.
    most_u_pitch : float
        Largest standard uncertainty of a pitch relative to the pitch, for a lattice.
    least_window_px : int, px
        Smallest window of the high-pass of a cell, which is otherwise half of its shorter side.
    few : int
        Largest number of cells that are registered to the first one: their median holds each of them too much.
    rounds : int
        Rounds at the finest level; coarser levels need only approximate the lattice.

    Notes
    -----
    `tests/bench/bench_dies.py` counts the lattices found, missed and wrong with these values on made-up wafers.
    """

    most_dies: int = 100
    least_dies: int = 25
    enough_inner: float = 0.5
    cells_pixels: int = 2_000_000
    cell_px: int = 420
    reach_px: int = 6
    least_valid: float = 0.4
    least_correlation: float = 0.35
    as_clear: float = 0.5
    least_share: float = 0.65
    most_u_pitch: float = 0.003
    rounds: int = 3
    few: int = 4
    least_window_px: int = 5


REFINEMENT = LatticeRefinementParameters()
SPARE_SHARE = 0.06
"""Part of the pitch by which cells may extend beyond the surface: their margin is no part of a die."""
Single = tuple[bool, bool]
Cell = tuple[Float32s, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """A refined lattice, its median cell, the sample lattice of that cell, and the number of registered dies."""

    grid: DieGrid
    cell: Cell
    lattice: CellLattice
    n_dies: int


def refined(
    surface: Mosaic,
    rough: DieGrid,
    evidence: Evidence,
    pixel_um: float,
    single: Single = (False, False),
    most_moved_um: float = math.inf,
) -> Registered:
    """Refine a lattice with cells as large as its pitches, from coarse to fine levels.

    pixel_um: pixel size at which the rough lattice was found. single: axes, x and y, along which there is one die only.
    Raises MeasureError where most cells are dissimilar, or a pitch moves by more than `most_moved_um`.
    """
    grid = rough
    *coarse, finest = (Cells(surface, level, evidence) for level in levels_for(surface, rough, pixel_um))
    unlike: set[tuple[int, int]] = set()
    for source in (*coarse, *[finest] * REFINEMENT.rounds):
        lattice = source.lattice(grid)
        cells = cells_of(source, grid, lattice, unlike, single)
        shifts = registered_shifts(cells, lattice)
        grid, unlike = fit_lattice(grid, shifts), unlike | (cells.keys() - shifts.keys())
    lattice = finest.lattice(grid)
    cells = cells_of(finest, grid, lattice, unlike, single)
    shifts = registered_shifts(cells, lattice)
    moved_um = max(abs(grid.pitch_x_um - rough.pitch_x_um), abs(grid.pitch_y_um - rough.pitch_y_um))
    if grid.u_pitch_um > REFINEMENT.most_u_pitch * grid.pitch_x_um or moved_um > most_moved_um:
        raise DiesNotFound(dissimilar_cells("Too few of the", lattice))
    return Registered(grid, median_cell([cells[die] for die in shifts]), lattice, len(shifts))


def levels_for(surface: Mosaic, grid: DieGrid, pixel_um: float) -> tuple[int, ...]:
    """Return the pyramid levels to process, from about that of the rough lattice to the finest needed."""
    longer_px = max(grid.pitch_x_um, grid.pitch_y_um) / surface.pixel_um
    finest = min(surface.levels - 1, max(0, math.ceil(math.log2(longer_px / REFINEMENT.cell_px))))
    coarsest = min(surface.levels - 1, max(0, round(math.log2(pixel_um / surface.pixel_um))))
    return (*range(coarsest, finest, -2), finest)


def cells_of(
    source: Cells,
    grid: DieGrid,
    lattice: CellLattice,
    unlike: Set[tuple[int, int]] = frozenset(),
    single: Single = (False, False),
) -> dict[tuple[int, int], Cell]:
    """Return sufficiently measured cells over the entire surface, without those found dissimilar at coarser levels.

    Raises MeasureError where there are fewer than two.
    """
    most = max(
        REFINEMENT.least_dies, min(REFINEMENT.most_dies, REFINEMENT.cells_pixels // (lattice.rows * lattice.cols))
    )
    places = spread(_best_of(complete_cells(source.surface, grid, single), unlike, most), most)
    read = {die: source.read(grid, die, lattice) for die in places}
    cells = {
        die: cell
        for die, cell in read.items()
        if any(_finite_fraction(layer) >= REFINEMENT.least_valid for layer in cell)
    }
    if len(cells) < 2:
        found = f"{len(cells)} whole {'die' if len(cells) == 1 else 'dies'} found, 2 needed"
        raise DiesNotFound(
            f"{found}; they seem to repeat every {grid.pitch_x_um:.1f} x {grid.pitch_y_um:.1f} um: scan more dies, or "
            "give pitch, origin and size of the dies instead."
        )
    return cells


def _best_of(places: Sequence[tuple[int, int]], unlike: Set[tuple[int, int]], most: int) -> Sequence[tuple[int, int]]:
    """Return the places not marked dissimilar; if enough remain, only those without dissimilar neighbours.

    The origin of a die is undetermined, so that a cell may contain parts of its neighbours.
    """
    like = [die for die in places if die not in unlike]
    adjacent = {(col + i, row + j) for col, row in unlike for i in (-1, 0, 1) for j in (-1, 0, 1)}
    inner = [die for die in like if die not in adjacent]
    return inner if len(like) > most and len(inner) >= REFINEMENT.enough_inner * len(like) else like


def _finite_fraction(layer: Float32s) -> float:
    """Return the known fraction of a layer; 0 where it has no contrast."""
    finite = layer[np.isfinite(layer)]
    return finite.size / layer.size if finite.size and np.ptp(finite) > 0 else 0.0


def complete_cells(surface: Mosaic, grid: DieGrid, single: Single = (False, False)) -> list[tuple[int, int]]:
    """Return (col, row) of the cells on the surface but for a margin; of a single column or row those in it."""
    low_x, low_y, high_x, high_y = bounds_of(surface)
    spare_um = SPARE_SHARE * max(grid.pitch_x_um, grid.pitch_y_um)
    low_x, low_y, high_x, high_y = low_x - spare_um, low_y - spare_um, high_x + spare_um, high_y + spare_um
    (cols, rows), (u, v) = cells_over(grid, (low_x, low_y, high_x, high_y)), half_cell(grid)
    x_um, y_um = grid.to_stage(cols[:, None], rows[:, None], u, v)
    inside = (x_um >= low_x) & (x_um <= high_x) & (y_um >= low_y) & (y_um <= high_y)
    complete = inside.all(axis=1) & ~(single[0] & (cols != 0)) & ~(single[1] & (rows != 0))
    return list(zip(cols[complete].tolist(), rows[complete].tolist(), strict=True))


def cells_over(grid: DieGrid, bounds_um: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows, [n] each, of all lattice cells over a rectangle."""
    low_x, low_y, high_x, high_y = bounds_um
    cols, rows, _, _ = grid.to_die(np.array([low_x, low_x, high_x, high_x]), np.array([low_y, high_y, low_y, high_y]))
    each_col, each_row = np.arange(cols.min(), cols.max() + 1), np.arange(rows.min(), rows.max() + 1)
    return np.tile(each_col, len(each_row)), np.repeat(each_row, len(each_col))


def half_cell(grid: DieGrid) -> tuple[Floats, Floats]:
    """Return u and v of the four corners of a cell."""
    u = grid.width_um / 2 + grid.pitch_x_um * np.array([-0.5, 0.5, 0.5, -0.5])
    return u, grid.height_um / 2 + grid.pitch_y_um * np.array([-0.5, -0.5, 0.5, 0.5])


def spread(places: Sequence[tuple[int, int]], most: int) -> list[tuple[int, int]]:
    """Return at most `most` places, nearest to a regular lattice over all of them including the corners."""
    if len(places) <= most:
        return list(places)
    positions, side = np.array(places, float), math.isqrt(most)
    low, high = positions.min(axis=0), positions.max(axis=0)
    wanted = low + (high - low) * np.stack(np.meshgrid(*[np.linspace(0, 1, side)] * 2), axis=-1).reshape(-1, 2)
    nearest = {int(np.argmin(((positions - one) ** 2).sum(axis=1))) for one in wanted}
    return [places[k] for k in sorted(nearest)]


Shifts = dict[tuple[int, int], tuple[float, float]]


def registered_shifts(cells: dict[tuple[int, int], Cell], lattice: CellLattice) -> Shifts:
    """Return the shift (du_um, dv_um) of each similar cell from its lattice place.

    Raises MeasureError where fewer than `REFINEMENT.least_share` are similar.
    """
    some = list(cells.values())
    reference = _contrasts(some[0] if len(some) <= REFINEMENT.few else median_cell(some))
    found = {die: _shift(reference, _contrasts(cell)) for die, cell in cells.items()}
    shifts = {die: (-lag[1] * lattice.step_x_um, lag[0] * lattice.step_y_um) for die, lag in found.items() if lag}
    if len(shifts) < max(2, REFINEMENT.least_share * len(cells)):
        raise DiesNotFound(dissimilar_cells(f"Only {len(shifts)} of {len(cells)}", lattice))
    return shifts


def dissimilar_cells(how_many: str, lattice: CellLattice) -> str:
    """Return the message of the error for a repeating pattern that is not dies."""
    width_um, height_um = lattice.cols * lattice.step_x_um, lattice.rows * lattice.step_y_um
    return (
        f"{how_many} places that repeat every {width_um:.0f} x {height_um:.0f} um look alike, so they are no whole "
        "dies: scan at least two dies along each axis, or give pitch, origin and size of the dies instead."
    )


Contrast = tuple[Float32s, Bools]


def _contrasts(cell: Cell) -> list[Contrast | None]:
    size = max(REFINEMENT.least_window_px, min(cell[0].shape) // 2)
    return [_contrast(layer, size) for layer in cell]


def _contrast(layer: Float32s, size: int) -> Contrast | None:
    valid = np.isfinite(layer)
    if valid.mean() < REFINEMENT.least_valid / 2 or float(np.ptp(layer[valid])) == 0:
        return None
    return contrast(np.where(valid, layer, np.float32(0)), valid, size), valid


def _shift(reference: Sequence[Contrast | None], cell: Sequence[Contrast | None]) -> tuple[float, float] | None:
    """Return the lag (row, col) of highest correlation with the median cell; None where dissimilar."""
    pairs = [(a, b) for a, b in zip(reference, cell, strict=True) if a is not None and b is not None]
    if not pairs:
        return None
    each = [normalised_cross_correlation(*a, *b, (0, 0), REFINEMENT.reach_px).correlation for a, b in pairs]
    best = max(float(correlation.max()) for correlation in each)
    if best < REFINEMENT.least_correlation:
        return None
    clear = [k for k, correlation in enumerate(each) if correlation.max() >= REFINEMENT.as_clear * best]
    correlation = np.mean([each[k] for k in clear], axis=0)
    row, col = (int(k) for k in np.unravel_index(int(np.argmax(correlation)), correlation.shape))
    if correlation[row, col] < REFINEMENT.least_correlation or not (
        0 < row < 2 * REFINEMENT.reach_px and 0 < col < 2 * REFINEMENT.reach_px
    ):
        return None
    lag = row - REFINEMENT.reach_px, col - REFINEMENT.reach_px
    down, right = _between([pairs[k] for k in clear], lag)
    return lag[0] + down, lag[1] + right


def _between(pairs: Sequence[tuple[Contrast, Contrast]], lag: tuple[int, int]) -> Floats:
    """Return the subpixel remainder of a lag: least squares on the gradients of the median cell.

    The correlation peak of sharp edges is a cusp, and a parabola through it is biased to integer pixels.
    """
    normal, right = np.zeros((4, 4)), np.zeros(4)
    for (first, first_valid), (second, second_valid) in pairs:
        a, b = _overlap(first, lag, 1), _overlap(second, lag, -1)
        valid = _overlap(first_valid, lag, 1) & _overlap(second_valid, lag, -1)
        down, across = np.gradient(a)
        design = np.stack([plane[valid] for plane in (down, across, a, np.ones_like(a))], axis=1).astype(np.float64)
        values = b[valid].astype(np.float64) / max(float(b[valid].std()), 1e-9)
        normal += design.T @ design
        right += design.T @ values
    found = np.linalg.lstsq(normal, right, rcond=None)[0]
    return np.asarray(np.clip(found[:2] / max(float(found[2]), 1e-9), -1, 1), np.float64)


def _overlap(plane: np.ndarray, lag: tuple[int, int], sign: int) -> np.ndarray:
    """Return the part of the first of two cells (way 1) or the second (-1) that overlaps the other at a lag."""
    (rows, cols), (down, right) = plane.shape, (sign * k for k in lag)
    return plane[max(0, down) : rows + min(0, down), max(0, right) : cols + min(0, right)]


def fit_lattice(grid: DieGrid, shifts: Shifts) -> DieGrid:
    """Fit origin, both pitches and angle of the lattice by least squares with outlier rejection; with uncertainties."""
    positions, off = np.array(list(shifts), float), np.array(list(shifts.values()))
    center = positions.mean(axis=0)
    i, j = (positions - center).T
    one, zero = np.ones(len(positions)), np.zeros(len(positions))
    design = np.concatenate(
        [
            np.stack([one, zero, i, zero, -j * grid.pitch_y_um], axis=1),
            np.stack([zero, one, zero, j, i * grid.pitch_x_um], axis=1),
        ]
    )
    along = np.ptp(positions, axis=0) > 0
    known = np.array([True, True, *along, along.any()])
    fit = (robust_fit if len(positions) > 2 else exact_fit)(design[:, known], off.T.ravel())
    coefficients = np.zeros(len(known))
    coefficients[known] = fit.coefficients
    du, dv, pitch_x, pitch_y, turn = coefficients.tolist()
    middle = grid.to_stage(center[0], center[1], du, dv)
    new = replace(
        grid,
        pitch_x_um=grid.pitch_x_um + pitch_x,
        pitch_y_um=grid.pitch_y_um + pitch_y,
        width_um=grid.pitch_x_um + pitch_x,
        height_um=grid.pitch_y_um + pitch_y,
        angle_rad=grid.angle_rad + turn,
        **_uncertainties(design[fit.inliers], fit.residuals[fit.inliers], center, grid),
    )
    shift = np.subtract(middle, new.to_stage(center[0], center[1]))
    return replace(new, x0_um=new.x0_um + float(shift[0]), y0_um=new.y0_um + float(shift[1]))


def _uncertainties(design: Floats, residuals: Floats, center: Floats, grid: DieGrid) -> dict[str, float]:
    """Return the standard uncertainties of a pitch and of the corner of die 0,0, from the fit residuals."""
    freedom = max(1, len(residuals) - design.shape[1])
    covariance = np.linalg.pinv(design.T @ design) * float(residuals @ residuals) / freedom
    i, j = -center
    to_origin = np.array([[1, 0, i, 0, -j * grid.pitch_y_um], [0, 1, 0, j, i * grid.pitch_x_um]])
    variance = np.diag(to_origin @ covariance @ to_origin.T)
    u_pitch = math.sqrt(float(max(covariance[2, 2], covariance[3, 3])))
    return {"u_pitch_um": u_pitch, "u_origin_um": math.sqrt(float(variance.max()))}
