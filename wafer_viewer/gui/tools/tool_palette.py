"""Presentation of the tools on the page: groups, icons, short names and keys."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui.state.view_state import Tool
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.measurement.tools import TOOLS, ToolName

GROUPS: dict[str, tuple[ToolName, ...]] = {
    "Sections and steps": ("profile", "step", "groove", "angle"),
    "Places": ("point", "distance"),
    "What stands out": ("radius", "volume", "coplanarity"),
    "On the picture": ("die", "kerf", "chipping", "circle"),
    "Faces": ("flatness", "texture", "roughness", "site_range"),
}
ON_TOOLBAR: tuple[tuple[ToolName, ...], ...] = (
    ("profile", "step", "angle"),
    ("point", "distance"),
    ("radius", "volume"),
    ("flatness", "texture"),
)
"""Tools on the toolbar, by group; the others are only in the panel."""
ICONS: dict[ToolName, Any] = {
    "profile": viser.Icon.LINE,
    "step": viser.Icon.STAIRS_UP,
    "groove": viser.Icon.WAVE_SQUARE,
    "angle": viser.Icon.ANGLE,
    "point": viser.Icon.POINT,
    "distance": viser.Icon.RULER_MEASURE,
    "radius": viser.Icon.CIRCLE,
    "volume": viser.Icon.DROPLET,
    "kerf": viser.Icon.ARROW_AUTOFIT_WIDTH,
    "die": viser.Icon.DIMENSIONS,
    "circle": viser.Icon.CIRCLE_DASHED,
    "chipping": viser.Icon.PUZZLE,
    "coplanarity": viser.Icon.LAYOUT_ALIGN_BOTTOM,
    "site_range": viser.Icon.GRID_PATTERN,
    "flatness": viser.Icon.LAYERS_SUBTRACT,
    "texture": viser.Icon.GRAIN,
    "roughness": viser.Icon.WAVE_SAW_TOOL,
}
SHORT: dict[ToolName, str] = {
    "profile": "Profile",
    "step": "Step",
    "groove": "Groove",
    "angle": "Angle",
    "point": "Point",
    "distance": "Distance",
    "radius": "Radius",
    "volume": "Volume",
    "kerf": "Kerf",
    "die": "Die size",
    "circle": "Circle",
    "chipping": "Chipping",
    "coplanarity": "Coplanar",
    "site_range": "Sites",
    "flatness": "Flatness",
    "texture": "Texture",
    "roughness": "Roughness",
}
TOOL_KEYS: dict[ToolName, tuple[str, str | None]] = {
    "profile": ("L", None),
    "point": ("X", None),
    "distance": ("M", None),
    "step": ("K", None),
    "groove": ("K", "shift"),
    "angle": ("B", None),
    "radius": ("R", None),
    "volume": ("V", None),
    "kerf": ("U", "shift"),
    "die": ("W", "shift"),
    "circle": ("Y", "shift"),
    "chipping": ("X", "shift"),
    "coplanarity": ("Q", "shift"),
    "site_range": ("Z", "shift"),
    "flatness": ("F", "shift"),
    "texture": ("T", "shift"),
    "roughness": ("J", "shift"),
}
"""Key of each tool, and its modifier."""
GAP = '<i class="wv-gap"></i>'
"""Separator between groups on the toolbar."""


def hint(tool: ToolName) -> str:
    """Return the tooltip of a tool: its title and key."""
    key, held = TOOL_KEYS[tool]
    return f"{TOOLS[tool].title} · {f'{held} + ' if held else ''}{key}"


def tool_strip(chosen: Tool) -> str:
    """Return the toolbar icons; the active tool shows its name, in place of the last group if it is not listed."""
    groups: tuple[tuple[ToolName, ...], ...] = ON_TOOLBAR
    if chosen != "none" and not any(chosen in group for group in ON_TOOLBAR):
        groups = (*ON_TOOLBAR[:-1], (chosen,))
    return GAP.join("".join(_icon(tool, tool == chosen) for tool in group) for group in groups)


def tool_cards() -> str:
    """Return all tools with their names as a selection."""
    return "".join(
        f'{html.head(name)}<div class="wv-cards">{"".join(_card(tool) for tool in group)}</div>'
        for name, group in GROUPS.items()
    )


def _icon(tool: ToolName, chosen: bool) -> str:
    on, word = (' class="on"', html.safe(SHORT[tool])) if chosen else ("", "")
    told = f'title="{html.safe(hint(tool))}" aria-label="{SHORT[tool]}"'
    return f"<span{on} {told} {html.pick('tool', tool)}>{html.icon(ICONS[tool], 17)}{word}</span>"


def _card(tool: ToolName) -> str:
    key, held = TOOL_KEYS[tool]
    keys = f"<kbd>{'⇧' if held else ''}{key}</kbd>"
    told = f'title="{html.safe(TOOLS[tool].how)}" aria-label="{html.safe(TOOLS[tool].title)}"'
    return f"<div {told} {html.pick('tool', tool)}>{html.icon(ICONS[tool], 18)}<span>{SHORT[tool]}</span>{keys}</div>"
