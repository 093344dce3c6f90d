"""Tools of the toolbar: icons, and their names where there is room."""

from __future__ import annotations

import re

from wafer_viewer.gui.tools.tool_palette import tool_strip


def names(strip: str) -> list[str]:
    return re.findall(r"</span>([A-Z][a-z]+)</span>", strip)


def test_tools_have_their_names_where_there_is_room_and_the_active_one_always():
    assert names(tool_strip("step", named=False)) == ["Step"]
    assert {"Profile", "Step", "Flatness"} <= set(names(tool_strip("step", named=True)))
    assert names(tool_strip("none", named=False)) == []
