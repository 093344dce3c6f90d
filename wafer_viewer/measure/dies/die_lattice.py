"""Die lattice of a surface: pitches, angle, origin, die size and streets, from heights and image."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, MeasurementContext
from wafer_viewer.measure.dies.lattice_evidence import Coarse, Evidence, read_coarse, scanned_bounds
from wafer_viewer.measure.dies.lattice_refinement import Registered, Single, cells_over, dissimilar_cells, refined
from wafer_viewer.measure.dies.pattern_gradients import MEND, vertex
from wafer_viewer.measure.dies.periodicity import Periods, periods_of
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, ProductDies
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace, require_choice
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.jit import Float32s
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA


@dataclass(frozen=True, slots=True)
class StreetParameters:
    """Limits of the search for the street of a cell.

    Parameters
    ----------
    widest : float
        Largest width of a street, relative to the pitch.
    narrowest_px : int, px
        Smallest width of a street.
    stands_out : float
        Smallest prominence of both street edges, in robust deviations of the edge profile.
    sure : float
        Prominence from which layers are alike.
    interrupted : float
        Largest fraction of lines that do not show an edge: other streets cross it there.
    most_edges : int
        Largest number of edges of which pairs are formed.
    uneven : float
        Range of the levels along a street, relative to its step, at which its pair of edges counts half.
    even : float
        Level from which a pair of edges need not be prominent.
    unclear : float
        Level below which the size of dies is not clear.
    ends : float
        Quantile at both ends beyond which levels are outliers.
    most_differing_px : float, px
        Largest difference of begin and width, added, of the same street in two layers.
    on_top : float
        Weight of both edges relative to the weaker one; it breaks ties near the maximum of a strong edge.
    bands : int
        Number of bands of the cell; the scatter of the edges between them gives their uncertainty.
    least_valid : float
        Smallest known fraction of a layer that is searched.
    least_cols : int, px
        Smallest number of columns of a cell.
    off_px : float, px
        Largest difference in width from a known street.

    Notes
    -----
    `tests/bench/bench_dies.py` counts the lattices found, missed and wrong with these values on made-up wafers.
    """

    widest: float = 0.3
    narrowest_px: int = 2
    stands_out: float = 6.0
    sure: float = 18.0
    interrupted: float = 0.3
    most_edges: int = 24
    uneven: float = 0.5
    even: float = 0.5
    unclear: float = 0.3
    ends: float = 0.03
    most_differing_px: float = 8
    on_top: float = 1e-3
    bands: int = 4
    least_valid: float = 0.3
    least_cols: int = 8
    off_px: float = 2.5


STREET = StreetParameters()


@dataclass(frozen=True, slots=True)
class Street:
    """A street across a cell, px from its first line: begin, width, standard uncertainty of an edge, prominence.

    level: how level it is along its length, 0 to 1.
    """

    begin: float
    width: float
    u_px: float
    clear: float
    level: float


def street_of(layers: Sequence[Float32s], upright: bool, width_px: float | None = None) -> Street | None:
    """Return the street that runs down a cell (upright) or across it; None without one.

    Taken from the first layer that shows it well, else from the one that shows it best. Heights take precedence: the
    image is blurred at the walls of a street. The cell repeats, so a street may cross its border.
    width_px: known width.
    """
    planes = [
        _filled(layer if upright else layer.T) for layer in layers if np.isfinite(layer).mean() > STREET.least_valid
    ]
    found = [street for plane in planes if (street := _street(plane, width_px)) is not None]
    if not found:
        return None
    first = found[0]
    if first.clear < STREET.sure or first.level < STREET.even:
        first = max(found, key=lambda street: street.level * min(street.clear, STREET.sure))
    return dataclasses.replace(first, u_px=math.hypot(first.u_px, _differing(first, found)))


def _differing(best: Street, found: Sequence[Street]) -> float:
    """Return the standard uncertainty of an edge due to the difference between layers: half of it, rectangular."""
    other = [
        one for one in found if abs(one.begin - best.begin) + abs(one.width - best.width) < STREET.most_differing_px
    ]
    each = [max(abs(one.begin - best.begin), abs(one.begin + one.width - best.begin - best.width)) for one in other]
    return max(each) / 2 / math.sqrt(3)


def _filled(plane: Float32s) -> Floats:
    """Interpolate unknown pixels along each line: heights at a wall are often unmeasured."""
    filled, places = plane.astype(np.float64), np.arange(plane.shape[1])
    for line in filled:
        finite = np.isfinite(line)
        if finite.any() and not finite.all():
            line[~finite] = np.interp(places[~finite], places[finite], line[finite], period=len(line))
    return filled[np.isfinite(filled).all(axis=1)]


def _street(plane: Floats, width_px: float | None) -> Street | None:
    """Return the pair of opposite edges that is strong and has a level strip between, to its ends; None without one.

    Between pads or lines the strip ends where a street crosses it; a street goes on.
    """
    if len(plane) < STREET.bands or plane.shape[1] < STREET.least_cols:
        return None
    plane = _upright(plane)
    slope = edges_profile(plane)
    spread = MAD_TO_SIGMA * float(np.median(np.abs(slope - np.median(slope)))) or float(np.abs(slope).max()) / 1e3
    pairs = _strong_pairs(slope, width_px) if spread else []
    if not pairs:
        return None
    levels = [_level(plane, begin, width) for _, begin, width in pairs]
    best = max(range(len(pairs)), key=lambda k: pairs[k][0] * levels[k])
    strength, begin, width = pairs[best]
    if width_px is None and strength < STREET.stands_out * spread and levels[best] < STREET.even:
        return None
    edges = [_between(slope, begin), _between(slope, begin + width)]
    u_px = math.hypot(*(_scatter(plane, round(edge)) for edge in edges)) / math.sqrt(2)
    return Street(edges[0], edges[1] - edges[0], u_px, strength / spread, levels[best])


def _upright(plane: Floats) -> Floats:
    """Subtract the median slope along the lines: the street tilts the plane of the cell."""
    each = np.diff(np.median(plane, axis=0))
    return plane - float(np.median(each)) * np.arange(plane.shape[1])


def edges_profile(plane: Floats) -> Floats:
    """Return the slope along the lines that all but `STREET.interrupted` of them exceed; 0 where signs differ."""
    from scipy.ndimage import gaussian_filter1d

    smooth = np.asarray(gaussian_filter1d(plane, 1.0, axis=1, mode="wrap"))
    slopes = (np.roll(smooth, -1, axis=1) - np.roll(smooth, 1, axis=1)) / 2
    low, high = np.quantile(slopes, [STREET.interrupted, 1 - STREET.interrupted], axis=0)
    return np.asarray(np.clip(low, 0, None) + np.clip(high, None, 0), np.float64)


def _strong_pairs(slope: Floats, width_px: float | None) -> list[tuple[float, int, int]]:
    """Return (strength of the weaker edge, begin, width) of the pairs of opposite edges, the strongest first.

    width_px: known width, from which those of the pairs differ by a few pixels at most.
    """
    size = np.abs(slope)
    edges = np.flatnonzero((size > 0) & (size >= np.roll(size, 1)) & (size > np.roll(size, -1)))
    strongest = edges[np.argsort(-size[edges])][: STREET.most_edges]
    most = math.floor(STREET.widest * len(slope))
    pairs = [
        (float(min(size[a], size[b]) + STREET.on_top * (size[a] + size[b])), int(a), int((b - a) % len(slope)))
        for a in strongest
        for b in strongest
        if slope[a] * slope[b] < 0
    ]
    low, high = (
        (STREET.narrowest_px, most) if width_px is None else (width_px - STREET.off_px, width_px + STREET.off_px)
    )
    return sorted((pair for pair in pairs if low <= pair[2] <= high), reverse=True)


def _level(plane: Floats, begin: int, width: int) -> float:
    """Return how level the strip between two edges is along the lines, 0 to 1, beside the step at the edges."""
    n = plane.shape[1]
    inset = 1 if width <= 4 else 2
    strip = plane[:, np.arange(begin + inset, begin + max(width - inset, inset) + 1) % n].mean(axis=1)
    beside = plane[:, [(begin - 2) % n, (begin + width + 2) % n]].mean(axis=1)
    step = abs(float(np.median(beside - strip)))
    lines = np.arange(len(strip)) - (len(strip) - 1) / 2
    strip = strip - lines * float(lines @ strip) / float(lines @ lines)
    low, high = np.quantile(strip, [STREET.ends, 1 - STREET.ends]).tolist()
    return 1 / (1 + ((high - low) / (STREET.uneven * step)) ** 2) if step else 0.0


def _between(slope: Floats, place: int) -> float:
    """Return the subpixel position of an edge."""
    n = len(slope)
    steep = np.abs(slope[[(place + k) % n for k in (-1, 0, 1)]])
    return place + vertex(*steep.tolist())


def _scatter(plane: Floats, place: int) -> float:
    """Return the standard uncertainty of the mean edge position, from bands of the cell."""
    each = np.array([_near(edges_profile(part), place) for part in np.array_split(plane, STREET.bands)])
    middle = float(np.median(each))
    return MAD_TO_SIGMA * float(np.median(np.abs(each - middle))) / math.sqrt(STREET.bands)


def _near(slope: Floats, place: int, reach: int = 3) -> float:
    around = (place + np.arange(-reach, reach + 1)) % len(slope)
    top = int(np.argmax(np.abs(slope[around]))) - reach
    return _between(slope, place + top)


MARGIN_PX = 6.0
"""Margin of a cell beyond the pattern of a single row, px of the coarse surface."""
BORDER_PX = 1.2
"""Distance from the border of the coarse surface, px, within which a pattern goes on beyond it."""
ONE_DIE = 1.15
"""Extent of the pattern along an axis, in known pitches, below which there is one die only; `bench_dies.py --given`."""
SURE_DIES = 9
"""Number of dies accepted without streets; fewer may be any similar places."""
ACROSS = 10
"""Number of sample points across a die and up it, used to determine its area on the surface."""
LEAST_ON_SURFACE = 0.1
"""Smallest fraction of them on the scanned surface, for a die that touches it."""
NO_STREET = "No street stands out along {}: a die is taken as large as its pitch, and where it begins is open."


def find_dies(surface: Mosaic, *, evidence: Evidence = "both", size: ProductDies | None = None) -> DieGrid:
    """Find the die lattice of a surface.

    The pitches come from the lags at which all columns, or all rows, of the pattern are similar, and are refined by
    registering dies to their median. The size and the corner of a die come from the streets of the median cell.

    Parameters
    ----------
    surface : Mosaic
        The surface; heights are read from the layer that its recipe measures on.
    evidence : {"height", "picture", "both"}, default "both"
        Layers to search: the heights, the all-in-focus image or both.
    size : ProductDies, optional
        Pitches of the product's dies, in um, and their size if known. They are searched next to these pitches, to 3 %,
        which tells dies from pads and lines, and keep the size.

    Returns
    -------
    DieGrid
        The lattice, with `by` "found", lengths in um, the angle in rad (anticlockwise). Column 0, row 0 is the lowest,
        leftmost place of the lattice that touches the surface. `u_pitch_um` and `u_origin_um` are standard
        uncertainties (k = 1) of the lattice fit, that of the origin with the street edges; the pixel scale is not
        included. `notes` name the number of registered dies and every axis without a street, along which a die is taken
        as large as its pitch.

    Raises
    ------
    DiesNotFound
        If the surface shows no contrast; nothing repeats; fewer than two complete dies lie on the surface; too few of
        the places that repeat look alike; fewer than nine similar places have no streets; a pitch is ambiguous, as
        where pads or lines repeat and no streets part the dies; the edges of streets are not clear; or the dies are
        turned by more than 5 degrees.
    MeasureError
        If no die of the lattice lies on the scanned surface, or the lattice has more than 100 000 places.
        `DiesNotFound` is a subclass.
    KeyError
        If `evidence` is none of the three.

    Notes
    -----
    A single row or column is found by the edges of its dies; along the axis that it has one die of, the pitch is the
    length of the pattern with a margin.

    A die touches the surface if at least a tenth of its area lies on the scanned part; other places are in `left_out`.

    References
    ----------
    D. Padfield, Masked object registration in the Fourier domain, IEEE Trans. Image Process. 21 (2012) 2706: the
    cross-correlation by which dies are registered.
    """
    require_choice("evidence", evidence, Evidence, MeasureError)
    coarse = read_coarse(surface, evidence)
    pitch_px = (size.pitch_x_um / coarse.pixel_um, size.pitch_y_um / coarse.pixel_um) if size is not None else None
    periods = periods_of(coarse.layers, pitch_px)
    found = refined(surface, rough_grid(coarse, periods), evidence, coarse.pixel_um, _single(periods), coarse.pixel_um)
    grid = with_streets(found, size)
    if size is None:
        _require_size(grid, periods, found)
        _require_ends(grid, _single(periods))
    if size is None and found.n_dies < SURE_DIES and grid.street_x_um == grid.street_y_um == 0:
        raise DiesNotFound(dissimilar_cells(f"Only {found.n_dies}", found.lattice))
    return on_surface(grid, surface, _single(periods))


def _single(periods: Periods) -> Single:
    """Return the axes, x and y, along which the pattern is that of one die."""
    along = ((periods.pitch_x, periods.right), (periods.pitch_y, periods.up))
    x, y = (pitch is None or high - low < ONE_DIE * pitch for pitch, (low, high) in along)
    return x, y


def _require_size(grid: DieGrid, periods: Periods, found: Registered) -> None:
    """Raise DiesNotFound where streets recur along an axis and their edges are not clear."""
    for axis, recurs in zip("xy", periods.streets, strict=True):
        street = street_of(found.cell, upright=axis == "x") if recurs else None
        if recurs and (street is None or street.level < STREET.unclear):
            raise DiesNotFound(
                f"The dies repeat every {grid.pitch_x_um:.1f} x {grid.pitch_y_um:.1f} um, and the edges of the streets "
                f"between them along {axis} are not clear: {MEND}."
            )


def _require_ends(grid: DieGrid, single: Single) -> None:
    """Raise DiesNotFound where the edges of the dies of a single row or column do not show."""
    if any(single) and (grid.street_x_um == 0 or grid.street_y_um == 0):
        what, axis = ("column", "x") if single[0] else ("row", "y")
        raise DiesNotFound(
            f"One {what} of dies repeats every {grid.pitch_y_um if single[0] else grid.pitch_x_um:.1f} um, and where "
            f"its dies begin and end does not show along both axes: scan at least two dies along {axis}, or give "
            "pitch, origin and size of the dies instead."
        )


def pitches(surface: Mosaic, grid: DieGrid, *, calibration_valid: bool = True) -> tuple[Length, Length]:
    """Return the pitches along x and y with expanded uncertainties (k = 2) from lattice fit and pixel scale."""
    reading = MeasurementContext.of(surface, None, calibration_valid)
    each = grid.pitch_x_um, grid.pitch_y_um
    if grid.by == "given" and not grid.u_pitch_um:
        return Length(value_um=each[0], status="not evaluated"), Length(value_um=each[1], status="not evaluated")
    lines = ({"fit of the lattice": grid.u_pitch_um, PIXEL_SCALE: um * reading.u_pixel_scale} for um in each)
    along_x, along_y = (reading.length(um, line) for um, line in zip(each, lines, strict=True))
    return along_x, along_y


def rough_grid(coarse: Coarse, periods: Periods) -> DieGrid:
    """Return the lattice of the periods with cells as large as the pitches; the origin of a die is undetermined.

    Along an axis of a single row the cell covers the pattern and a margin.
    """
    rows, cols = coarse.shape
    along = _cell(periods.pitch_x, periods.right, coarse.pixel_um, cols, _single(periods)[0])
    up = _cell(periods.pitch_y, periods.up, coarse.pixel_um, rows, _single(periods)[1])
    c, s = math.cos(periods.angle_rad), math.sin(periods.angle_rad)
    return DieGrid(
        pitch_x_um=along[1],
        pitch_y_um=up[1],
        width_um=along[1],
        height_um=up[1],
        x0_um=coarse.x0_um + (cols - 1) / 2 * coarse.pixel_um + c * along[0] - s * up[0],
        y0_um=coarse.y0_um - (rows - 1) / 2 * coarse.pixel_um + s * along[0] + c * up[0],
        angle_rad=periods.angle_rad,
        by="found",
    )


def _cell(
    pitch_px: float | None, extent_px: tuple[float, float], pixel_um: float, n_px: int, single: bool
) -> tuple[float, float]:
    """Return the begin of a cell from the centre of the surface, and its length, um.

    The cells of an array that does not reach the borders lie about its middle, so that streets part them.
    """
    low, high = extent_px
    if pitch_px is None:
        return (low - MARGIN_PX) * pixel_um, (high - low + 2 * MARGIN_PX) * pixel_um
    if single:
        return ((low + high) / 2 - pitch_px / 2) * pixel_um, pitch_px * pixel_um
    if max(-low, high) > n_px / 2 - BORDER_PX:
        return 0.0, pitch_px * pixel_um
    n_dies = math.ceil((high - low) / pitch_px - 0.1)
    return ((low + high) / 2 - n_dies / 2 * pitch_px) * pixel_um, pitch_px * pixel_um


def with_streets(found: Registered, size: ProductDies | None = None) -> DieGrid:
    """Return the lattice with die size and origin from the streets of the median cell; dies keep a known size."""
    grid, lattice = found.grid, found.lattice
    known = _known_streets(size, grid)
    widths_px = [um / step for um, step in zip(known, (lattice.step_x_um, lattice.step_y_um), strict=True)]
    upright, level = (
        street_of(found.cell, upright, width_px or None)
        for upright, width_px in zip((True, False), widths_px, strict=True)
    )
    u_first, v_first = (float(axis.ravel()[0]) for axis in lattice.places(grid))
    left, width = _die_between(upright, u_first, lattice.step_x_um, grid.pitch_x_um, 1, known[0])
    top, height = _die_between(level, v_first, lattice.step_y_um, grid.pitch_y_um, -1, known[1])
    x_um, y_um = grid.to_stage(0, 0, left, top - height)
    step_um = max(lattice.step_x_um, lattice.step_y_um)
    edges_um = [street.u_px * step_um for street in (upright, level) if street is not None]
    notes = tuple(NO_STREET.format(axis) for axis, street in (("x", upright), ("y", level)) if street is None)
    return replace(
        grid,
        x0_um=float(x_um),
        y0_um=float(y_um),
        width_um=width,
        height_um=height,
        u_origin_um=math.hypot(grid.u_origin_um, max(edges_um, default=0.0)),
        notes=(f"{found.n_dies} dies were registered.", *notes),
    )


def _known_streets(size: ProductDies | None, grid: DieGrid) -> tuple[float, float]:
    """Return the widths of the streets along x and y of dies of a known size, um; 0 where it is not known."""
    if size is None:
        return 0.0, 0.0
    width, height = size.width_um or grid.pitch_x_um, size.height_um or grid.pitch_y_um
    return max(0.0, grid.pitch_x_um - width), max(0.0, grid.pitch_y_um - height)


def _die_between(
    street: Street | None, first_um: float, step_um: float, pitch_um: float, step: Literal[1, -1], known_um: float = 0.0
) -> tuple[float, float]:
    """Return the start of the die along the cell's lines and its length, um.

    It is the die with most of its length in the cell. One of a known size without a visible street lies in the middle.
    """
    if street is None:
        return first_um + step * known_um / 2, pitch_um - known_um
    width_um = known_um or street.width * step_um
    off_um = math.remainder((street.begin + street.width / 2) * step_um, pitch_um)
    return first_um + step * (off_um + width_um / 2), pitch_um - width_um


def on_surface(grid: DieGrid, surface: Mosaic, single: Single = (False, False)) -> DieGrid:
    """Return the lattice numbered from the lowest, leftmost column and row that touch the surface.

    single: axes, x and y, along which there is one die only, that of column or row 0. Places that do not touch the
    surface are left out. Raises MeasureError where none does.
    """
    cols, rows = touching(grid, surface)
    dies = ~(single[0] & (cols != 0)) & ~(single[1] & (rows != 0))
    cols, rows = cols[dies], rows[dies]
    x_um, y_um = grid.corner(int(cols.min()), int(rows.min()))
    return _covering(replace(grid, x0_um=x_um, y0_um=y_um), cols - cols.min(), rows - rows.min())


def over_surface(grid: DieGrid, surface: Mosaic) -> DieGrid:
    """Return the lattice cropped to the surface, with its numbering. Raises MeasureError where they do not overlap."""
    return _covering(grid, *touching(grid, surface))


def _covering(grid: DieGrid, cols: np.ndarray, rows: np.ndarray) -> DieGrid:
    """Return the lattice over dies, without the others among them."""
    first_col, first_row = int(cols.min()), int(rows.min())
    n_cols, n_rows = int(np.ptp(cols)) + 1, int(np.ptp(rows)) + 1
    extent = {"first_col": first_col, "first_row": first_row, "cols": n_cols, "rows": n_rows}
    covering = replace(grid, **extent, left_out=(), named=False)
    on = {grid.name(*die) for die in zip(cols.tolist(), rows.tolist(), strict=True)}
    return replace(covering, left_out=tuple(name for die in covering.places if (name := grid.name(*die)) not in on))


def touching(grid: DieGrid, surface: Mosaic) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows of the dies with at least a tenth of their area on the scanned surface.

    Raises
    ------
    MeasureError
        If there is none.
    """
    low_x, low_y, high_x, high_y = scanned_bounds(surface)
    cols, rows = cells_over(grid, (low_x, low_y, high_x, high_y))
    share = (np.arange(ACROSS) + 0.5) / ACROSS
    u, v = grid.width_um * np.tile(share, ACROSS), grid.height_um * np.repeat(share, ACROSS)
    x_um, y_um = grid.to_stage(cols[:, None], rows[:, None], u, v)
    on = ((x_um > low_x) & (x_um < high_x) & (y_um > low_y) & (y_um < high_y)).mean(axis=1) >= LEAST_ON_SURFACE
    if not on.any():
        raise MeasureError("No die of the lattice lies on the surface: give an origin and a pitch that fit it.")
    return cols[on], rows[on]
