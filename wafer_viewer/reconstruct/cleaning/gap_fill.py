"""Heights for gaps: cubic splines along the rows and the columns, marked as filled and never across a step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Fill
from wafer_viewer.numerics.filters.spline_fill import fill_gaps, fill_rows

MAX_STEP_FRAMES = 1.5
"""A gap whose sides differ by more than one and a half steps of the sweep is a step of the surface."""


def fill(z_um: NDArray[np.float32], how: Fill, step_um: float) -> NDArray[np.float32]:
    """A filled copy of a map.

    `small_gaps`: along rows and along columns, the mean where both reach, never across a step. `all`: the paper's way,
    along the rows and then, through what that gave, along the columns, across whatever lies between; what is measured
    on one side only, as at the border of the map, stays unmeasured there too.
    """
    if how.mode == "none":
        return z_um.copy()
    if how.mode == "small_gaps":
        return fill_gaps(z_um, how.max_gap_px, MAX_STEP_FRAMES * step_um)
    longest = max(z_um.shape)
    return np.ascontiguousarray(fill_rows(fill_rows(z_um, longest, math.inf).T, longest, math.inf).T)


def mark_filled(origin: NDArray[np.uint8], z_um: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The origins of a map after its gaps were filled: a height that was not measured is a filled one."""
    return np.where((origin != Origin.MEASURED) & np.isfinite(z_um), np.uint8(Origin.FILLED), origin)
