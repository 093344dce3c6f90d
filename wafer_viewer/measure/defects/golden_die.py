"""Golden die of a surface: robust median of its dies, registered to each other, with the streets.

Dies are read block by block of their rows, all dies of one block at a time, so that memory stays bounded.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.dies.die_cells import (
    MARGIN_PX,
    REACH_PX,
    CellGrid,
    CellSource,
    DiePlane,
    Place,
    Plane,
    Read,
    Shift,
)
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.numerics.filters.sliding_filters import sliding_range
from wafer_viewer.numerics.grids.die_cell_kernels import median_and_spread, shift_sums
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA


@dataclass(frozen=True, slots=True)
class DieRegistrationParameters:
    """Limits of the registration of dies to their median.

    Parameters
    ----------
    least_dies : int
        Smallest number of dies for a median die.
    most_dies : int
        Largest number of dies used for the golden die, evenly spaced.
    valid_share : float
        Smallest fraction of dies with a known value at a position. At a polished rim, the few dies with values
        there are chipped ones.
    block_pixels : int, px
        Approximate largest number of pixels of a block of rows of all dies; it bounds the memory.
    least_block_rows : int, px
        Smallest number of rows of a block.
    patch_px : int, px
        Size of the central patch of the dies on which shifts are found.
    furthest_px : float, px
        Largest shift of a die from its place; a step beyond it is not taken.
    least_valid_px : int, px
        Smallest number of known pixels for the registration of a die that is cut by the border.
    enough_valid : float
        Known fraction of a patch above which it is registered.
    within_sigmas : float
        Distance from the median difference within which pixels count for a shift, in robust deviations.
    least_common_px : int, px
        Smallest number of such pixels.
    rounds : int
        Number of rounds of median die and shifts.
    registered_by : int
        Largest number of dies used to find the offset between the wafer's median die and the stored one.

    Notes
    -----
    `tests/bench/bench_defects.py` and `tests/bench/bench_defects_truth.py` count captured and false defects with
    these values.
    """

    least_dies: int = 5
    most_dies: int = 32
    valid_share: float = 0.5
    block_pixels: int = 24_000_000
    least_block_rows: int = 16
    patch_px: int = 384
    furthest_px: float = 3.0
    least_valid_px: int = 3_000
    enough_valid: float = 0.3
    within_sigmas: float = 6
    least_common_px: int = 100
    rounds: int = 3
    registered_by: int = 8


REGISTRATION = DieRegistrationParameters()


@dataclass(frozen=True, slots=True)
class SpreadParameters:
    """Limits of the spread of a position from die to die.

    Parameters
    ----------
    pooled_px : tuple[int, int], px
        Window sizes of the neighbourhoods over which spreads are pooled.
    pooled_as : float, dies
        Weight of the wider neighbourhood.
    powers : tuple[float, float]
        Exponents of the power mean of spreads, for heights and image. Height errors are clustered, so that few
        neighbours are representative; errors of the image are more uniform.
    least_height_um : float, um
        Lower limit for heights, which may be stored too coarsely to differ.
    least_contrast : float
        Lower limit for the log image.
    floor : float
        Lower limit relative to the median spread.
    own : float
        Lower limit relative to the spread of the position itself.
    edge_off_px : float, px
        Residual misregistration of a die (k = 1).
    edge_blur : float
        Share of curvature lost by interpolation (k = 1).
    edge_px : int, px
        Window over which the spread at an edge extends.
    most_off : float
        Largest expected shift of a die, in deviations of all shifts.

    Notes
    -----
    `tests/bench/bench_defects.py` and `tests/bench/bench_defects_truth.py` count captured and false defects with
    these values.
    """

    pooled_px: tuple[int, int] = (5, 21)
    pooled_as: float = 20
    powers: tuple[float, float] = (2.0, 1.0)
    least_height_um: float = 1e-6
    least_contrast: float = 2e-3
    floor: float = 0.7
    own: float = 0.7
    edge_off_px: float = 0.04
    edge_blur: float = 0.12
    edge_px: int = 5
    most_off: float = 3.0


SPREAD = SpreadParameters()
Cell = tuple[Plane, Plane]

SPREAD_SAMPLE = 20_000
"""Approximate number of values sampled for a robust deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceDie:
    """Reference of cells: heights and log image with their spreads, [row, col] of a cell.

    n_dies: number of dies it was made from; shifts: offsets of those dies from their places.
    """

    z_um: Plane
    z_spread_um: Plane
    picture: Plane
    picture_spread: Plane
    n_dies: int
    shifts: dict[Place, Shift] = field(default_factory=dict[Place, Shift])

    @classmethod
    def nothing(cls, shape: tuple[int, int], spread_um: float, grey_spread: float) -> ReferenceDie:
        """Return the reference for the fitted form: zero with uniform spreads."""
        zero, one = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        return cls(zero, one * np.float32(spread_um), zero, one * np.float32(grey_spread), 0)

    @classmethod
    def stored(cls, die: GoldenDie, cells: CellGrid, dark: float) -> ReferenceDie:
        """Convert a stored golden die, in grey levels, to a cell with unknown streets. dark: as in `CellSource`."""
        lit = die.picture + np.float32(dark)
        planes = (die.z_um, die.z_spread_um, np.log(lit), np.maximum(die.picture_spread / lit, SPREAD.least_contrast))
        z_um, spread_um, picture, spread = (_with_street(plane, cells) for plane in planes)
        return cls(z_um, spread_um, picture, spread, die.header.dies)


@dataclass(frozen=True, slots=True)
class DiePose:
    """Shift of a die from its place, (down, right) in pixels, its plane relative to the median die, and brightness."""

    shift: Shift
    plane: DiePlane
    brighter: float

    def levelled(self, cell: Cell, first_row: int) -> Cell:
        """Return rows of the die, from the first one given, corrected to the plane and brightness of the median die."""
        return self.plane.seen_from(first_row, 0).off(cell[0]), cell[1] - np.float32(self.brighter)


def golden_of(source: CellSource, cells: CellGrid, places: tuple[Place, ...]) -> ReferenceDie:
    """Return the golden cell of the dies at places. Raises MeasureError with fewer than five measured dies."""
    chosen = evenly_spaced(places, REGISTRATION.most_dies)
    poses = register_dies(source, cells, chosen)
    if len(poses) < REGISTRATION.least_dies:
        raise DiesNotFound(
            f"Only {len(poses)} of {len(places)} dies are measured in their middle, and a typical die takes "
            f"{REGISTRATION.least_dies}: scan more, or compare with a stored golden die."
        )
    rows, cols = cells.shape
    layers = [np.full((rows, cols), np.nan, np.float32) for _ in range(4)]
    for block in _blocks(rows, cols, len(poses)):
        read = ((pose, source.read(cells, place, block, slice(0, cols), pose.shift)) for place, pose in poses.items())
        levelled = [pose.levelled(cell, block.start) for pose, cell in read if cell is not None]
        for k in range(2 if levelled else 0):
            stack = np.stack([cell[k] for cell in levelled])
            least = max(
                min(REGISTRATION.least_dies, len(levelled)), math.ceil(REGISTRATION.valid_share * len(levelled))
            )
            median_and_spread(stack, least, layers[2 * k][block], layers[2 * k + 1][block])
    as_pooled = ((SPREAD.least_height_um, SPREAD.powers[0]), (SPREAD.least_contrast, SPREAD.powers[1]))
    steady = (pool_spread(layers[2 * k + 1], len(poses), *how) for k, how in enumerate(as_pooled))
    shifts = {place: pose.shift for place, pose in poses.items()}
    reach_px = _reach_px(np.array(list(shifts.values()), np.float32))
    spreads = (
        _with_border(_with_edges(spread, layers[2 * k]), layers[2 * k], reach_px) for k, spread in enumerate(steady)
    )
    return ReferenceDie(layers[0], next(spreads), layers[2], next(spreads), len(poses), shifts)


def golden_die(golden: ReferenceDie, cells: CellGrid, dark: float, **metadata: str | bool) -> GoldenDie:
    """Return the golden die for storage: without its streets, its image in grey levels again.

    dark: as in `CellSource`; metadata: product, name, made_of and the like of the header.
    """
    grid, part = cells.grid, cells.die
    sizes = {"pixel_um": cells.pixel_um, "width_um": grid.width_um, "height_um": grid.height_um}
    header = GoldenHeader(dies=max(1, golden.n_dies), **sizes, **metadata)  # pyright: ignore[reportArgumentType]
    lit = np.exp(golden.picture)
    planes = (golden.z_um, golden.z_spread_um, lit - np.float32(dark), golden.picture_spread * lit)
    return GoldenDie(header, *(np.ascontiguousarray(plane[part]) for plane in planes))


def register_dies(source: CellSource, cells: CellGrid, places: tuple[Place, ...]) -> dict[Place, DiePose]:
    """Return the pose of each die relative to the others; dies with an unmeasured centre are omitted."""
    patch = _patch(cells.shape)
    strips = {place: source.strip(cells.around(place, *patch, (0.0, 0.0), MARGIN_PX + REACH_PX)) for place in places}
    held = {place: strip for place, strip in strips.items() if strip is not None}
    shifts: dict[Place, Shift] = dict.fromkeys(held, (0.0, 0.0))
    valid_cells: dict[Place, Cell] = {}
    model: Cell | None = None
    for _ in range(REGISTRATION.rounds):
        read = {place: held[place].read(cells, place, *patch, shift) for place, shift in shifts.items()}
        valid_cells = {place: cell for place, cell in read.items() if _enough(cell)}
        if not valid_cells:
            return {}
        flat = {place: levelled_pair(cell) for place, cell in valid_cells.items()}
        model = _middle([cell[0] for cell in flat.values()]), _middle([cell[1] for cell in flat.values()])
        moved = {place: _step(cell, model) for place, cell in flat.items()}
        center = np.median(list(moved.values()), axis=0)
        shifts = {place: _held(shifts[place], moved[place] - center) for place in valid_cells}
    return {place: _pose(shifts[place], cell, model, patch) for place, cell in valid_cells.items()} if model else {}


def _pose(shift: Shift, cell: Cell, model: Cell, patch: tuple[slice, slice]) -> DiePose:
    plane = DiePlane.of(cell[0] - model[0]).seen_from(-patch[0].start, -patch[1].start)
    return DiePose(shift, plane, _median(cell[1] - model[1]))


def die_shift(source: Read, cells: CellGrid, place: Place, golden: ReferenceDie) -> Shift | None:
    """Return the shift of one die relative to the golden die, (down, right) in pixels.

    It is found on the central patch, or on the entire cell where the centre was not scanned, as for a die cut by the
    border. None where too little of it is known.
    """
    if place in golden.shifts:
        return golden.shifts[place]
    full = slice(0, cells.shape[0]), slice(0, cells.shape[1])
    for rows, cols in (_patch(cells.shape), full):
        cell = source.read(cells, place, rows, cols, (0.0, 0.0))
        if cell is not None and (_enough(cell) or np.isfinite(cell[0]).sum() >= REGISTRATION.least_valid_px):
            model = golden.z_um[rows, cols], golden.picture[rows, cols]
            shift = _held((0.0, 0.0), _step(levelled_pair(cell), model))
            again = source.read(cells, place, rows, cols, shift)
            return shift if again is None else _held(shift, _step(levelled_pair(again), model))
    return None


def evenly_spaced(places: tuple[Place, ...], most: int) -> tuple[Place, ...]:
    """Return at most `most` of the places, evenly spaced."""
    if len(places) <= most:
        return places
    return tuple(places[k] for k in np.linspace(0, len(places) - 1, most).round().astype(int))


def levelled_pair(cell: Cell) -> Cell:
    """Subtract the medians of heights and brightness, both of which vary over the wafer."""
    return _less_median(cell[0]), _less_median(cell[1])


def pool_spread(spread: Plane, n_dies: int, least: float, power: float) -> Plane:
    """Pool the spread of each position with its neighbours, since that of few dies is uncertain; with a lower limit.

    power: exponent of the power mean; larger values give more weight to the widest spreads nearby.
    """
    from scipy.ndimage import uniform_filter

    finite = np.isfinite(spread)
    share, powers = finite.astype(np.float32), np.where(finite, spread, np.float32(0)) ** power
    near, wide = (uniform_filter(powers, n) / np.maximum(uniform_filter(share, n), 1e-3) for n in SPREAD.pooled_px)
    pooled = np.maximum(near, (n_dies * near + SPREAD.pooled_as * wide) / (n_dies + SPREAD.pooled_as))
    usual = float(np.median(spread[finite])) if finite.any() else 1.0
    held = np.maximum(pooled ** (1 / power), max(SPREAD.floor * usual, least))
    return np.where(finite, np.maximum(held, SPREAD.own * np.where(finite, spread, 0)), np.nan).astype(np.float32)


def _with_edges(spread: Plane, middle: Plane) -> Plane:
    """Add the spread at edges due to residual misregistration and interpolation of a die."""
    from scipy.ndimage import maximum_filter

    down, right = np.gradient(middle)
    bend = np.abs(np.gradient(down, axis=0)) + np.abs(np.gradient(right, axis=1))
    edge = SPREAD.edge_off_px * np.hypot(down, right) + SPREAD.edge_blur * bend
    return np.hypot(spread, maximum_filter(np.nan_to_num(edge), SPREAD.edge_px)).astype(np.float32)


def _reach_px(shifts: NDArray[np.float32]) -> int:
    """Return the distance in pixels over which neighbours with misplaced dies extend into a cell, plus one."""
    return min(REACH_PX, 1 + math.ceil(SPREAD.most_off * robust_sigma(shifts)))


def _with_border(spread: Plane, middle: Plane, reach_px: int) -> Plane:
    """Widen the spread at the border of a cell for the neighbour's structures.

    The neighbour is itself displaced: a structure across the middle of the street varies in length there, on too few
    dies for a robust spread.
    """
    inner = slice(reach_px, -reach_px), slice(reach_px, -reach_px)
    out = np.fmax(spread, sliding_range(np.pad(middle, reach_px, "wrap"), 2 * reach_px + 1)[inner] - spread)
    out[inner] = spread[inner]
    return out


def robust_sigma(values: NDArray[np.float32]) -> float:
    """Return 1.4826 MAD of the known values, of about twenty thousand at most; NaN where none is known."""
    some = values.ravel()[:: max(1, values.size // SPREAD_SAMPLE)]
    some = some[np.isfinite(some)]
    return float(np.median(np.abs(some - np.median(some)))) * MAD_TO_SIGMA if some.size else float("nan")


def _middle(planes: list[Plane]) -> Plane:
    stack = np.stack(planes)
    middle, spread = (np.empty(stack.shape[1:], np.float32) for _ in range(2))
    median_and_spread(stack, 1, middle, spread)
    return middle


def _median(plane: Plane) -> float:
    some = plane[::4, ::4]
    some = some[np.isfinite(some)]
    return float(np.median(some)) if some.size else 0.0


def _step(cell: Cell, model: Cell) -> NDArray[np.float64]:
    """Return the remaining shift of the cell from the model, (down, right), from heights and image together."""
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for value, typical_one in zip(cell, model, strict=True):
        left = value - typical_one
        sigma = robust_sigma(left)
        if not sigma > 0:
            continue
        offset = _median(left)
        sums = shift_sums(value, np.ascontiguousarray(typical_one), offset, REGISTRATION.within_sigmas * sigma)
        if sums[0, 0] < REGISTRATION.least_common_px:
            continue
        normal += (sums[1:, 1:3] - np.outer(sums[1:, 0], sums[0, 1:3]) / sums[0, 0]) / sigma**2
        right += (sums[1:, 3] - sums[1:, 0] * sums[0, 3] / sums[0, 0]) / sigma**2
    if not np.linalg.det(normal) > 1e-6 * max(1e-12, np.trace(normal)) ** 2:
        return np.zeros(2)
    return -np.linalg.solve(normal, right).astype(np.float64)


def _held(shift: Shift, step: NDArray[np.float64]) -> Shift:
    """Return the shift plus the step, or the shift unchanged if the sum exceeds `REGISTRATION.furthest_px`."""
    down, right = shift[0] + float(step[0]), shift[1] + float(step[1])
    return (down, right) if max(abs(down), abs(right)) <= REGISTRATION.furthest_px else shift


def _enough(cell: Cell) -> bool:
    return bool(np.isfinite(cell[0]).mean() > REGISTRATION.enough_valid)


def _less_median(plane: Plane) -> Plane:
    return plane - np.float32(_median(plane))


def _patch(shape: tuple[int, int]) -> tuple[slice, slice]:
    rows, cols = (
        slice(max(0, (n - REGISTRATION.patch_px) // 2), min(n, (n + REGISTRATION.patch_px) // 2)) for n in shape
    )
    return rows, cols


def _blocks(rows: int, cols: int, n: int) -> list[slice]:
    side = max(REGISTRATION.least_block_rows, REGISTRATION.block_pixels // max(1, cols * n))
    return [slice(start, min(rows, start + side)) for start in range(0, rows, side)]


def _with_street(layer: Plane, cells: CellGrid) -> Plane:
    out = np.full(cells.shape, np.nan, np.float32)
    top, left = cells.street
    part = layer[: cells.shape[0] - top, : cells.shape[1] - left]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out


NOT_INSPECTED = "The streets are not in the golden die, and too few dies are measured to compare them: not inspected."
BY_THEMSELVES = "The streets are not in the golden die: each is compared with those of the other dies."


def add_median_streets(
    stored: ReferenceDie, source: CellSource, cells: CellGrid, places: tuple[Place, ...]
) -> tuple[ReferenceDie, tuple[str, ...]]:
    """Return a stored golden die with the median streets of this surface, and notes on them.

    Without five measured dies the streets remain unknown.
    """
    if not sum(cells.street):
        return stored, ()
    try:
        own = golden_of(source, cells, places) if len(places) >= REGISTRATION.least_dies else None
    except MeasureError:
        own = None
    off = _off_reference(stored, own, source, cells) if own is not None else None
    if own is None or off is None:
        return stored, (NOT_INSPECTED,)
    return _beside(stored, own, off), (BY_THEMSELVES,)


def streets_measured(golden: ReferenceDie, cells: CellGrid) -> bool:
    """Return whether the reference of a cell knows its streets, or has none; tested at the line next to the die."""
    top, left = cells.street
    neighbour = golden.z_um[top - 1] if top else golden.z_um[:, left - 1]
    return not (top or left) or bool(np.isfinite(neighbour).any())


def _off_reference(stored: ReferenceDie, own: ReferenceDie, source: CellSource, cells: CellGrid) -> np.ndarray | None:
    """Return the offset (down, right) in pixels of the stored die relative to the wafer's own median die."""
    some = evenly_spaced(tuple(own.shifts), REGISTRATION.registered_by)
    shifts = {place: die_shift(source, cells, place, stored) for place in some}
    off = [np.subtract(shift, own.shifts[place]) for place, shift in shifts.items() if shift is not None]
    return np.median(off, axis=0) if off else None


def _beside(stored: ReferenceDie, own: ReferenceDie, off: np.ndarray) -> ReferenceDie:
    pairs = {
        "z_um": _levelled(_moved(own.z_um, off), stored.z_um),
        "picture": _levelled(_moved(own.picture, off), stored.picture),
        "z_spread_um": _moved(own.z_spread_um, off),
        "picture_spread": _moved(own.picture_spread, off),
    }
    planes = {name: np.where(np.isfinite(stored.z_um), getattr(stored, name), plane) for name, plane in pairs.items()}
    return dataclasses.replace(stored, **planes)


def _moved(plane: Plane, off: np.ndarray) -> Plane:
    from scipy.ndimage import shift

    return np.asarray(shift(plane, -off, order=1, cval=np.nan), np.float32)


def _levelled(plane: Plane, like: Plane) -> Plane:
    """Shift a plane to the level of the stored die, by pixels known in both."""
    return plane - np.float32(np.nanmedian(plane - like))
