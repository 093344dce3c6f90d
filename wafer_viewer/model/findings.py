"""Union of all result types, and the list of results of one reconstruction."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.gauge.gauge_check import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.measurement.edge_and_bump_shapes import Chipping, CircleSize, Coplanarity, DieSize, KerfWidth
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Distance,
    FaceAngle,
    Flatness,
    PointHeight,
    Profile,
    Radius,
)
from wafer_viewer.model.measurement.site_range import SiteRanges
from wafer_viewer.model.measurement.step import StepHeight, StepProfile
from wafer_viewer.model.measurement.texture import Roughness, Texture
from wafer_viewer.model.spec import Spec

AnyResult = (
    Profile
    | PointHeight
    | Distance
    | StepHeight
    | StepProfile
    | FaceAngle
    | Radius
    | AreaVolume
    | Flatness
    | Texture
    | Roughness
    | GaugeCheck
    | Defect
    | KerfWidth
    | DieSize
    | CircleSize
    | Chipping
    | Coplanarity
    | SiteRanges
)


class MeasurementResults(Spec, frozen=True, kw_only=True):
    """The list of results of one reconstruction: the file ``findings.json``."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    items: tuple[AnyResult, ...] = ()
