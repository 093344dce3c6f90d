"""Common parts of the measuring commands: loading a surface, running a tool, printing its result."""

from __future__ import annotations

from pathlib import Path

import msgspec

from wafer_viewer.cli.arguments import levelling_from
from wafer_viewer.cli.output import print_json
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic


def measure(
    tool: ToolName,
    places: tuple[Region, ...],
    src: Path,
    level: tuple[str, ...],
    field: int,
    result: str,
    options: ToolOptions | None = None,
) -> None:
    """Measure with a tool at its regions and print the result."""
    from wafer_viewer.measure.registry import measured

    surface, calibrated = surface_over(src, level, field, result)
    print_finding(measured(surface, tool, places, calibrated, options), field)


def surface_over(src: Path, level: tuple[str, ...], field: int, result: str) -> tuple[Mosaic, bool]:
    """Return the surface levelled as --level says, and whether its calibration holds."""
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.session.surface.headless import measured_surface

    levelling = levelling_from(level)
    surface, calibrated = measured_surface(src, field, result)
    return levelled(surface, levelling), calibrated


def print_finding(found: AnyResult, field: int) -> None:
    """Print a result as JSON on standard output."""
    print_json(msgspec.to_builtins(replace(found, show=field)))
