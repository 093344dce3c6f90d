"""Fit of a given die lattice, from a job or an operator, to the dies of the surface. Pure.

Names stay as given. The reported offset of the given lattice reveals a poorly aligned wafer; a lattice that misses its
dies is rejected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.dies.die_lattice import touching, with_streets
from wafer_viewer.measure.dies.lattice_evidence import Evidence
from wafer_viewer.measure.dies.lattice_refinement import Registered, refined
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, DieOffset
from wafer_viewer.model.spec import replace, require_choice
from wafer_viewer.model.surface.height_map import Mosaic

FARTHEST = 0.25
"""Largest offset relative to the shorter pitch; further off the dies are ambiguous with their neighbours."""
SAME_STREET_PX = 6.0
"""Largest difference in width between a detected street and the given one."""
BEGUN_PX = 50
"""Approximate number of pixels of the shorter pitch at the level where registration starts."""


@dataclass(frozen=True, slots=True)
class FittedDies:
    """Dies as found on the surface, and the offset of the given ones; None where they could not be compared."""

    grid: DieGrid
    off: DieOffset | None = None


def fitted_dies(surface: Mosaic, given: DieGrid, evidence: Evidence = "both") -> FittedDies:
    """Fit a given die lattice to the dies of a surface.

    The pitches and the angle are fitted by registering dies, and the corner by streets as wide as given. Where the
    surface shows too little of its dies, they stay as given, with a note.

    Parameters
    ----------
    surface : Mosaic
        The surface; heights are read from the layer that its recipe measures on.
    given : DieGrid
        The lattice from a job or an operator, in stage um.
    evidence : {"height", "picture", "both"}, default "both"
        Layers to register: the heights, the all-in-focus image or both.

    Returns
    -------
    FittedDies
        `grid`: the dies as found, with the names of the given ones and a note on their offset. `off`: the offset of the
        found lattice from the given one, `farthest_um` over the corners of all dies on the surface; None where the two
        could not be compared.

    Raises
    ------
    MeasureError
        If no given die has a tenth of its area on the scanned surface, or the given dies are off by more than a quarter
        of the shorter pitch, beyond which they are ambiguous with their neighbours.
    KeyError
        If `evidence` is none of the three.

    Notes
    -----
    Dies keep their given size, up to the fitted pitch. A street matches if its width differs from the given one by at
    most 6 px; along an axis without a matching street the die begins as given, with a note. The offset reveals a poorly
    aligned wafer.

    References
    ----------
    D. Padfield, Masked object registration in the Fourier domain, IEEE Trans. Image Process. 21 (2012) 2706: the
    cross-correlation by which dies are registered.
    """
    require_choice("evidence", evidence, Evidence, MeasureError)
    cols, rows = touching(given, surface)
    try:
        found = refined(surface, _cells(given), evidence, min(given.pitch_x_um, given.pitch_y_um) / BEGUN_PX)
    except MeasureError as fault:
        note = f"The dies are used as given, because they cannot be found on the surface: {fault}"
        return FittedDies(replace(given, notes=(*given.notes, note)))
    detected = _detected(found, given, surface.pixel_um)
    off = _offset(given, detected, cols, rows)
    if off.farthest_um > FARTHEST * min(given.pitch_x_um, given.pitch_y_um):
        raise MeasureError(
            f"The dies as given lie {off.farthest_um:.0f} um off those that the surface shows, over a quarter of their "
            "pitch: give the corner of a die and the pitches again, or leave them out to have the dies found."
        )
    note = f"The dies lie up to {off.farthest_um:.2g} um off where they were given, and are taken as they lie."
    return FittedDies(replace(detected, notes=(*detected.notes, note)), off)


def _cells(given: DieGrid) -> DieGrid:
    """Return the same lattice with dies as large as the pitches, about the same centres."""
    x_um, y_um = given.to_stage(0, 0, -given.street_x_um / 2, -given.street_y_um / 2)
    return replace(given, x0_um=float(x_um), y0_um=float(y_um), width_um=given.pitch_x_um, height_um=given.pitch_y_um)


def _detected(found: Registered, given: DieGrid, pixel_um: float) -> DieGrid:
    """Return the given dies, of the given size, as located; an axis without a matching street keeps the centre."""
    lattice, detected = found.grid, with_streets(found)
    _, _, u, v = lattice.to_die(*detected.to_stage(0, 0, detected.width_um / 2, detected.height_um / 2))
    along_x = _middle(float(u), lattice.pitch_x_um, abs(detected.width_um - given.width_um) / pixel_um)
    along_y = _middle(float(v), lattice.pitch_y_um, abs(detected.height_um - given.height_um) / pixel_um)
    open_axes = [axis for axis, position in (("x", along_x), ("y", along_y)) if position is None]
    notes = (f"No street as wide as given is seen along {' and '.join(open_axes)}: where dies begin is as given.",)
    middle = along_x or lattice.pitch_x_um / 2, along_y or lattice.pitch_y_um / 2
    x_um, y_um = lattice.to_stage(0, 0, middle[0] - given.width_um / 2, middle[1] - given.height_um / 2)
    return replace(
        detected,
        x0_um=float(x_um),
        y0_um=float(y_um),
        width_um=min(given.width_um, detected.pitch_x_um),
        height_um=min(given.height_um, detected.pitch_y_um),
        by="given",
        notes=given.notes + (notes if open_axes else ()),
    )


def _middle(at_um: float, pitch_um: float, differs_px: float) -> float | None:
    """Return the position of the die centre in its cell; None where the detected street does not match."""
    if differs_px > SAME_STREET_PX:
        return None
    return pitch_um / 2 + math.remainder(at_um - pitch_um / 2, pitch_um)


def _offset(given: DieGrid, detected: DieGrid, cols: np.ndarray, rows: np.ndarray) -> DieOffset:
    origin = np.subtract(detected.corner(0, 0), given.corner(0, 0))
    each = np.hypot(*np.subtract(detected.to_stage(cols, rows), given.to_stage(cols, rows)))
    return DieOffset(
        origin_x_um=float(origin[0]),
        origin_y_um=float(origin[1]),
        pitch_x_ppm=(detected.pitch_x_um / given.pitch_x_um - 1) * 1e6,
        pitch_y_ppm=(detected.pitch_y_um / given.pitch_y_um - 1) * 1e6,
        turn_mrad=(detected.angle_rad - given.angle_rad) * 1e3,
        farthest_um=float(each.max()),
    )
