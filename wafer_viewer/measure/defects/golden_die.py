"""The golden die of a surface: the robust median of its dies, each registered to the others to parts of a pixel.

Dies are read block by block of their rows, all dies of one block at a time, so that memory stays bounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.dies.die_cells import MARGIN_PX, REACH_PX, CellGrid, CellSource, Place, Plane, Read, Shift
from wafer_viewer.measure.dies.die_plane import DiePlane
from wafer_viewer.model.errors import DiesNotFound
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.numerics.filters.sliding_filters import relief
from wafer_viewer.numerics.grids.die_cell_kernels import MAD_TO_SIGMA, shift_sums, typical

LEAST_DIES = 5
"""Fewer dies have no typical one."""
KNOWN_SHARE = 0.5
"""Of the dies that know a place: at a polished rim the few that see anything there are those that are chipped."""
MOST_DIES = 32
"""The golden die is found from so many dies at most, taken evenly from all."""
BLOCK_PIXELS = 24_000_000
PATCH_PX = 384
"""Shifts are found on the middle of the dies."""
FURTHEST_PX = 3.0
LEAST_KNOWN_PX = 3_000
"""With fewer a die that is cut by the border cannot be laid over the others."""
ROUNDS = 3
POOLED_PX, POOLED_AS = (5, 21), 20
"""The spread of a place is that of its neighbourhood; the wider one counts as much as so many dies."""
POWERS = 2.0, 1.0
"""Of the mean of spreads: heights err in patches, so that few neighbours tell how far; a picture errs more evenly."""
LEAST_HEIGHT_UM, LEAST_CONTRAST = 1e-6, 2e-3
"""No spread is less: of heights that were written down too coarsely to differ, of the logarithm of a picture."""
FLOOR = 0.7
"""Of the usual spread: no place is taken to be steadier."""
EDGE_OFF_PX, EDGE_BLUR = 0.04, 0.12
"""How far off a registered die may still lie, and how much of a bend is lost between pixels (k = 1)."""
MOST_OFF = 3.0
"""In deviations: further off its place hardly a die lies."""
Cell = tuple[Plane, Plane]


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceDie:
    """What cells should be: heights and the picture's logarithm with their spreads, [row, col] of a cell.

    n_dies: over how many dies; shifts: how far those lie off their places.
    """

    z_um: Plane
    z_spread_um: Plane
    picture: Plane
    picture_spread: Plane
    n_dies: int
    shifts: dict[Place, Shift] = field(default_factory=dict[Place, Shift])

    @classmethod
    def nothing(cls, shape: tuple[int, int], spread_um: float, grey_spread: float) -> ReferenceDie:
        """The form itself, everywhere alike."""
        zero, one = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        return cls(zero, one * np.float32(spread_um), zero, one * np.float32(grey_spread), 0)

    @classmethod
    def stored(cls, die: GoldenDie, cells: CellGrid, dark: float) -> ReferenceDie:
        """A golden die from the store, in grey, as a cell: its streets are not known. dark: as in `CellSource`."""
        lit = die.picture + np.float32(dark)
        planes = (die.z_um, die.z_spread_um, np.log(lit), np.maximum(die.picture_spread / lit, LEAST_CONTRAST))
        z_um, spread_um, picture, spread = (_with_street(plane, cells) for plane in planes)
        return cls(z_um, spread_um, picture, spread, die.header.dies)


@dataclass(frozen=True, slots=True)
class DiePose:
    """How far a die lies off its place, (down, right) in pixels, its plane over the typical one, and its brightness."""

    shift: Shift
    plane: DiePlane
    brighter: float

    def levelled(self, cell: Cell, first_row: int) -> Cell:
        """A part of the die, whole rows from the first on, as if it lay where the typical one does."""
        return self.plane.seen_from(first_row, 0).off(cell[0]), cell[1] - np.float32(self.brighter)


def golden_of(source: CellSource, cells: CellGrid, places: tuple[Place, ...]) -> ReferenceDie:
    """The golden cell of the dies at places. Raises MeasureError where fewer than five of them are measured."""
    chosen = spaced(places, MOST_DIES)
    poses = found_poses(source, cells, chosen)
    if len(poses) < LEAST_DIES:
        raise DiesNotFound(
            f"Only {len(poses)} dies are measured in their middle: a golden die takes {LEAST_DIES}; "
            "give a stored one, or compare with the fitted form.",
            f"{len(poses)} dies measured in their middle, {LEAST_DIES} needed",
        )
    rows, cols = cells.shape
    layers = [np.full((rows, cols), np.nan, np.float32) for _ in range(4)]
    for block in _blocks(rows, cols, len(poses)):
        read = ((pose, source.read(cells, place, block, slice(0, cols), pose.shift)) for place, pose in poses.items())
        known = [pose.levelled(cell, block.start) for pose, cell in read if cell is not None]
        for k in range(2 if known else 0):
            stack = np.stack([cell[k] for cell in known])
            least = max(min(LEAST_DIES, len(known)), math.ceil(KNOWN_SHARE * len(known)))
            typical(stack, least, layers[2 * k][block], layers[2 * k + 1][block])
    as_pooled = ((LEAST_HEIGHT_UM, POWERS[0]), (LEAST_CONTRAST, POWERS[1]))
    steady = (steadied(layers[2 * k + 1], len(poses), *how) for k, how in enumerate(as_pooled))
    shifts = {place: pose.shift for place, pose in poses.items()}
    reach_px = _reach_px(np.array(list(shifts.values()), np.float32))
    spreads = (
        _with_border(_with_edges(spread, layers[2 * k]), layers[2 * k], reach_px) for k, spread in enumerate(steady)
    )
    return ReferenceDie(layers[0], next(spreads), layers[2], next(spreads), len(poses), shifts)


def golden_die(golden: ReferenceDie, cells: CellGrid, dark: float, **told: str | bool) -> GoldenDie:
    """Return the golden die as it is saved: without its streets, its image in grey levels again.

    dark: as in `CellSource`; told: product, name, made_of and the like of the header.
    """
    grid, (top, left) = cells.grid, cells.street
    rows, cols = (round(n / cells.pixel_um) for n in (grid.height_um, grid.width_um))
    part = slice(top, top + rows), slice(left, left + cols)
    sizes = {"pixel_um": cells.pixel_um, "width_um": grid.width_um, "height_um": grid.height_um}
    header = GoldenHeader(dies=max(1, golden.n_dies), **sizes, **told)  # pyright: ignore[reportArgumentType]
    lit = np.exp(golden.picture)
    planes = (golden.z_um, golden.z_spread_um, lit - np.float32(dark), golden.picture_spread * lit)
    return GoldenDie(header, *(np.ascontiguousarray(plane[part]) for plane in planes))


def found_poses(source: CellSource, cells: CellGrid, places: tuple[Place, ...]) -> dict[Place, DiePose]:
    """How each die lies against the others; dies whose middle is not measured are left out."""
    patch = _patch(cells.shape)
    strips = {place: source.strip(cells.around(place, *patch, (0.0, 0.0), MARGIN_PX + REACH_PX)) for place in places}
    held = {place: strip for place, strip in strips.items() if strip is not None}
    shifts: dict[Place, Shift] = dict.fromkeys(held, (0.0, 0.0))
    known: dict[Place, Cell] = {}
    model: Cell | None = None
    for _ in range(ROUNDS):
        read = {place: held[place].read(cells, place, *patch, shift) for place, shift in shifts.items()}
        known = {place: cell for place, cell in read.items() if _enough(cell)}
        if not known:
            return {}
        flat = {place: levelled_pair(cell) for place, cell in known.items()}
        model = _middle([cell[0] for cell in flat.values()]), _middle([cell[1] for cell in flat.values()])
        moved = {place: _step(cell, model) for place, cell in flat.items()}
        center = np.median(list(moved.values()), axis=0)
        shifts = {place: _held(shifts[place], moved[place] - center) for place in known}
    return {place: _pose(shifts[place], cell, model, patch) for place, cell in known.items()} if model else {}


def _pose(shift: Shift, cell: Cell, model: Cell, patch: tuple[slice, slice]) -> DiePose:
    plane = DiePlane.of(cell[0] - model[0]).seen_from(-patch[0].start, -patch[1].start)
    return DiePose(shift, plane, _median(cell[1] - model[1]))


def registered(source: Read, cells: CellGrid, place: Place, golden: ReferenceDie) -> Shift | None:
    """How far one die lies off its place against the golden die, (down, right) in pixels.

    By its middle; by all of it where that was not scanned, for a die that is cut by the border lies off its place too.
    None where too little of it is known.
    """
    if place in golden.shifts:
        return golden.shifts[place]
    whole = slice(0, cells.shape[0]), slice(0, cells.shape[1])
    for rows, cols in (_patch(cells.shape), whole):
        cell = source.read(cells, place, rows, cols, (0.0, 0.0))
        if cell is not None and (_enough(cell) or np.isfinite(cell[0]).sum() >= LEAST_KNOWN_PX):
            model = golden.z_um[rows, cols], golden.picture[rows, cols]
            shift = _held((0.0, 0.0), _step(levelled_pair(cell), model))
            again = source.read(cells, place, rows, cols, shift)
            return shift if again is None else _held(shift, _step(levelled_pair(again), model))
    return None


def spaced(places: tuple[Place, ...], most: int) -> tuple[Place, ...]:
    """So many of the places at most, evenly taken."""
    if len(places) <= most:
        return places
    return tuple(places[k] for k in np.linspace(0, len(places) - 1, most).round().astype(int))


def levelled_pair(cell: Cell) -> Cell:
    """Heights and brightness less their medians: dies differ in both from place to place."""
    return _less_median(cell[0]), _less_median(cell[1])


def steadied(spread: Plane, n_dies: int, least: float, power: float) -> Plane:
    """The spread of a place and its neighbours together, for that of few dies is unsure; never far under the usual.

    power: of the mean; the higher, the more the widest spreads nearby count.
    """
    from scipy.ndimage import uniform_filter

    known = np.isfinite(spread)
    share, powers = known.astype(np.float32), np.where(known, spread, np.float32(0)) ** power
    near, wide = (uniform_filter(powers, n) / np.maximum(uniform_filter(share, n), 1e-3) for n in POOLED_PX)
    pooled = np.maximum(near, (n_dies * near + POOLED_AS * wide) / (n_dies + POOLED_AS))
    usual = float(np.median(spread[known])) if known.any() else 1.0
    held = np.maximum(pooled ** (1 / power), max(FLOOR * usual, least))
    return np.where(known, np.maximum(held, 0.7 * np.where(known, spread, 0)), np.nan).astype(np.float32)


def _with_edges(spread: Plane, middle: Plane) -> Plane:
    """A die that lies a little off its place, or between pixels, differs at edges: more than most dies show."""
    from scipy.ndimage import maximum_filter

    down, right = np.gradient(middle)
    bend = np.abs(np.gradient(down, axis=0)) + np.abs(np.gradient(right, axis=1))
    edge = EDGE_OFF_PX * np.hypot(down, right) + EDGE_BLUR * bend
    return np.hypot(spread, maximum_filter(np.nan_to_num(edge), 5)).astype(np.float32)


def _reach_px(shifts: NDArray[np.float32]) -> int:
    """How far into a cell its neighbours reach where dies lie off their places, and one pixel more."""
    return min(REACH_PX, 1 + math.ceil(MOST_OFF * robust_sigma(shifts)))


def _with_border(spread: Plane, middle: Plane, reach_px: int) -> Plane:
    """At the border of a cell what is seen is its neighbour's, which lies off its own place: a structure that crosses
    the middle of the street is longer or shorter there, on few dies so much that a robust spread does not tell."""
    inner = slice(reach_px, -reach_px), slice(reach_px, -reach_px)
    out = np.fmax(spread, relief(np.pad(middle, reach_px, "wrap"), 2 * reach_px + 1)[inner] - spread)
    out[inner] = spread[inner]
    return out


def robust_sigma(values: NDArray[np.float32]) -> float:
    """1.4826 MAD of what is known, of about twenty thousand values at most; NaN where nothing is."""
    some = values.ravel()[:: max(1, values.size // 20_000)]
    some = some[np.isfinite(some)]
    return float(np.median(np.abs(some - np.median(some)))) * MAD_TO_SIGMA if some.size else float("nan")


def _middle(planes: list[Plane]) -> Plane:
    stack = np.stack(planes)
    middle, spread = (np.empty(stack.shape[1:], np.float32) for _ in range(2))
    typical(stack, 1, middle, spread)
    return middle


def _median(plane: Plane) -> float:
    some = plane[::4, ::4]
    some = some[np.isfinite(some)]
    return float(np.median(some)) if some.size else 0.0


def _step(cell: Cell, model: Cell) -> NDArray[np.float64]:
    """How much further the cell lies than the model, (down, right), by its heights and its picture together."""
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for here, typical_one in zip(cell, model, strict=True):
        left = here - typical_one
        sigma = robust_sigma(left)
        if not sigma > 0:
            continue
        offset = _median(left)
        sums = shift_sums(here, np.ascontiguousarray(typical_one), offset, 6 * sigma)
        if sums[0, 0] < 100:
            continue
        normal += (sums[1:, 1:3] - np.outer(sums[1:, 0], sums[0, 1:3]) / sums[0, 0]) / sigma**2
        right += (sums[1:, 3] - sums[1:, 0] * sums[0, 3] / sums[0, 0]) / sigma**2
    if not np.linalg.det(normal) > 1e-6 * max(1e-12, np.trace(normal)) ** 2:
        return np.zeros(2)
    return -np.linalg.solve(normal, right).astype(np.float64)


def _held(shift: Shift, step: NDArray[np.float64]) -> Shift:
    """What would lead beyond the furthest that dies are off is no shift of theirs."""
    down, right = shift[0] + float(step[0]), shift[1] + float(step[1])
    return (down, right) if max(abs(down), abs(right)) <= FURTHEST_PX else shift


def _enough(cell: Cell) -> bool:
    return bool(np.isfinite(cell[0]).mean() > 0.3)


def _less_median(plane: Plane) -> Plane:
    return plane - np.float32(_median(plane))


def _patch(shape: tuple[int, int]) -> tuple[slice, slice]:
    rows, cols = (slice(max(0, (n - PATCH_PX) // 2), min(n, (n + PATCH_PX) // 2)) for n in shape)
    return rows, cols


def _blocks(rows: int, cols: int, n: int) -> list[slice]:
    side = max(16, BLOCK_PIXELS // max(1, cols * n))
    return [slice(start, min(rows, start + side)) for start in range(0, rows, side)]


def _with_street(layer: Plane, cells: CellGrid) -> Plane:
    out = np.full(cells.shape, np.nan, np.float32)
    top, left = cells.street
    part = layer[: cells.shape[0] - top, : cells.shape[1] - left]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out
