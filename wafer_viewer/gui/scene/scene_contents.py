"""Contents of a scene: items, height scaling, the points the camera frames, and the colours of both themes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np

from wafer_viewer.draw.colormaps import Rgb, rgb
from wafer_viewer.gui.scene.camera_presets import Clear, Vector
from wafer_viewer.gui.scene.primitives import Box
from wafer_viewer.gui.scene.quadtree import Frustum
from wafer_viewer.gui.scene.reconciler import SceneItem
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.session.rendering.render_request import ColourScale, SurfaceKey, SurfaceStatistics

# ---------------------------------------------------------------------------------------------------------- scene theme


@dataclass(frozen=True, slots=True)
class SceneColours:
    """ink: labels and edges; accent: fields; casing: under coloured lines, for contrast on any colour map."""

    ink: Rgb
    soft_ink: Rgb
    accent: Rgb
    stage_line: Rgb
    shadow: Rgb
    shadow_strength: float
    ground: Rgb
    under_lines: Rgb
    """Casing of lines in the theme's own colours."""
    doubt: Rgb
    casing: Rgb = (255, 255, 255)
    arrow: Rgb = rgb("15202B")
    path: Rgb = (200, 80, 0)
    profile: Rgb = rgb("E8590C")
    region: Rgb = rgb("15202B")
    mark: Rgb = rgb("0B6E99")


LIGHT = SceneColours(
    ink=rgb("445463"),
    soft_ink=rgb("66768A"),
    accent=rgb("0B6E99"),
    stage_line=rgb("CBD4DE"),
    shadow=(24, 36, 50),
    shadow_strength=0.5,
    ground=rgb("E9EEF3"),
    under_lines=(255, 255, 255),
    doubt=rgb("C25E00"),
)
DARK = SceneColours(
    ink=rgb("B2BECA"),
    soft_ink=rgb("8796A5"),
    accent=rgb("58BDE8"),
    stage_line=rgb("323C47"),
    shadow=(0, 0, 0),
    shadow_strength=0.8,
    ground=rgb("1A2129"),
    under_lines=(13, 18, 23),
    doubt=rgb("F0B45B"),
    arrow=rgb("F2F6FA"),
)


def colours(dark: bool) -> SceneColours:
    """Return the colours of a theme."""
    return DARK if dark else LIGHT


# ------------------------------------------------------------------------------------------------------- scene contents


@dataclass(frozen=True, slots=True)
class DisplayedSurface:
    """The displayed surface and its mapping of heights to scene z: (z_um - z0_um) * stretch / 1000.

    datum: reference of all heights, including those in facts and scale; None: the zero of the stage.
    """

    source: SurfaceKey
    facts: SurfaceStatistics
    scale: ColourScale
    z0_um: float
    stretch: float
    datum: Datum | None = None

    def scene_z(self, z_um: float) -> float:
        """Return the scene z in mm of a height."""
        return (z_um - self.z0_um) * 1e-3 * self.stretch

    def height_um(self, scene_z_mm: float) -> float:
        """Return the height in um of a scene z in mm: the inverse of `scene_z`."""
        return scene_z_mm * 1e3 / self.stretch + self.z0_um

    @property
    def box_um(self) -> Box:
        """Extent in the stage plane by pixel centres: x low, y low, x high, y high in um."""
        facts = self.facts
        x1, y0 = facts.x0_um + (facts.cols - 1) * facts.pixel_um, facts.y0_um - (facts.rows - 1) * facts.pixel_um
        return facts.x0_um, y0, x1, facts.y0_um

    @property
    def heights_um(self) -> tuple[float, float]:
        """Lowest and highest height in um above the datum."""
        return self.facts.lowest_um, self.facts.highest_um


@dataclass(frozen=True, slots=True, eq=False)
class SceneContents:
    """Description of everything to be drawn.

    rough: items drawn first if the scene shows no contents of the same place yet.
    seen: returns further items for a camera frustum and a number of drawn pixels per screen pixel.
    awaits_more: True if further items depend on pending render results.
    place: the camera moves to `preset` when this value changes.
    corners_mm: points [n, 3] that the camera frames.
    """

    items: tuple[SceneItem, ...]
    corners_mm: Vector
    place: Hashable
    preset: str = "iso"
    stretch: float = 1.0
    rough: tuple[SceneItem, ...] = ()
    on_show: DisplayedSurface | None = None
    awaits_more: bool = False
    visible: Callable[[Frustum, float], Sequence[SceneItem]] | None = None
    clear: Clear = field(default_factory=Clear)


def corners_of(box: Box, low_mm: float, high_mm: float) -> Vector:
    """Return the eight corners of a block, [8, 3]."""
    x0, y0, x1, y1 = box
    return np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (low_mm, high_mm)], float)


def corners_over(bounds_um: Box, shown: SceneContents) -> Vector:
    """Return the corners of a block over a rectangle of the stage, with the height range of the displayed surface."""
    x0, y0, x1, y1 = (side * 1e-3 for side in bounds_um)
    on_show = shown.on_show
    heights = (0.0, 0.0) if on_show is None else (on_show.facts.low_um, on_show.facts.high_um)
    low, high = (0.0 if on_show is None else on_show.scene_z(z_um) for z_um in heights)
    middle = (low + high) / 2
    half = min((high - low) / 2, 0.1 * max(x1 - x0, y1 - y0))
    return corners_of((x0, y0, x1, y1), middle - half, middle + half)
