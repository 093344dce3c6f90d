"""Measuring functions by tool name."""

from __future__ import annotations

from collections.abc import Callable

from wafer_viewer.measure.texture.areal_texture import texture
from wafer_viewer.measure.texture.roughness import roughness
from wafer_viewer.measure.tools.angle import face_angle
from wafer_viewer.measure.tools.chipping import chipping
from wafer_viewer.measure.tools.circle import circle_size
from wafer_viewer.measure.tools.coplanarity import coplanarity
from wafer_viewer.measure.tools.die_size import die_size
from wafer_viewer.measure.tools.flatness import flatness
from wafer_viewer.measure.tools.kerf import kerf_width
from wafer_viewer.measure.tools.point import distance, point_height
from wafer_viewer.measure.tools.profile import profile
from wafer_viewer.measure.tools.radius import bump_radius
from wafer_viewer.measure.tools.site_range import sites_of_region
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.measure.tools.step_profile import step_profile
from wafer_viewer.measure.tools.volume import area_volume
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measurements import Profile
from wafer_viewer.model.measurement.tools import TOOLS, ToolName, ToolOptions, keywords
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic


def _section(surface: Mosaic, line: Region, *, calibration_valid: bool) -> Profile:
    return profile(surface, line, calibration_valid=calibration_valid)[0]


MEASUREMENTS: dict[ToolName, Callable[..., AnyResult]] = {
    "profile": _section,
    "point": point_height,
    "distance": distance,
    "step": step_height,
    "groove": step_profile,
    "angle": face_angle,
    "radius": bump_radius,
    "volume": area_volume,
    "flatness": flatness,
    "texture": texture,
    "roughness": roughness,
    "kerf": kerf_width,
    "die": die_size,
    "circle": circle_size,
    "chipping": chipping,
    "coplanarity": coplanarity,
    "site_range": sites_of_region,
}
"""Each takes a surface and the regions that its tool requires."""


def measured(
    surface: Mosaic,
    tool: ToolName,
    places: tuple[Region, ...],
    calibration_valid: bool,
    options: ToolOptions | None = None,
) -> AnyResult:
    """Run a tool on its regions. Raises MeasureError for a wrong number of regions, or where there is no result."""
    asked = TOOLS[tool].places
    if len(places) != len(asked):
        names = ", ".join(place.name for place in asked)
        raise MeasureError(
            f"{TOOLS[tool].title} is measured at {len(asked)} places ({names}), {len(places)} are given: give as many."
        )
    chosen = keywords(options or ToolOptions(), tool)
    return MEASUREMENTS[tool](surface, *places, calibration_valid=calibration_valid, **chosen)
