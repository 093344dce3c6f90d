"""HTML of a result's provenance: regions, secondary quantities, surface and height reference."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.gui.presenters.gauge import stored_check
from wafer_viewer.gui.presenters.measurement import numbers, small
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.measurement.levelling import LevelBy
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.model.surface.height_map import LAYER_TITLES

ZERO: dict[LevelBy, str] = {
    "stage": "the stage's zero",
    "three points": "the plane through three points",
    "plane": "the plane of the whole surface",
    "region": "the plane of a region",
    "form": "the form of the whole surface",
}
"""Names of the height reference by levelling method."""


def source(finding: AnyResult) -> Markup:
    """Return the provenance of a result: regions, points, surface."""
    body = stored_check(finding) if isinstance(finding, GaugeCheck) else numbers(finding)
    return html.head("Where it comes from", "µm") + body + _measured_on(finding)


def surface_name(finding: AnyResult) -> str:
    """Return the name of the surface a result was measured on."""
    return f"field {finding.show}" if finding.show > 0 else "comparison" if finding.show < 0 else "stitched surface"


def _measured_on(finding: AnyResult) -> Markup:
    lines = [
        f"On the {surface_name(finding)}: {LAYER_TITLES[finding.surface]}, filter: {finding.filter}.",
        f"Heights are read from {ZERO[finding.levelling.by]}.",
    ]
    tool = TOOL_OF_RESULT.get(type(finding))
    if tool is not None and tool.on_picture:
        lines = [f"On the {surface_name(finding)}."]
    if finding.simulated:
        lines.append("SIMULATED: not a measurement of a real sample.")
    lines.extend(finding.notes)
    return Markup("").join(small(line) for line in lines)
