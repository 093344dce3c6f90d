"""Style sheets and scripts of the page, and its two palettes of colours."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from markupsafe import Markup

from wafer_viewer.gui.widgets.html import style_sheet

FOLDER = Path(__file__).parents[1] / "static"


def read_static(*names: str) -> str:
    """Return the text of static files, one after the other."""
    return "\n".join((FOLDER / name).read_text() for name in names)


LIGHT = {
    "panel": "#FFFFFF",
    "ink": "#15202B",
    "ink2": "#445463",
    "ink3": "#5C6B7E",
    "line": "#DCE3EA",
    "fill": "#F3F6F9",
    "accent": "#0B6E99",
    "accent-soft": "#E2F0F7",
    "good": "#18794E",
    "good-soft": "#E2F4EA",
    "attention": "#8A5300",
    "attention-soft": "#FFF1D6",
    "fault": "#B42318",
    "fault-soft": "#FDE8E6",
    "scene-in": "#F7F9FB",
    "scene-out": "#D5DDE6",
    "button": "#0B6E99",
    "button-ink": "#FFFFFF",
    "glass": "rgba(255,255,255,.86)",
}
DARK = {
    "panel": "#161B21",
    "ink": "#E9EEF3",
    "ink2": "#B2BECA",
    "ink3": "#8F9EAD",
    "line": "#2A323B",
    "fill": "#1E252D",
    "accent": "#58BDE8",
    "accent-soft": "#123243",
    "good": "#4CC38A",
    "good-soft": "#10301F",
    "attention": "#F0B45B",
    "attention-soft": "#352508",
    "fault": "#FF8F85",
    "fault-soft": "#3E1714",
    "scene-in": "#262E37",
    "scene-out": "#0B0F13",
    "button": "#1B78A6",
    "button-ink": "#FFFFFF",
    "glass": "rgba(22,27,33,.86)",
}
BRAND = {False: (4, 44, 61), True: (29, 127, 174)}
"""Base colours; viser uses a base colour as the eighth of ten shades and draws a lighter one, here the accent."""
RGB_OF_TONE = {"attention": (217, 130, 0), "fault": (180, 35, 24), "busy": (11, 110, 153), "good": (24, 121, 78)}

SHEETS = "page.css", "gauge.css", "side_by_side.css", "file_dialog.css", "tour.css", "live.css"
LEFT_PX, RIGHT_PX = 300, 404
PROFILE_PX = 268
"""Height of the bottom panel with a curve in it."""


def palette(dark: bool) -> dict[str, str]:
    """Return the colours of a theme by name."""
    return DARK if dark else LIGHT


def page_style(dark: bool, bottom_px: int) -> Markup:
    """Return the style element of the page; `bottom_px`: height of the panel with a curve below the scene."""
    colours = ";".join(f"--{name}:{value}" for name, value in palette(dark).items())
    return style_sheet(f":root,[data-mantine-color-scheme]{{{colours};--bottom:{bottom_px}px}}\n{_page_css()}")


def by_id(uuid: str) -> str:
    """Return the CSS selector of an element id; a leading digit is escaped."""
    return f"#\\3{uuid[0]} {uuid[1:]}" if uuid[0].isdigit() else f"#{uuid}"


@cache
def _page_css() -> str:
    return read_static(*SHEETS)


# -------------------------------------------------------------------------------------------------------------- buttons


TIGHT_ROW = 3
"""Number of buttons in a row from which their labels get compact spacing."""


def row_style(buttons: Sequence[Any], height_px: int, filled: Any = None) -> Markup:
    """Return the styles that arrange adjacent buttons in a row of equal widths, all outlined except `filled`."""
    gap_px = 6
    width = f"calc((100% - 2*var(--mantine-spacing-xs) - {gap_px * (len(buttons) - 1)}px)/{len(buttons)})"
    rules = "".join(
        f"div:has(>{by_id(b._impl.uuid)}){{display:inline-block;vertical-align:top;width:{width};margin-right:0!important;"
        f"margin-left:{'var(--mantine-spacing-xs)' if k == 0 else f'{gap_px}px'}!important}}"
        + (_high(b, height_px) if b is filled else _outlined(b, height_px))
        + (_tight(b) if len(buttons) >= TIGHT_ROW else "")
        for k, b in enumerate(buttons)
    )
    return style_sheet(rules)


def outlined_style(handle: Any, height_px: int = 36) -> Markup:
    """Return the styles of a button with an outline."""
    return style_sheet(_outlined(handle, height_px))


def leading_style(handle: Any, height_px: int = 44, sticky: bool = True) -> Markup:
    """Return the styles of a filled button."""
    selector = by_id(handle._impl.uuid)
    rules = (
        f"{selector}{{height:{height_px}px!important}}{selector} .mantine-Button-label{{font-size:15.5px!important}}"
    )
    if sticky:
        foot = "position:sticky;bottom:0;z-index:3;background:var(--panel);padding:6px 0 8px!important"
        rules += f"div:has(>{selector}){{{foot}}}div:has(>{selector})::before{{content:'';pointer-events:none;{_FADE}}}"
        rules += f".mantine-ScrollArea-viewport:has({selector}){{scroll-padding-bottom:{height_px + _FOOT_PX}px}}"
    return style_sheet(rules)


_FOOT_PX = 74
"""Height of the foot of a panel beside its button: padding, two lines above it, and the fade."""
_FADE = "position:absolute;inset:auto 0 100%;height:14px;background:linear-gradient(transparent,var(--panel))"
"""Rows fade out above the foot that covers them."""
_LEAD_PX = 58
"""Height of the leading button with its margins."""


def at_foot_style(handle: Any) -> Markup:
    """Return the styles that keep a button visible above the leading button while the panel scrolls."""
    row = f"div:has(>{by_id(handle._impl.uuid)})"
    sticks = f"position:sticky;bottom:{_LEAD_PX}px;z-index:4;padding-top:6px;background:var(--panel)"
    fade = f"{row}::before{{content:'';pointer-events:none;{_FADE}}}"
    return style_sheet(f"{row}{{{sticks};box-shadow:6px 0 0 var(--panel)}}{fade}")


def _tight(handle: Any) -> str:
    """Return compact styles for an icon and a label in a third of the left panel."""
    selector = by_id(handle._impl.uuid)
    label, sign = (
        f"{selector} .mantine-Button-label{{font-size:12.5px}}",
        f"{selector} .mantine-Button-section{{margin-inline-end:4px}}",
    )
    return f"{selector}{{padding:0 2px!important}}{label}{sign}"


def _high(handle: Any, height_px: int) -> str:
    return f"{by_id(handle._impl.uuid)}{{height:{height_px}px!important;padding:0 6px!important}}"


def _outlined(handle: Any, height_px: int) -> str:
    selector = by_id(handle._impl.uuid)
    return (
        f"{selector}{{height:{height_px}px!important;background:transparent!important;color:var(--ink)!important;"
        f"border:1px solid var(--line)!important;padding:0 6px!important}}"
        f"{selector}:hover{{background:var(--fill)!important}}{selector}[data-disabled]{{color:var(--ink3)!important}}"
    )


def chosen_style(mark: str, chosen: int) -> Markup:
    """Return the styles of the button group after an element of a class: highlights a button by its place."""
    group = f"div:has(>.{mark})+div button"
    rest = "height:28px!important;border-color:var(--line)!important;color:var(--ink)!important"
    this = "background:var(--accent)!important;color:var(--panel)!important;border-color:var(--accent)!important"
    return style_sheet(f"{group}{{{rest}}}{group}:nth-child({chosen + 1}){{{this}}}")
