"""Exclusion areas of every die, such as die numbers and probe marks. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.region import Region

NO_DIES = "No area was left out: the recipe's are areas of dies, and nothing was compared die by die."
Mask = NDArray[np.bool_]


def exclusion_mask(regions: Sequence[Region], cells: CellGrid) -> Mask | None:
    """Return the mask of a cell, bool [row, col], for regions in um from the die's lower left corner.

    None where no pixel is excluded.
    """
    out = np.zeros(cells.shape, bool)
    for region in regions:
        rows, cols = _around(region, cells)
        u_um, v_um = cells.in_die(
            np.arange(rows.start, rows.stop)[:, None] + 0.0, np.arange(cols.start, cols.stop) + 0.0
        )
        out[rows, cols] |= region.contains(u_um, v_um)
    return out if out.any() else None


def notes_on(regions: Sequence[Region], excluded: Mask | None, on_dies: bool) -> tuple[str, ...]:
    """Return the note on the excluded areas; none if no area was requested."""
    if not regions:
        return ()
    if not on_dies:
        return (NO_DIES,)
    share = 0.0 if excluded is None else float(excluded.mean())
    areas = "1 area" if len(regions) == 1 else f"{len(regions)} areas"
    return (f"Left out of every die, as the recipe asks: {areas}, {100 * share:.2g} % of die and street.",)


def _around(region: Region, cells: CellGrid) -> tuple[slice, slice]:
    """Return the rows and columns of a cell that may intersect a region."""
    x0, y0, x1, y1 = (um / cells.pixel_um for um in region.bounds_um)
    top, left = cells.street[0] + cells.grid.height_um / cells.pixel_um, cells.street[1]
    return _within(top - y1, top - y0, cells.shape[0]), _within(left + x0, left + x1, cells.shape[1])


def _within(low: float, high: float, n: int) -> slice:
    return slice(min(n, max(0, int(low) - 1)), min(n, max(0, int(high) + 2)))
