"""Kept results as candidates for features of a job: tool, regions, quantities. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.draw.number_format import number
from wafer_viewer.model.acquisition.alignment import Alignment
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import TOOLS, ToolName
from wafer_viewer.model.quantity import Length, Quantity, Unit
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

TOOL_OF: dict[str, ToolName] = {
    **{tool: tool for tool in TOOLS},
    "step_height": "step",
    "step_profile": "groove",
    "kerf_width": "kerf",
    "die_size": "die",
}
"""Tool by the tag of the result it makes."""


@dataclass(frozen=True, slots=True)
class KeptFeature:
    """Feature that repeats a kept result; places in wafer µm if the wafer is aligned, else in stage µm."""

    tool: ToolName
    places: tuple[Region, ...]
    options: ToolOptions | None
    main: Quantity
    quantities: dict[str, Quantity]

    def of(self, quantity: str) -> Quantity:
        """Return a quantity by name; the main one for an unknown or empty name."""
        return self.quantities.get(quantity, self.main)

    def value(self, quantity: str) -> float:
        """Return the value of a quantity."""
        return self.of(quantity).value

    def unit(self, quantity: str) -> Unit:
        """Return the unit of a quantity."""
        return self.of(quantity).unit


def kept_features(snapshot: Snapshot) -> dict[str, KeptFeature]:
    """Return the features of kept results by display name; results on comparisons are excluded."""
    lies = snapshot.dataset.job.alignment if snapshot.dataset is not None else None
    found = ((finding, _feature(finding, lies)) for finding in snapshot.findings if finding.show >= 0)
    return {f"{finding.name} ({number(finding.main.value, 2)})": kept for finding, kept in found if kept is not None}


def _feature(finding: AnyResult, lies: Alignment | None) -> KeptFeature | None:
    tool = TOOL_OF.get(str(finding.__struct_config__.tag))
    if tool is None or (places := _places(finding, tool)) is None:
        return None
    held = {name: getattr(finding, name) for name in finding.__struct_fields__}
    quantities = {name: q for name, value in held.items() if (q := _quantity(value)) is not None}
    options = held.get("options")
    own = replace(ToolOptions(), **{tool: options}) if options is not None and hasattr(ToolOptions(), tool) else None
    return KeptFeature(tool, tuple(_on_wafer(place, lies) for place in places), own, finding.main, quantities)


def _quantity(value: object) -> Quantity | None:
    return value.quantity if isinstance(value, Length) else value if isinstance(value, Quantity) else None


def _places(finding: AnyResult, tool: ToolName) -> tuple[Region, ...] | None:
    """Return the regions the tool needs, in its order; None if the result lacks them."""
    held = (getattr(finding, name) for name in finding.__struct_fields__)
    regions = tuple(value for value in held if isinstance(value, Region))[: len(TOOLS[tool].places)]
    kinds = tuple(place.kind for place in TOOLS[tool].places)
    return regions if tuple(region.kind for region in regions) == kinds else None


def _on_wafer(region: Region, lies: Alignment | None) -> Region:
    """Transform a stage region to wafer µm; a rectangle stays one, since the rotation of a wafer is small."""
    if lies is None:
        return region
    points = (lies.to_wafer(point.x_um, point.y_um) for point in region.points)
    return replace(region, points=tuple(Point(x_um=x, y_um=y) for x, y in points))
