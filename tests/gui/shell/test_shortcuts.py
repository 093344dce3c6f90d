"""The table of keys: no key does two things, and none is the camera's."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.overlays.toolbar import PrintPicture
from wafer_viewer.gui.shell.saved_views import SavedViews
from wafer_viewer.gui.shell.shortcuts import Palette, Parts, commands_of, shortcut_table
from wafer_viewer.gui.shell.tour_guide import welcome_commands
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.report import report_commands
from wafer_viewer.gui.steps.review.defect_list import section_commands
from wafer_viewer.gui.steps.review.die_map import map_commands
from wafer_viewer.gui.steps.review.die_stack import stack_commands
from wafer_viewer.gui.steps.review.judging import review_commands
from wafer_viewer.gui.steps.surface.comparison import comparison_commands
from wafer_viewer.gui.widgets.controls import Command, looking, spoken
from wafer_viewer.model.job import Notebook, SavedView
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region
from wafer_viewer.session.state.snapshot import NotebookState, Snapshot

CAMERA = set("WASDQE")
OF_SLIDERS = {"end", "arrowup", "arrowdown", "arrowleft", "arrowright", "space", "tab"}
"""And of buttons and panels: a command would take them away wherever the page has the focus."""
LINE = Region.line(0, 0, 10, 0, 1.0)
EMPTY, PLANNED, MEASURED = fake.empty(), fake.planned(), fake.measured()


def with_views(snapshot: Snapshot, n: int = 12, name: str = "The edge") -> Snapshot:
    """As many saved views, of which the first nine have keys."""
    views = tuple(
        SavedView(number=k, name=f"{name} {k}", position_mm=(0, -1, 1), look_at_mm=(0, 0, 0)) for k in range(1, n + 1)
    )
    return replace(snapshot, notebook=NotebookState(Notebook(views=views)))


def all_commands() -> list[Command]:
    page = SimpleNamespace(session=MagicMock(), change=MagicMock(), on_pick=MagicMock(), on_close=MagicMock())
    scene = MagicMock()
    views, picture = SavedViews(page, scene), PrintPicture(page, scene)
    looks = [*looking(MagicMock()), *views.commands(), *views.going(with_views(fake.measured())), *picture.commands()]
    of_steps = [*report_commands(MagicMock()), *comparison_commands(MagicMock()), *review_commands(MagicMock())]
    of_steps += [*section_commands(MagicMock()), *map_commands(MagicMock())]
    of_steps += stack_commands(MagicMock(), MagicMock())
    return [*looks, *commands_of(page, MagicMock(spec=Parts)), *welcome_commands(MagicMock()), *of_steps]


@pytest.mark.parametrize(
    "view", [View(step="surface", tool="step"), View(step="review"), View(step="review", review="defect 1")]
)
def test_no_key_does_two_things(view: View):
    here = [c for c in all_commands() if c.key and (c.here is None or c.here(MEASURED, view))]
    used = Counter((c.key, c.modifier) for c in here)
    assert [key for key, times in used.items() if times > 1] == []
    assert ("N", "shift") in used
    assert ("1", "shift") in used


def test_a_command_without_a_key_has_no_modifier():
    assert not [c.name for c in all_commands() if c.modifier and not c.key]


def test_the_keys_of_the_camera_stay_its_own():
    assert not {c.key for c in all_commands() if c.modifier is None} & CAMERA


def test_sliders_and_buttons_keep_their_keys():
    assert not {c.key for c in all_commands() if c.modifier in (None, "shift")} & OF_SLIDERS


def test_names_in_the_palette_are_unlike():
    names = Counter(c.name for c in all_commands())
    assert [name for name, times in names.items() if times > 1] == []


def test_every_tool_for_measuring_has_a_key():
    named = {c.name for c in all_commands() if c.key}
    assert named >= {tool.title for tool in TOOLS.values()}


def test_the_sheet_lists_every_key_and_says_it_as_people_do():
    commands = all_commands()
    text = shortcut_table(commands)
    assert all(c.spoken_key in text for c in commands if c.key and c.listed)
    assert spoken("Z", "cmd/ctrl+shift") == "Ctrl + Shift + Z"
    assert spoken("pagedown") == "Page Down"


class Listed:
    """A browser's palette: what it lists, and what a person is told."""

    def __init__(self, commands: list[Command], more=lambda _: ()):
        self.names: dict[str, object] = {}
        self.said: list[tuple[str, str]] = []
        self.gui, self.session, self.view = self, SimpleNamespace(snapshot=EMPTY), View()
        self._palette = Palette(self, commands, more)

    def add_command(self, label: str, **_: object) -> SimpleNamespace:
        assert label not in self.names
        return SimpleNamespace(
            on_trigger=lambda act: self.names.__setitem__(label, act), remove=lambda: self.names.pop(label)
        )

    def look(self, snapshot: Snapshot, view: View) -> None:
        self.session.snapshot, self.view = snapshot, view
        self._palette.show(snapshot, view)

    def on_close(self, last) -> None:
        self.last = last

    def choose(self, name: str) -> None:
        heard = self.names[name](None)
        if asyncio.iscoroutine(heard):
            asyncio.run(heard)
            self.last()
            self._palette._in_order.shutdown()

    def say(self, title: str, text: str, tone: str) -> None:
        self.said.append((title, text))


def test_only_views_that_exist_are_listed_by_the_name_they_have_now():
    views = SavedViews(SimpleNamespace(on_pick=MagicMock()), MagicMock())
    page = Listed([], views.going)
    page.look(MEASURED, View())
    assert page.names == {}
    page.look(with_views(MEASURED, 2), View())
    assert list(page.names) == ["Go to view: The edge 1", "Go to view: The edge 2"]
    page.look(with_views(MEASURED, 1, "Gel drop"), View())
    assert list(page.names) == ["Go to view: Gel drop 1"]
    keys = [(c.key, c.modifier) for c in views.going(with_views(MEASURED))]
    assert keys == [*((f"{n}", "shift") for n in range(1, 10)), *[(None, None)] * 3]


@pytest.mark.parametrize(
    ("snapshot", "view", "name", "why"),
    [
        (EMPTY, View(), "Surface", "no dataset is open"),
        (EMPTY, View(), "Step height", "no dataset is open"),
        (EMPTY, View(), "Colour by slope", "no dataset is open"),
        (EMPTY, View(), "Close the dataset", "no dataset is open"),
        (EMPTY, View(), "Picture at print size", "no dataset is open"),
        (EMPTY, View(), "Undo", "nothing was changed in Plan"),
        (PLANNED, View(), "Acquire", "no scan runs"),
        (PLANNED, View(), "Accept", "no dataset is open"),
        (MEASURED, View(step="review"), "Class: Particle", "no defect is under review"),
        (MEASURED, View(), "Hillshade", "go to Surface first"),
        (MEASURED, View(step="review"), "Pictures or gallery", "no defect is under review"),
        (MEASURED, View(step="review"), "All dies overlaid, next place", "the surface has not been inspected yet"),
        (MEASURED, View(step="surface"), "Accept", "go to Review first"),
        (MEASURED, View(step="surface", show=2), "Fields and overlaps", "over the stitched surface"),
        (MEASURED, View(step="surface"), "Close the comparison", "no comparison is shown"),
        (MEASURED, View(step="surface"), "Delete the result", "go to Measure first"),
        (MEASURED, View(step="measure"), "Rename the result…", "no result is chosen"),
        (MEASURED, View(step="measure"), "Add a profile line", "key L adds a line"),
        (MEASURED, View(step="measure", tool="profile", lines=(LINE,)), "Next profile line", "no other line"),
        (
            MEASURED,
            View(step="measure", tool="profile", lines=(LINE,)),
            "Remove a corner of the profile line",
            "the line is straight",
        ),
        (MEASURED, View(step="measure", tool="profile", lines=(LINE,) * 4), "Add a profile line", "4 lines already"),
    ],
)
def test_a_command_that_is_not_possible_says_why_and_does_nothing(snapshot, view, name, why):
    done = MagicMock()
    page = Listed([replace(command, act=done) for command in all_commands() if command.name == name])
    page.look(snapshot, view)
    page.choose(name)
    ((title, text),) = page.said
    assert title == name.removesuffix("…")
    assert text.startswith("Not now: ")
    assert why in text
    done.assert_not_called()


@pytest.mark.parametrize(
    ("view", "name"),
    [
        (View(step="surface"), "Hillshade"),
        (View(step="surface"), "Step height"),
        (View(step="surface"), "Review"),
        (View(step="review"), "Next under review"),
        (View(step="measure", selected=1), "Delete the result"),
        (View(step="measure", tool="profile", lines=(LINE, LINE)), "Next profile line"),
    ],
)
def test_a_command_that_is_possible_is_carried_out(view, name):
    done = MagicMock()
    page = Listed([replace(command, act=done) for command in all_commands() if command.name == name])
    page.look(MEASURED, view)
    page.choose(name)
    done.assert_called_once()
    assert page.said == []


def test_escape_is_the_pages_only_where_there_is_something_to_leave():
    page = Listed([command for command in all_commands() if command.name == "Leave the tool"])
    page.look(MEASURED, View(step="measure"))
    assert page.names == {}
    page.look(MEASURED, View(step="measure", tool="step"))
    assert list(page.names) == ["Leave the tool"]
