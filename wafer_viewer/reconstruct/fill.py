"""Heights for gaps: cubic splines along the rows, then along the columns, marked as filled and never across a step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Fill
from wafer_viewer.model.surface import Origin
from wafer_viewer.numerics.spline import fill_rows

MAX_STEP_FRAMES = 2.0
"""A gap whose sides differ by more than two steps of the sweep is a step of the surface."""


def fill(z_um: NDArray[np.float32], how: Fill, step_um: float) -> NDArray[np.float32]:
    """A filled copy of a map; `all` fills every gap that has measured sides, across steps too, as the paper does."""
    out = z_um.copy()
    if how.mode == "none":
        return out
    everything = how.mode == "all"
    max_gap = max(out.shape) if everything else how.max_gap_px
    max_step = math.inf if everything else MAX_STEP_FRAMES * step_um
    fill_rows(out, max_gap, max_step)
    columns = np.ascontiguousarray(out.T)
    fill_rows(columns, max_gap, max_step)
    return np.ascontiguousarray(columns.T)


def mark_filled(origin: NDArray[np.uint8], z_um: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The origins of a map after its gaps were filled: a height that was not measured is a filled one."""
    return np.where((origin != Origin.MEASURED) & np.isfinite(z_um), np.uint8(Origin.FILLED), origin)
