"""Regions and tool of a kept result: to draw it, to frame it, to repeat the measurement. Pure functions."""

from __future__ import annotations

from wafer_viewer.model.findings import AnyResult
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
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.region import Region

MOST_SITES = 400
"""With more sites only the region is drawn."""
Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""


def tool_of(finding: AnyResult) -> ToolName | None:
    """Return the tool that measures such a result; None for gauge checks and defects."""
    match finding:
        case Profile():
            return "profile"
        case PointHeight():
            return "point"
        case Distance():
            return "distance"
        case StepHeight():
            return "step"
        case StepProfile():
            return "groove"
        case FaceAngle():
            return "angle"
        case Radius():
            return "radius"
        case AreaVolume():
            return "volume"
        case Flatness():
            return "flatness"
        case Texture():
            return "texture"
        case Roughness():
            return "roughness"
        case KerfWidth():
            return "kerf"
        case DieSize():
            return "die"
        case CircleSize():
            return "circle"
        case Chipping():
            return "chipping"
        case Coplanarity():
            return "coplanarity"
        case SiteRanges():
            return "site_range"
        case GaugeCheck() | Defect():
            return None


def input_regions(finding: AnyResult) -> tuple[Region, ...]:
    """Return the regions of a result, in the order of its tool's inputs."""
    match finding:
        case Profile() | Roughness() | StepProfile():
            return (finding.line,)
        case PointHeight():
            return (finding.place,)
        case Distance():
            return finding.start, finding.end
        case StepHeight():
            return finding.upper, finding.lower
        case FaceAngle():
            return finding.first, finding.second
        case Radius() | CircleSize():
            return (finding.circle,)
        case (
            AreaVolume() | Flatness() | Texture() | KerfWidth() | DieSize() | Chipping() | Coplanarity() | SiteRanges()
        ):
            return (finding.region,)
        case GaugeCheck():
            return finding.upper, finding.lower
        case Defect():
            return (finding.outline,)


def drawn_regions(finding: AnyResult) -> tuple[Region, ...]:
    """Return the regions to draw: inputs, all regions of a step, the line of a distance, detected edges."""
    if isinstance(finding, StepHeight):
        return finding.regions
    if isinstance(finding, Distance):
        return *input_regions(finding), way_between(*input_regions(finding))
    return *input_regions(finding), *detected_regions(finding)


def detected_regions(finding: AnyResult) -> tuple[Region, ...]:
    """Return the detected edges of a result; empty if there are none."""
    match finding:
        case KerfWidth():
            return finding.first, finding.second
        case DieSize():
            return (finding.outline,)
        case CircleSize():
            return (finding.found,)
        case Chipping():
            return (finding.edge,)
        case SiteRanges() if len(finding.sites) <= MOST_SITES:
            return finding.outlines
        case _:
            return ()


def way_between(start: Region, end: Region) -> Region:
    """Return the line between two points."""
    (a,), (b,) = start.points, end.points
    return Region.line(a.x_um, a.y_um, b.x_um, b.y_um)


def bounds_of(finding: AnyResult, least_um: float = 0.0) -> Box:
    """Return the bounding box of all regions of a result, at least `least_um` wide and high."""
    boxes = [place.bounds_um for place in input_regions(finding)]
    x0, y0 = (min(box[k] for box in boxes) for k in (0, 1))
    x1, y1 = (max(box[k] for box in boxes) for k in (2, 3))
    spare_x, spare_y = (max(0.0, (least_um - side) / 2) for side in (x1 - x0, y1 - y0))
    return x0 - spare_x, y0 - spare_y, x1 + spare_x, y1 + spare_y
