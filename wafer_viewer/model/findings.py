"""Union of all result types, and the list of results of one reconstruction."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Chipping,
    CircleSize,
    Coplanarity,
    DieSize,
    Distance,
    FaceAngle,
    Flatness,
    KerfWidth,
    PointHeight,
    Profile,
    Radius,
    Roughness,
    SiteRanges,
    StepHeight,
    StepProfile,
    Texture,
)
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
