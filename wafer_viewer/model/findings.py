"""All result types, and the list of results of one reconstruction."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Union

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.model.spec import Spec

if TYPE_CHECKING:
    AnyResult = MeasurementResult
else:
    AnyResult = Union[(*TOOL_OF_RESULT, GaugeCheck, Defect)]


class MeasurementResults(Spec, frozen=True, kw_only=True):
    """The list of results of one reconstruction: the file ``findings.json``."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    items: tuple[AnyResult, ...] = ()
