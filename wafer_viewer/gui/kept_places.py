"""Where a kept result was measured, and with which tool: to draw it, to fly there, to measure there again. Pure."""

from __future__ import annotations

from wafer_viewer.model.findings import (
    AnyFinding,
    AreaVolume,
    Defect,
    Distance,
    FaceAngle,
    Flatness,
    GaugeCheck,
    PointHeight,
    Profile,
    Radius,
    StepHeight,
    StepProfile,
)
from wafer_viewer.model.measuring import ToolName
from wafer_viewer.model.region import Region
from wafer_viewer.model.texture import Roughness, Texture

Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""


def tool_of(finding: AnyFinding) -> ToolName | None:
    """The tool that measures such a result; None for what no tool of this page does."""
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
        case GaugeCheck() | Defect():
            return None


def places_of(finding: AnyFinding) -> tuple[Region, ...]:
    """The places of a result, in the order in which its tool asks for them."""
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
        case Radius():
            return (finding.circle,)
        case AreaVolume() | Flatness() | Texture():
            return (finding.region,)
        case GaugeCheck():
            return finding.upper, finding.lower
        case Defect():
            return (finding.outline,)


def drawn_of(finding: AnyFinding) -> tuple[Region, ...]:
    """What is drawn of a result: its places, all regions of a step, and the way from one to the other of a distance."""
    if isinstance(finding, StepHeight):
        return finding.regions
    return (
        (*places_of(finding), way_between(*places_of(finding))) if isinstance(finding, Distance) else places_of(finding)
    )


def way_between(start: Region, end: Region) -> Region:
    """The line from one point to another."""
    (a,), (b,) = start.points, end.points
    return Region.line(a.x_um, a.y_um, b.x_um, b.y_um)


def bounds_of(finding: AnyFinding, least_um: float = 0.0) -> Box:
    """The upright rectangle round all places of a result, at least so wide and high."""
    boxes = [place.bounds_um for place in places_of(finding)]
    x0, y0 = (min(box[k] for box in boxes) for k in (0, 1))
    x1, y1 = (max(box[k] for box in boxes) for k in (2, 3))
    spare_x, spare_y = (max(0.0, (least_um - side) / 2) for side in (x1 - x0, y1 - y0))
    return x0 - spare_x, y0 - spare_y, x1 + spare_x, y1 + spare_y
