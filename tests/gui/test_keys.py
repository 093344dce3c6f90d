"""The table of keys: no key does two things, and none is the camera's."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from unittest.mock import MagicMock

from wafer_viewer.gui.commands import Command, looking, spoken
from wafer_viewer.gui.compare_section import CompareSection
from wafer_viewer.gui.keys import Parts, commands_of
from wafer_viewer.gui.keys_sheet import sheet_html
from wafer_viewer.gui.print_picture import PrintPicture
from wafer_viewer.gui.report_panel import ReportPanel
from wafer_viewer.gui.review_panel import ReviewPanel
from wafer_viewer.gui.saved_views import SavedViews
from wafer_viewer.gui.welcome import Welcome
from wafer_viewer.model.measuring import TOOLS

CAMERA = set("WASDQE")


def all_commands() -> list[Command]:
    page = SimpleNamespace(session=MagicMock(), change=MagicMock(), on_pick=MagicMock(), on_close=MagicMock())
    scene = MagicMock()
    views, picture = SavedViews(page, scene), PrintPicture(page, scene)
    looks = [*looking(MagicMock()), *views.commands(), *picture.commands()]
    panels = (ReviewPanel, ReportPanel, CompareSection, Welcome)
    of_panels = [command for panel in panels for command in panel.commands(MagicMock())]
    return [*looks, *commands_of(page, MagicMock(spec=Parts)), *of_panels]


def test_no_key_does_two_things():
    used = Counter((c.key, c.modifier) for c in all_commands() if c.key)
    assert [key for key, times in used.items() if times > 1] == []


def test_the_keys_of_the_camera_stay_its_own():
    assert not {c.key for c in all_commands() if c.modifier is None} & CAMERA


def test_names_in_the_palette_are_unlike():
    names = Counter(c.name for c in all_commands())
    assert [name for name, times in names.items() if times > 1] == []


def test_every_tool_for_measuring_has_a_key():
    named = {c.name for c in all_commands() if c.key}
    assert named >= {tool.title for tool in TOOLS.values()}


def test_the_sheet_lists_every_key_and_says_it_as_people_do():
    commands = all_commands()
    text = sheet_html(commands)
    assert all(c.spoken_key in text for c in commands if c.key and c.listed)
    assert spoken("Z", "cmd/ctrl+shift") == "Ctrl + Shift + Z"
    assert spoken("pagedown") == "Page Down"
