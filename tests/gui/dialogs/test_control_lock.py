"""Widgets that declare that they need control are locked for an observer; the others are not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from wafer_viewer.gui.dialogs.control_handover import ControlLock, control_strip
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import button, command_button, controlled, set_prop
from wafer_viewer.session.state.snapshot import Browser, ControlState, Snapshot

ANNA, BEN = Browser("a", "Anna"), Browser("b", "Ben")


class Gui:
    """The parts of viser's GUI that a lock needs."""

    def __init__(self) -> None:
        self._gui_input_handle_from_uuid: dict[str, Any] = {}
        self.drawn: list[SimpleNamespace] = []

    def add_html(self, content: str, order: float | None = None) -> SimpleNamespace:
        self.drawn.append(SimpleNamespace(content=content))
        return self.drawn[-1]

    def add_button(self, label: str, icon: Any, disabled: bool) -> SimpleNamespace:
        return self._input(label, disabled=disabled, on_click=lambda act: None)

    def add_text(self, label: str, value: str) -> SimpleNamespace:
        return self._input(label, value=value, disabled=False)

    def _input(self, label: str, **props: Any) -> SimpleNamespace:
        uuid = f"{id(self)}-{len(self._gui_input_handle_from_uuid)}"
        handle = SimpleNamespace(label=label, _impl=SimpleNamespace(uuid=uuid, removed=False), **props)
        self._gui_input_handle_from_uuid[uuid] = handle
        return handle


@pytest.fixture
def gui():
    return Gui()


@pytest.fixture
def page(gui):
    page = SimpleNamespace(gui=gui, browser=SimpleNamespace(key="b"), on_close=lambda act: None)
    page.say = lambda *words: None
    return page


@pytest.fixture
def lock(page):
    return ControlLock(page)


def held_by(key: str) -> Snapshot:
    return Snapshot(control=ControlState(browsers=(ANNA, BEN), holder=key))


def test_what_needs_control_is_locked_while_another_holds_it(gui, lock):
    stop, pause = button(gui, "Pause", None, print), command_button(gui, "Pause", None, print)
    lot, title = controlled(gui.add_text("Lot", "")), gui.add_text("Lot", "")
    lock.show(held_by("a"), View())
    late = command_button(gui, "Start", None, print, disabled=True)
    lock.show(held_by("a"), View())
    assert [w.disabled for w in (stop, title)] == [False, False], "a label says nothing about control"
    assert [w.disabled for w in (pause, lot, late)] == [True, True, True]
    set_prop(pause, "disabled", False)
    assert pause.disabled, "its part of the page does not unlock it"
    lock.show(held_by("b"), View())
    assert [w.disabled for w in (pause, lot, late)] == [False, False, True]


def test_elements_of_html_that_need_control_are_named_by_their_attribute(page):
    def style(holder: str) -> str:
        (strip,) = control_strip(SimpleNamespace(snapshot=held_by(holder), page=page))
        return strip.content

    assert html.NEEDS_CONTROL not in html.pick("theme")
    assert html.command_pick("undo", 3) == html.pick("undo", 3) + " " + html.NEEDS_CONTROL
    assert f"[{html.NEEDS_CONTROL}]{{" in style("a")
    assert html.NEEDS_CONTROL not in style("b")
