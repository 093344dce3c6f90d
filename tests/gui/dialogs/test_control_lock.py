"""Elements that declare that they need control are locked for an observer; the others are not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from wafer_viewer.gui.dialogs.control_handover import control_strip
from wafer_viewer.gui.elements.elements import Button, Text, Upload
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.session.state.snapshot import Browser, ControlState, Snapshot

ANNA, BEN = Browser("a", "Anna"), Browser("b", "Ben")


def held_by(key: str) -> Snapshot:
    return Snapshot(control=ControlState(browsers=(ANNA, BEN), holder=key))


def page_of(snapshot: Snapshot) -> Any:
    return SimpleNamespace(session=SimpleNamespace(snapshot=snapshot), browser=SimpleNamespace(key="b"))


@pytest.mark.parametrize(
    ("element", "needs_control"),
    [
        (Button("Pause", print), False),
        (Button("Pause", print, commands=True), True),
        (Text("Lot", "", print, "", commands=True), True),
        (Text("Lot", "", print, ""), False),
        (Upload("Send a file", print), True),
    ],
)
def test_what_needs_control_is_locked_while_another_holds_it(element: Any, needs_control: bool):
    assert Page.locks(page_of(held_by("a")), element) is needs_control
    assert not Page.locks(page_of(held_by("b")), element)


def test_operator_may_not_use_what_changes_a_job():
    people = ControlState(browsers=(ANNA, Browser("b", "Ben", role="operator")), holder="b", engineers=("Anna",))
    page = page_of(Snapshot(control=people))
    assert Page.locks(page, Button("Save plan", print, commands=True, action="Plan saved"))
    assert not Page.locks(page, Button("Start", print, commands=True, action="Scan started"))


def test_elements_of_html_that_need_control_are_named_by_their_attribute():
    def style(holder: str) -> str:
        here: Any = SimpleNamespace(snapshot=held_by(holder), page=page_of(held_by(holder)))
        (strip,) = control_strip(here)
        return strip.content

    assert html.NEEDS_CONTROL not in html.pick("theme")
    assert html.command_pick("undo", 3) == html.pick("undo", 3) + " " + html.NEEDS_CONTROL
    assert f"[{html.NEEDS_CONTROL}]{{" in style("a")
    assert html.NEEDS_CONTROL not in style("b")
