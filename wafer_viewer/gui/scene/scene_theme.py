"""Colours of the scene in the light and the dark theme."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.draw.colormaps import Rgb, rgb


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
