"""Gap filling by cubic splines along rows and columns, marked as filled and never across a step."""

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
    """Return a filled copy of a map.

    `small_gaps`: along rows and along columns, the mean where both reach, never across a step. `all`: the paper's
    method, along the rows and then along the columns of the result, across any gap; regions measured on one side only,
    as at the border of the map, stay unmeasured.
    """
    if how.mode == "none":
        return z_um.copy()
    if how.mode == "small_gaps":
        return fill_gaps(z_um, how.max_gap_px, MAX_STEP_FRAMES * step_um)
    longest = max(z_um.shape)
    return np.ascontiguousarray(fill_rows(fill_rows(z_um, longest, math.inf).T, longest, math.inf).T)


def mark_filled(origin: NDArray[np.uint8], z_um: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the origins of a map after gap filling; unmeasured pixels with a height become FILLED."""
    return np.where((origin != Origin.MEASURED) & np.isfinite(z_um), np.uint8(Origin.FILLED), origin)
