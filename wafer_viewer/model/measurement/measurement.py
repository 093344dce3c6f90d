"""What every result of measuring carries, whatever it is of."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.spec import Spec


class MeasurementResult(Spec, frozen=True, kw_only=True):
    """What every result carries: a name, the map and filter it was measured on, and whether any of it is simulated.

    show: 0 the stitched surface, else the number of a field, below 0 a comparison; levelling: the zero that heights
    were read from.
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
