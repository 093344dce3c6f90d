"""Templates: measurements with their tools, places and settings, for use on many surfaces."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Spec

PlacesFrom = Literal["stage", "corner"]
"""Zero of the places of a template: that of the stage, or the lower left corner of each surface."""


class TemplateItem(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """One measurement of a template: its name, its tool, the regions of the tool in um, settings and levelling."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    tool: ToolName
    places: tuple[Region, ...]
    options: ToolOptions | None = None
    levelling: Levelling = Levelling()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tool not in TOOLS:
            self.refuse("tool", f"one of {', '.join(map(repr, TOOLS))}")
        if len(self.places) != len(TOOLS[self.tool].places):
            names = ", ".join(f"{place.name} ({place.kind})" for place in TOOLS[self.tool].places)
            raise self.error(f"Measurement '{self.name}': its tool '{self.tool}' is measured at {names}: give as many.")


class MeasurementTemplate(Spec, frozen=True, kw_only=True):
    """Measurements to repeat on other surfaces; places_from: zero of their places."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    places_from: PlacesFrom = "stage"
    measurements: tuple[TemplateItem, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [item.name for item in self.measurements]
        if not names or "" in names or len(set(names)) < len(names):
            self.refuse("measurements", "at least one, each with a name of its own")
