"""Kept results: their regions, and features made of them. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.draw.number_format import number
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measuring_tool import MeasuringTool, ToolName
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT, ToolOptions
from wafer_viewer.model.quantity import Quantity, Unit
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

# -------------------------------------------------------------------------------------------------------------- results


@dataclass(frozen=True, slots=True)
class KeptFeature:
    """Feature that repeats a kept result; places in wafer µm if the wafer is aligned, else in stage µm."""

    tool: ToolName
    places: tuple[Region, ...]
    options: ToolOptions | None
    main: Quantity
    quantities: dict[str, Quantity]

    def get(self, quantity: str) -> Quantity:
        """Return a quantity by name; the main one for an unknown or empty name."""
        return self.quantities.get(quantity, self.main)

    def value(self, quantity: str) -> float:
        """Return the value of a quantity."""
        return self.get(quantity).value

    def unit(self, quantity: str) -> Unit:
        """Return the unit of a quantity."""
        return self.get(quantity).unit


def kept_features(snapshot: Snapshot) -> dict[str, KeptFeature]:
    """Return the features of kept results by display name; results on comparisons are excluded."""
    lies = snapshot.dataset.job.alignment if snapshot.dataset is not None else None
    features = ((finding, _feature(finding, lies)) for finding in snapshot.findings if finding.show >= 0)
    return {
        f"{finding.name} ({number(finding.main.value, 2)})": feature
        for finding, feature in features
        if feature is not None
    }


def _feature(finding: AnyResult, lies: Alignment | None) -> KeptFeature | None:
    made_by = TOOL_OF_RESULT.get(type(finding))
    if made_by is None or (places := _places(finding, made_by)) is None:
        return None
    tool = made_by.name
    options = getattr(finding, "options", None)
    own = replace(ToolOptions(), **{tool: options}) if options is not None and hasattr(ToolOptions(), tool) else None
    return KeptFeature(tool, tuple(_on_wafer(place, lies) for place in places), own, finding.main, finding.quantities)


def _places(finding: AnyResult, tool: MeasuringTool) -> tuple[Region, ...] | None:
    """Return the regions the tool needs, in its order; None if the result lacks them."""
    held = (getattr(finding, name) for name in finding.__struct_fields__)
    regions = tuple(value for value in held if isinstance(value, Region))[: len(tool.places)]
    kinds = tuple(place.kind for place in tool.places)
    return regions if tuple(region.kind for region in regions) == kinds else None


def _on_wafer(region: Region, lies: Alignment | None) -> Region:
    """Transform a stage region to wafer µm; a rectangle stays one, since the rotation of a wafer is small."""
    if lies is None:
        return region
    points = (lies.to_wafer(point.x_um, point.y_um) for point in region.points)
    holes = tuple(_on_wafer(hole, lies) for hole in region.excluded)
    return replace(region, points=tuple(Point(x_um=x, y_um=y) for x, y in points), excluded=holes)


Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""


def bounds_of(finding: AnyResult, least_um: float = 0.0) -> Box:
    """Return the bounding box of all regions of a result, at least `least_um` wide and high."""
    boxes = [place.bounds_um for place in finding.inputs]
    x0, y0 = (min(box[k] for box in boxes) for k in (0, 1))
    x1, y1 = (max(box[k] for box in boxes) for k in (2, 3))
    spare_x, spare_y = (max(0.0, (least_um - side) / 2) for side in (x1 - x0, y1 - y0))
    return x0 - spare_x, y0 - spare_y, x1 + spare_x, y1 + spare_y
