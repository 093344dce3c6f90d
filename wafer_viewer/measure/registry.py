"""Measuring functions of the tools, imported when they are first used."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pkgutil import resolve_name

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions, keywords
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic


@cache
def measuring_function(tool: ToolName) -> Callable[..., AnyResult]:
    """Return the function of a tool, ``f(surface, *regions, calibration_valid=..., **options)``."""
    measure = TOOLS[tool].measure
    return resolve_name(measure) if isinstance(measure, str) else measure


def measured(
    surface: Mosaic,
    tool: ToolName,
    places: tuple[Region, ...],
    calibration_valid: bool,
    options: ToolOptions | None = None,
) -> AnyResult:
    """Run a tool on its regions. Raises MeasureError for a wrong number of regions, or where there is no result."""
    required = TOOLS[tool].places
    if len(places) != len(required):
        names = ", ".join(place.name for place in required)
        raise MeasureError(
            f"{TOOLS[tool].title} is measured at {len(required)} places ({names}), {len(places)} are given:"
            " give as many."
        )
    chosen = keywords(options or ToolOptions(), tool)
    return measuring_function(tool)(surface, *places, calibration_valid=calibration_valid, **chosen)
