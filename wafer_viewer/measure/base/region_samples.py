"""One or several regions of a face, and the measured fraction required of each."""

from __future__ import annotations

from collections.abc import Sequence

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region

Regions = Region | Sequence[Region]
LEAST_MEASURED = 0.5
"""Smallest measured fraction of a region for a representative result."""


def as_region_tuple(regions: Regions, which: str) -> tuple[Region, ...]:
    """Return the regions as a tuple. Raises MeasureError when there is none."""
    each = (regions,) if isinstance(regions, Region) else tuple(regions)
    if not each:
        raise MeasureError(f"No {which} region was given: draw at least one on the {which} face.")
    return each


def require_measured(region: Region, measured_um2: float, which: str, what: str) -> float:
    """Return the measured fraction of a region; pixels off the surface count as unmeasured.

    which, what: words of the error message, as in 'The upper region … and a step height needs'. Raises MeasureError
    when it is less than half.
    """
    share = min(1.0, measured_um2 / (region.area_um2 or measured_um2))
    if share < LEAST_MEASURED:
        raise MeasureError(
            f"Only {100 * share:.0f} % of the {which} is measured and {what} needs {100 * LEAST_MEASURED:.0f} %: "
            "draw it where the surface has fewer holes."
        )
    return share
