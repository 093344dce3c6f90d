"""Die lattice of a surface: pitches, angle, origin and die size, from heights and image."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.dies.lattice_evidence import Coarse, Evidence, read_coarse, scanned_bounds
from wafer_viewer.measure.dies.lattice_refinement import Registered, cells_over, dissimilar_cells_error, refined
from wafer_viewer.measure.dies.periodicity import Periods, periods_of
from wafer_viewer.measure.dies.streets import Street, street_of
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

SURE_DIES = 9
"""Number of dies accepted without streets; fewer may be any similar places."""
ACROSS, LEAST_ON_SURFACE = 10, 0.1
"""Sample points across and up a die, and the smallest fraction of them on the surface."""
NO_STREET = "No street stands out along {}: a die is taken as large as its pitch, and where it begins is open."


def find_dies(surface: Mosaic, *, evidence: Evidence = "both") -> DieGrid:
    """Find the die lattice of a surface.

    The pitches and the angle come from the overlap-normalised autocorrelation, and are refined by registering dies to
    their median. The size and the corner of a die come from the streets of the median cell.

    Parameters
    ----------
    surface : Mosaic
        The surface; heights are read from the layer that its recipe measures on.
    evidence : {"height", "picture", "both"}, default "both"
        Layers to search: the heights, the all-in-focus image or both.

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
        If the surface shows no contrast; nothing repeats along an axis within half of the surface; fewer than two
        complete dies lie on the surface; too few of the places that repeat look alike; fewer than nine similar places
        have no streets; streets exist along one axis only, as in a single row of dies with pads; the pitch is ambiguous
        with a fraction of it; or the dies are off square or turned by more than 5 degrees. Its `brief` gives the reason
        in a few words.
    MeasureError
        If no die of the lattice lies on the scanned surface, or the lattice has more than 100 000 places.
        `DiesNotFound` is a subclass.
    KeyError
        If `evidence` is none of the three.

    Notes
    -----
    A die touches the surface if at least a tenth of its area lies on the scanned part; other places are in `left_out`.

    References
    ----------
    D. Padfield, Masked object registration in the Fourier domain, IEEE Trans. Image Process. 21 (2012) 2706: the
    cross-correlation by which dies are registered.
    """
    coarse = read_coarse(surface, evidence)
    found = refined(surface, rough_grid(coarse, periods_of(coarse.layers)), evidence, coarse.pixel_um)
    grid = with_streets(found)
    _require_crossing_streets(grid)
    if found.n_dies < SURE_DIES and grid.street_x_um == grid.street_y_um == 0:
        raise dissimilar_cells_error(f"Only {found.n_dies}", found.lattice)
    return on_surface(grid, surface)


def _require_crossing_streets(grid: DieGrid) -> None:
    """Raise DiesNotFound where streets exist along one axis only: pads or bumps repeat across them."""
    if (grid.street_x_um > 0) == (grid.street_y_um > 0):
        return
    along, across, pitch_um = ("x", "y", grid.pitch_y_um) if grid.street_x_um > 0 else ("y", "x", grid.pitch_x_um)
    what = "row" if along == "x" else "column"
    raise DiesNotFound(
        f"Streets part the dies along {along} only, and what repeats every {pitch_um:.1f} um along {across} may be "
        f"pads: scan at least two dies along {across}, or give pitch, origin and size of the dies instead.",
        f"One {what} of dies found, 2 needed",
    )


def pitches(surface: Mosaic, grid: DieGrid, *, calibration_valid: bool = True) -> tuple[Length, Length]:
    """Return the pitches along x and y with expanded uncertainties (k = 2) from lattice fit and pixel scale."""
    reading = MeasurementContext.of(surface, None, calibration_valid)
    each = grid.pitch_x_um, grid.pitch_y_um
    if grid.by == "given" and not grid.u_pitch_um:
        return Length(value_um=each[0], status="not evaluated"), Length(value_um=each[1], status="not evaluated")
    lines = ({"fit of the lattice": grid.u_pitch_um, "pixel scale": um * reading.u_pixel_scale} for um in each)
    along_x, along_y = (reading.length(um, line) for um, line in zip(each, lines, strict=True))
    return along_x, along_y


def rough_grid(coarse: Coarse, periods: Periods) -> DieGrid:
    """Return the lattice from the autocorrelation, about the centre of the surface; the die origin is undetermined."""
    rows, cols = coarse.shape
    pitch_x, pitch_y = periods.pitch_x * coarse.pixel_um, periods.pitch_y * coarse.pixel_um
    return DieGrid(
        pitch_x_um=pitch_x,
        pitch_y_um=pitch_y,
        width_um=pitch_x,
        height_um=pitch_y,
        x0_um=coarse.x0_um + cols / 2 * coarse.pixel_um,
        y0_um=coarse.y0_um - rows / 2 * coarse.pixel_um,
        angle_rad=periods.angle_rad,
        by="found",
    )


def with_streets(found: Registered) -> DieGrid:
    """Return the lattice with die size and origin from the streets of the median cell."""
    grid, lattice = found.grid, found.lattice
    upright, level = street_of(found.cell, upright=True), street_of(found.cell, upright=False)
    u_first, v_first = (float(axis.ravel()[0]) for axis in lattice.places(grid))
    left, width = _die_between(upright, u_first, lattice.step_x_um, grid.pitch_x_um, 1)
    top, height = _die_between(level, v_first, lattice.step_y_um, grid.pitch_y_um, -1)
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


def _die_between(
    street: Street | None, first_um: float, step_um: float, pitch_um: float, way: Literal[1, -1]
) -> tuple[float, float]:
    """Return the start of the die along the cell's lines and its length, um."""
    if street is None:
        return first_um, pitch_um
    return first_um + way * (street.begin + street.width) * step_um, pitch_um - street.width * step_um


def on_surface(grid: DieGrid, surface: Mosaic) -> DieGrid:
    """Return the lattice numbered from the lowest, leftmost column and row that touch the surface.

    Places that do not touch it are left out. Raises MeasureError where none does.
    """
    cols, rows = touching(grid, surface)
    x_um, y_um = grid.corner(int(cols.min()), int(rows.min()))
    return over_surface(replace(grid, x0_um=x_um, y0_um=y_um), surface)


def over_surface(grid: DieGrid, surface: Mosaic) -> DieGrid:
    """Return the lattice cropped to the surface, with its numbering. Raises MeasureError where they do not overlap."""
    cols, rows = touching(grid, surface)
    first_col, first_row = int(cols.min()), int(rows.min())
    n_cols, n_rows = int(np.ptp(cols)) + 1, int(np.ptp(rows)) + 1
    extent = {"first_col": first_col, "first_row": first_row, "cols": n_cols, "rows": n_rows}
    whole = replace(grid, **extent, left_out=(), named=False)
    on = {grid.name(*at) for at in zip(cols.tolist(), rows.tolist(), strict=True)}
    return replace(whole, left_out=tuple(name for at in whole.places if (name := grid.name(*at)) not in on))


def touching(grid: DieGrid, surface: Mosaic) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows of the dies with at least a tenth of their area on the scanned surface.

    Raises MeasureError where there is none.
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
