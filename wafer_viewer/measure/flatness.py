"""Flatness of a face by ISO 12781: what is left of it about the plane of least squares."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.areas import area_of, least_squares_plane
from wafer_viewer.measure.heights import Layer
from wafer_viewer.measure.reading import Reading
from wafer_viewer.model.findings import Flatness
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import Mosaic

BAND = (0.135, 99.865)
"""Per cent: between them lie 99.73 % of the heights, as within three deviations of normal ones."""
EXTREMES = "FLTt is between the two most extreme points: noise and single false heights make it larger."


def flatness(
    surface: Mosaic, region: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Flatness:
    """FLTt (highest over lowest) and FLTq (root mean square) about the least-squares plane, and the 99.73 % band.

    No uncertainty: how far noise pulls the extremes apart is not evaluated. Raises MeasureError when the region is a
    line, lies outside, or has fewer than 200 measured points or less than half of its area measured.
    """
    reading = Reading.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "flatness")
    _, left = least_squares_plane(area.points)
    low, high = np.percentile(left, BAND)
    return Flatness(
        **reading.told(name, area.level, EXTREMES),
        region=region,
        reference="least_squares",
        flt_t=reading.length(float(np.ptp(left)), None),
        flt_q=reading.length(float(np.sqrt(np.mean(left**2))), None),
        band_9973_um=float(high - low),
        points=len(area.points),
        measured_fraction=area.measured_fraction,
    )
