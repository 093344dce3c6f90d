"""Dies that are given, by a job or by an operator, laid exactly over those that the surface shows. Pure.

Names stay as they were given. What is told is how far the given lattice lies off, so that a wafer that was aligned
badly is seen; one that lies beside its dies altogether is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.dies.die_lattice import touching, with_streets
from wafer_viewer.measure.dies.lattice_evidence import Evidence
from wafer_viewer.measure.dies.lattice_refinement import Registered, refined
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.die_offset import DieOffset
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

FARTHEST = 0.25
"""Of the shorter pitch: a lattice further off might as well belong to the next dies."""
SAME_STREET_PX = 6.0
"""A street that is seen is the one that was given where their widths differ by no more."""
BEGUN_PX = 50
"""Dies are registered from the level on at which the shorter pitch has about so many pixels."""


@dataclass(frozen=True, slots=True)
class FittedDies:
    """Dies as they lie on the surface, and how far off they were given; None where nothing was held against them."""

    grid: DieGrid
    off: DieOffset | None = None


def fitted_dies(surface: Mosaic, given: DieGrid, evidence: Evidence = "both") -> FittedDies:
    """Pitches and angle by dies registered to each other, the corner by the streets where they are as wide as given.

    Where the surface shows too little of its dies, they stay as given, and a note says why.

    Raises MeasureError where no given die lies on the surface, or they lie off those seen by a quarter of the pitch.
    """
    cols, rows = touching(given, surface)
    try:
        found = refined(surface, _cells(given), evidence, min(given.pitch_x_um, given.pitch_y_um) / BEGUN_PX)
    except MeasureError as fault:
        note = f"The dies are used as given, because they cannot be found on the surface: {fault}"
        return FittedDies(replace(given, notes=(*given.notes, note)))
    seen = _seen(found, given, surface.pixel_um)
    off = _offset(given, seen, cols, rows)
    if off.farthest_um > FARTHEST * min(given.pitch_x_um, given.pitch_y_um):
        raise MeasureError(
            f"The dies as given lie {off.farthest_um:.0f} um off those that the surface shows, over a quarter of their "
            "pitch: give the corner of a die and the pitches again, or leave them out to have the dies found."
        )
    note = f"The dies lie up to {off.farthest_um:.2g} um off where they were given, and are taken as they lie."
    return FittedDies(replace(seen, notes=(*seen.notes, note)), off)


def _cells(given: DieGrid) -> DieGrid:
    """The same lattice with dies as large as the pitches, round the same middles."""
    x_um, y_um = given.to_stage(0, 0, -given.street_x_um / 2, -given.street_y_um / 2)
    return replace(given, x0_um=float(x_um), y0_um=float(y_um), width_um=given.pitch_x_um, height_um=given.pitch_y_um)


def _seen(found: Registered, given: DieGrid, pixel_um: float) -> DieGrid:
    """The given dies, of the given size, where they are seen; along an axis without such a street the middle stays."""
    lattice, seen = found.grid, with_streets(found)
    _, _, u, v = lattice.to_die(*seen.to_stage(0, 0, seen.width_um / 2, seen.height_um / 2))
    along_x = _middle(float(u), lattice.pitch_x_um, abs(seen.width_um - given.width_um) / pixel_um)
    along_y = _middle(float(v), lattice.pitch_y_um, abs(seen.height_um - given.height_um) / pixel_um)
    open_axes = [axis for axis, at in (("x", along_x), ("y", along_y)) if at is None]
    notes = (f"No street as wide as given is seen along {' and '.join(open_axes)}: where dies begin is as given.",)
    middle = along_x or lattice.pitch_x_um / 2, along_y or lattice.pitch_y_um / 2
    x_um, y_um = lattice.to_stage(0, 0, middle[0] - given.width_um / 2, middle[1] - given.height_um / 2)
    return replace(
        seen,
        x0_um=float(x_um),
        y0_um=float(y_um),
        width_um=min(given.width_um, seen.pitch_x_um),
        height_um=min(given.height_um, seen.pitch_y_um),
        by="given",
        notes=given.notes + (notes if open_axes else ()),
    )


def _middle(at_um: float, pitch_um: float, differs_px: float) -> float | None:
    """Where the middle of a die lies in its cell; None where the street that is seen is another one."""
    if differs_px > SAME_STREET_PX:
        return None
    return pitch_um / 2 + math.remainder(at_um - pitch_um / 2, pitch_um)


def _offset(given: DieGrid, seen: DieGrid, cols: np.ndarray, rows: np.ndarray) -> DieOffset:
    origin = np.subtract(seen.corner(0, 0), given.corner(0, 0))
    each = np.hypot(*np.subtract(seen.to_stage(cols, rows), given.to_stage(cols, rows)))
    return DieOffset(
        origin_x_um=float(origin[0]),
        origin_y_um=float(origin[1]),
        pitch_x_ppm=(seen.pitch_x_um / given.pitch_x_um - 1) * 1e6,
        pitch_y_ppm=(seen.pitch_y_um / given.pitch_y_um - 1) * 1e6,
        turn_mrad=(seen.angle_rad - given.angle_rad) * 1e3,
        farthest_um=float(each.max()),
    )
