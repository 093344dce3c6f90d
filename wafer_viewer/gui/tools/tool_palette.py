"""Presentation of the tools on the page: groups, icons, short names and keys."""

from __future__ import annotations

from typing import Any, get_args

import viser
from markupsafe import Markup

from wafer_viewer.gui.state.view_state import Tool
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.measurement.measuring_tool import MeasuringTool, ToolGroup
from wafer_viewer.model.measurement.tools import TOOLS

GROUPS: dict[str, tuple[MeasuringTool, ...]] = {
    group: tuple(tool for tool in TOOLS.values() if tool.group == group) for group in get_args(ToolGroup)
}
ON_TOOLBAR = tuple(listed for group in GROUPS.values() if (listed := tuple(t for t in group if t.on_toolbar)))
"""Tools on the toolbar, by group; the others are only in the panel."""
GAP = Markup('<i class="wv-gap"></i>')
"""Separator between groups on the toolbar."""


def icon_of(tool: MeasuringTool) -> Any:
    """Return the page's icon of a tool; a ruler for a name that the page does not know."""
    return getattr(viser.Icon, tool.icon.upper().replace("-", "_"), viser.Icon.RULER)


def hint(tool: MeasuringTool) -> str:
    """Return the tooltip of a tool: its title and key."""
    keys = f" · {f'{tool.modifier} + ' if tool.modifier else ''}{tool.key}" if tool.key else ""
    return f"{tool.title}{keys}"


def tool_strip(chosen: Tool, named: bool) -> Markup:
    """Return the tools of the toolbar: icons, with their names if there is room (`named`).

    The active tool has its name always, and stands in place of the last group if it is not listed.
    """
    groups = ON_TOOLBAR
    if (tool := TOOLS.get(chosen)) is not None and not tool.on_toolbar:
        groups = (*ON_TOOLBAR[:-1], (tool,))
    return GAP.join(Markup("").join(_icon(tool, tool.name == chosen, named) for tool in group) for group in groups)


def tool_cards() -> Markup:
    """Return all tools with their names as a selection."""
    return Markup("").join(
        Markup('{}<div class="wv-cards">{}</div>').format(
            html.head(name), Markup("").join(_card(tool) for tool in group)
        )
        for name, group in GROUPS.items()
    )


def _icon(tool: MeasuringTool, chosen: bool, named: bool) -> Markup:
    on, word = Markup(' class="on"') if chosen else "", tool.short if chosen or named else ""
    label = Markup('title="{}" aria-label="{}"').format(hint(tool), tool.short)
    return Markup("<span{on} {label} {pick}>{icon}{word}</span>").format(
        on=on, label=label, pick=html.pick("tool", tool.name), icon=html.icon(icon_of(tool), 17), word=word
    )


_SIGNS = {"shift": "⇧", "alt": "⌥", None: ""}


def _card(tool: MeasuringTool) -> Markup:
    keys = Markup("<kbd>{}{}</kbd>").format(_SIGNS[tool.modifier], tool.key) if tool.key else Markup()
    label = Markup('title="{}" aria-label="{}"').format(tool.how, tool.title)
    name = tool.short
    return Markup("<div {label} {pick}>{icon}<span>{name}</span>{keys}</div>").format(
        label=label, pick=html.pick("tool", tool.name), icon=html.icon(icon_of(tool), 18), name=name, keys=keys
    )
