"""Texture of a face: the height parameters of ISO 25178-2, of what is left about the plane of least squares."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.areas import area_of, least_squares_plane
from wafer_viewer.measure.heights import Floats, Layer
from wafer_viewer.measure.reading import Reading
from wafer_viewer.model.findings import Texture
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import Mosaic

ROUNDING = 1e-6
"""Of the largest height: a surface whose Sq is less is flat, and has neither skewness nor kurtosis."""
FILTERS = "Form removed: plane of least squares. Neither S-filter nor L-filter: noise and waviness are in the numbers."


def texture(
    surface: Mosaic, region: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Texture:
    """Sa, Sq, Sp, Sv, Sz, Ssk and Sku of the measured points of a region, unmeasured ones left out.

    No uncertainty: what of it is noise is not evaluated. Raises MeasureError when the region is a line, lies outside,
    or has fewer than 200 measured points or less than half of its area measured.
    """
    reading = Reading.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "texture")
    _, left = least_squares_plane(area.points)
    sq_um = float(np.sqrt(np.mean(left**2)))
    flat = sq_um <= ROUNDING * float(np.abs(area.points.z_um).max())
    return Texture(
        **reading.told(name, area.level, FILTERS),
        region=region,
        sa=reading.length(float(np.mean(np.abs(left))), None),
        sq=reading.length(sq_um, None),
        sp=reading.length(float(left.max()), None),
        sv=reading.length(float(-left.min()), None),
        sz=reading.length(float(np.ptp(left)), None),
        ssk=None if flat else _moment(left, 3) / sq_um**3,
        sku=None if flat else _moment(left, 4) / sq_um**4,
        points=len(area.points),
        measured_fraction=area.measured_fraction,
    )


def _moment(left: Floats, power: int) -> float:
    return float(np.mean(left**power))
