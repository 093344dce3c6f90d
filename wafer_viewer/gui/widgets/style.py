"""Style sheets and scripts of the page, and its two palettes of colours."""

from __future__ import annotations

from functools import cache
from pathlib import Path

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
HEADER_PX, LEFT_PX, RIGHT_PX = 56, 300, 404
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
