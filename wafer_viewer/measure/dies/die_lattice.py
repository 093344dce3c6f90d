"""The dies of a surface: pitches, angle and origin of their lattice, their size, found from heights and picture."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.dies.lattice_evidence import Coarse, Evidence, read_coarse, scanned_bounds
from wafer_viewer.measure.dies.lattice_refinement import Registered, cells_over, not_alike, refined
from wafer_viewer.measure.dies.periodicity import Periods, periods_of
from wafer_viewer.measure.dies.streets import Street, street_of
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

SURE_DIES = 9
"""Fewer that no street parts may be any few places that are alike."""
ACROSS, LEAST_ON_SURFACE = 10, 0.1
"""A die lies on the surface when so much of it does, by so many places across and up: less is no die."""
NO_STREET = "No street stands out along {}: a die is taken as large as its pitch, and where it begins is open."


def find_dies(surface: Mosaic, *, evidence: Evidence = "both") -> DieGrid:
    """The lattice of the dies of a surface: overlap-normalised autocorrelation of the whole, then dies registered.

    Column 0, row 0 is the lowest, leftmost place of the lattice that touches the surface. evidence: heights, the
    all-in-focus picture or both. u_pitch_um and u_origin_um say how well the lattice fits the surface, without the
    pixel scale.

    Raises DiesNotFound where nothing repeats along an axis, fewer than two whole dies lie on the surface, a few places
    are alike that no street parts, streets part them along one axis only, as in a single row of dies with pads, it is
    open whether a pitch or a part of it is meant, or dies are turned by more than 5 degrees.
    """
    coarse = read_coarse(surface, evidence)
    found = refined(surface, rough_grid(coarse, periods_of(coarse.layers)), evidence, coarse.pixel_um)
    grid = with_streets(found)
    _require_crossing_streets(grid)
    if found.n_dies < SURE_DIES and grid.street_x_um == grid.street_y_um == 0:
        raise not_alike(f"Only {found.n_dies}", found.lattice)
    return on_surface(grid, surface)


def _require_crossing_streets(grid: DieGrid) -> None:
    """Raise DiesNotFound where streets are seen along one axis only: across them, pads or bumps repeat, not dies."""
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
    """The pitches along x and y with their expanded uncertainties (k = 2): fit of the lattice and pixel scale."""
    reading = MeasurementContext.of(surface, None, calibration_valid)
    each = grid.pitch_x_um, grid.pitch_y_um
    if grid.by == "given" and not grid.u_pitch_um:
        return Length(value_um=each[0], status="not evaluated"), Length(value_um=each[1], status="not evaluated")
    lines = ({"fit of the lattice": grid.u_pitch_um, "pixel scale": um * reading.u_pixel_scale} for um in each)
    along_x, along_y = (reading.length(um, line) for um, line in zip(each, lines, strict=True))
    return along_x, along_y


def rough_grid(coarse: Coarse, periods: Periods) -> DieGrid:
    """The lattice about the middle of the surface, as the autocorrelation has it: where a die begins is open."""
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
    """The lattice with its dies between the streets of the median cell."""
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
    """(where the die begins along the cell's lines, its length), um."""
    if street is None:
        return first_um, pitch_um
    return first_um + way * (street.begin + street.width) * step_um, pitch_um - street.width * step_um


def on_surface(grid: DieGrid, surface: Mosaic) -> DieGrid:
    """The lattice numbered from the lowest, leftmost column and row that touch the surface.

    Places that do not touch it are left out. Raises MeasureError where none does.
    """
    cols, rows = touching(grid, surface)
    x_um, y_um = grid.corner(int(cols.min()), int(rows.min()))
    return over_surface(replace(grid, x0_um=x_um, y0_um=y_um), surface)


def over_surface(grid: DieGrid, surface: Mosaic) -> DieGrid:
    """The lattice, numbered as it is, as far as it touches the surface. Raises MeasureError where it does not."""
    cols, rows = touching(grid, surface)
    first_col, first_row = int(cols.min()), int(rows.min())
    n_cols, n_rows = int(np.ptp(cols)) + 1, int(np.ptp(rows)) + 1
    extent = {"first_col": first_col, "first_row": first_row, "cols": n_cols, "rows": n_rows}
    whole = replace(grid, **extent, left_out=(), named=False)
    on = {grid.name(*at) for at in zip(cols.tolist(), rows.tolist(), strict=True)}
    return replace(whole, left_out=tuple(name for at in whole.places if (name := grid.name(*at)) not in on))


def touching(grid: DieGrid, surface: Mosaic) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of the dies of which at least a tenth lies on what was scanned of the surface.

    Raises MeasureError where none does.
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
