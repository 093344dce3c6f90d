"""A dialog on viser's own widgets: what it holds, its errors, and when it closes."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest
import viser

from wafer_viewer.gui.dialogs.dialog import Confirm, Dialog, KeepOpen, ask, ask_text
from wafer_viewer.gui.elements.elements import Text
from wafer_viewer.model.errors import WaferViewerError

ICON = viser.Icon.CHECK


@pytest.fixture(scope="module")
def gui() -> Iterator[Any]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.gui
    server.stop()


@pytest.fixture
def page(gui: Any) -> Any:
    """A page that draws its dialogs as soon as one of them asks for it."""
    page = SimpleNamespace(gui=gui, opened=(), as_of_s=0.0, told=[], answers=None, view=None)
    page.session = SimpleNamespace(snapshot=None)
    page.redraw = lambda: [dialog.show(None, None) for dialog in page.opened]
    page.tell = lambda fault: page.told.append(fault.text)
    page.say, page.on_entered, page.entered = (lambda *_: None), (lambda _: None), (lambda: None)
    page.on_pick, page.locks = (lambda *_: None), (lambda _: False)
    return page


def dialog_of(page: Any) -> Any:
    (dialog,) = page.opened
    return dialog


def shown(page: Any) -> str:
    return " ".join(getattr(handle, "content", "") for handle in dialog_of(page).modal._children.values())


def test_it_closes_after_its_action_and_the_failure_of_a_command_is_told(page: Any):
    command: Future[None] = Future()
    ask(page, "Move?", "To X 0.", Confirm("Move", ICON, lambda _: command, "The stage did not move"))
    dialog = dialog_of(page)
    assert "To X 0." in shown(page)
    dialog.press()
    assert (dialog.modal.closed, page.opened) == (True, ())
    command.set_exception(WaferViewerError("The stage is at its limit."))
    assert page.told == ["The stage is at its limit."]


def test_an_error_of_its_action_stands_in_the_dialog_which_stays_open(page: Any):
    def refuse(_: Any) -> None:
        raise WaferViewerError("The name is missing: type one.")

    ask(page, "Keep?", "", Confirm("Keep", ICON, refuse, "Nothing was kept"))
    dialog_of(page).press()
    assert "The name is missing: type one." in shown(page)
    dialog_of(page).settle("Nothing was kept")
    page.redraw()
    assert "The name is missing" not in shown(page)
    dialog_of(page).close()


def test_it_stays_open_where_its_action_shows_something_first(page: Any):
    def later(_: Any) -> None:
        raise KeepOpen

    ask(page, "Keep?", "", Confirm("Keep", ICON, later, "Nothing was kept"))
    dialog_of(page).press()
    assert not dialog_of(page).modal.closed
    dialog_of(page).close()


def test_it_holds_what_is_typed(page: Any):
    kept: list[str] = []
    ask_text(page, "Rename", "", ("Name", "old", ""), Confirm("Rename", ICON, lambda d: kept.append(d.own), "Failed"))
    dialog = dialog_of(page)
    (name,) = (one for one in dialog._contents(dialog) if isinstance(one, Text))
    assert name.value == "old"
    name.put("new")
    dialog.press()
    assert kept == ["new"]


def test_one_that_has_become_pointless_closes_itself(page: Any):
    def contents(here: Dialog[None]) -> tuple[()]:
        here.close()
        return ()

    Dialog(page, "The scan is stopped", "", Confirm("Go on", ICON, print, "Failed"), None, contents)
    assert page.opened == ()
