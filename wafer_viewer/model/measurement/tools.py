"""Measuring tools: their titles and the regions that each needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from wafer_viewer.model.region import RegionKind

ToolName = Literal[
    "profile",
    "point",
    "distance",
    "step",
    "angle",
    "radius",
    "volume",
    "flatness",
    "texture",
    "roughness",
    "groove",
    "kerf",
    "die",
    "circle",
    "chipping",
    "coplanarity",
    "site_range",
]


@dataclass(frozen=True, slots=True)
class PlaceAsked:
    """One region that a tool needs: its name on the page and its kind."""

    name: str
    kind: RegionKind


@dataclass(frozen=True, slots=True)
class MeasuringTool:
    """A measuring tool: title, instruction for the operator, and its regions.

    on_picture: it evaluates the all-in-focus picture and no heights.
    """

    title: str
    how: str
    places: tuple[PlaceAsked, ...]
    on_picture: bool = False


def _rectangles(*names: str) -> tuple[PlaceAsked, ...]:
    return tuple(PlaceAsked(name, "rectangle") for name in names)


TOOLS: dict[ToolName, MeasuringTool] = {
    "profile": MeasuringTool("Profile", "Drag the two handles over the surface.", (PlaceAsked("line", "line"),)),
    "point": MeasuringTool("Point", "Drag the point, or click where to measure.", (PlaceAsked("point", "point"),)),
    "distance": MeasuringTool(
        "Distance", "Drag both points over the surface.", (PlaceAsked("from", "point"), PlaceAsked("to", "point"))
    ),
    "step": MeasuringTool(
        "Step height", "Drag the upper and the lower region over the surface.", _rectangles("upper", "lower")
    ),
    "angle": MeasuringTool("Angle", "Drag a region onto each of the two faces.", _rectangles("first", "second")),
    "radius": MeasuringTool("Radius", "Drag the circle round the bump or the pit.", (PlaceAsked("bump", "circle"),)),
    "volume": MeasuringTool(
        "Area and volume", "Drag the region over what stands out of its surroundings.", _rectangles("region")
    ),
    "flatness": MeasuringTool("Flatness", "Drag the region over the face.", _rectangles("face")),
    "texture": MeasuringTool("Texture", "Drag the region over the face.", _rectangles("face")),
    "groove": MeasuringTool("Groove", "Drag the line across a groove or step.", (PlaceAsked("line", "line"),)),
    "roughness": MeasuringTool("Roughness", "Drag the line over the face.", (PlaceAsked("line", "line"),)),
    "kerf": MeasuringTool("Kerf width", "Drag the region across a kerf.", _rectangles("kerf"), True),
    "die": MeasuringTool("Die size", "Drag the region round a die.", _rectangles("die"), True),
    "circle": MeasuringTool(
        "Circle", "Drag the circle round something round.", (PlaceAsked("circle", "circle"),), True
    ),
    "chipping": MeasuringTool("Chipping", "Drag the region along the edge of a die.", _rectangles("edge"), True),
    "coplanarity": MeasuringTool("Coplanarity", "Drag the region over the bumps of a die.", _rectangles("bumps")),
    "site_range": MeasuringTool(
        "Site range", "Drag the region over the sites: front surface, as mounted.", _rectangles("sites")
    ),
}
