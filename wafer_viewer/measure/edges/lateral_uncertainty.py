"""Uncertainty of lengths and angles between edges in the image, and notes of their results."""

from __future__ import annotations

import math

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.edges.subpixel_edges import U_SUBPIXEL_PX
from wafer_viewer.model.quantity import Length, Quantity

NOT_IN_BUDGET = (
    "Not in the budget: where light and focus put an edge on the picture, distortion and shear of the picture, "
    "positions of fields against each other, repeat scans, temperature other than 20 C."
)
ON_PICTURE = "Measured on the picture that is in focus everywhere."


def notes(reading: MeasurementContext, *more: str) -> tuple[str, ...]:
    """Return the notes of an image measurement; those on budgets only if calibrated."""
    return (ON_PICTURE, *more, NOT_IN_BUDGET) if reading.calibrated else (ON_PICTURE, *more)


def between_edges(
    reading: MeasurementContext, value_um: float, pixel_um: float, scatter_um: float | None, n_edges: int = 2
) -> Length:
    """Return a length between edges. scatter_um: standard uncertainty from edge points; None: unknown."""
    if scatter_um is None:
        return reading.length(value_um, None)
    lines = {
        "pixel scale": reading.u_pixel_scale * abs(value_um),
        "scatter of the edge points": scatter_um,
        "place between two pixels": math.sqrt(n_edges) * U_SUBPIXEL_PX * pixel_um,
    }
    return reading.length(value_um, lines)


def angle(reading: MeasurementContext, value_deg: float, scatter_deg: float | None) -> Quantity:
    """Return an angle between edges. scatter_deg: standard uncertainty from edge points; None: unknown."""
    lines = None if scatter_deg is None else {"scatter of the edge points": scatter_deg}
    return reading.quantity(value_deg, "deg", lines)


def root_sum_of_squares(*parts: float | None) -> float | None:
    """Return the root sum of squares; None where one value is unknown."""
    known = [part for part in parts if part is not None]
    return math.hypot(*known) if len(known) == len(parts) else None
