"""Base class of all measurement results."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.spec import Spec


class MeasurementResult(Spec, frozen=True, kw_only=True):
    """Fields common to all results: name, surface and filter it was measured on, and whether any input is simulated.

    show: 0 for the stitched surface, else the number of a field, negative for a comparison; levelling: the zero of the
    heights.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str = ""
    number: int = 0
    show: int = 0
    surface: Literal["unsmoothed", "smoothed", "filled"] = "unsmoothed"
    filter: str = "none"
    levelling: Levelling = Levelling()
    simulated: bool = False
    notes: tuple[str, ...] = ()
