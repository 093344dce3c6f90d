"""A widget of a form: what a person puts in is not taken back by what was read before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from wafer_viewer.gui.elements import mount
from wafer_viewer.gui.elements.elements import Number
from wafer_viewer.gui.elements.mount import QUIET_S, InputWidget, _Placed


@dataclass
class Handle:
    """A widget of viser's, as far as a field knows it."""

    value: float = 1.0
    disabled: bool = False
    visible: bool = True
    heard: list[Callable[[Any], None]] = field(default_factory=list)

    def on_update(self, hear: Callable[[Any], None]) -> None:
        self.heard.append(hear)

    def put_in(self, value: float) -> None:
        self.value = value
        self.tell()

    def tell(self) -> None:
        """viser calls back later than it takes a value over."""
        for hear in self.heard:
            hear(SimpleNamespace(client=object(), target=self))


@dataclass
class Page:
    """A page that is drawn when the test says so."""

    as_of_s: float = 0.0
    told: list[Any] = field(default_factory=list)

    def tell(self, fault: Any) -> None:
        self.told.append(fault)

    def settle(self, title: str) -> None:
        pass

    def locks(self, element: Any) -> bool:
        return False

    def say(self, title: str, text: str, tone: Any = "good") -> None:
        self.told.append(title)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(mount.time, "monotonic", lambda: now.s)
    return now


class Field:
    """An input for a number on a page."""

    def __init__(self, page: Page, handle: Handle) -> None:
        self.put: list[float] = []
        self._widget = InputWidget(
            SimpleNamespace(add_number=lambda *_, **__: handle),  # pyright: ignore[reportArgumentType]
            page,  # pyright: ignore[reportArgumentType]
            _Placed((), self._element(1.0), 0.0, "The report was not changed"),
        )

    def _element(self, value: float) -> Number:
        return Number("Length", value, self.put.append, "")

    def show(self, value: float) -> None:
        self._widget.show(self._element(value))


def a_field(page: Page) -> tuple[Field, Handle]:
    handle = Handle()
    return Field(page, handle), handle


def test_it_shows_what_the_session_has(clock: SimpleNamespace):
    page = Page(as_of_s=clock.s)
    shown, handle = a_field(page)
    shown.show(2.0)
    assert handle.value == 2.0


def test_what_was_read_before_it_was_put_in_is_never_shown_however_late(clock: SimpleNamespace):
    page = Page(as_of_s=clock.s)
    shown, handle = a_field(page)
    clock.s += 1.0
    handle.put_in(5.0)
    clock.s += 60.0  # the drawing of the older value comes at last
    shown.show(1.0)
    assert handle.value == 5.0
    page.as_of_s = clock.s
    shown.show(4.0)
    assert handle.value == 4.0, "what the session made of it"


def test_while_it_is_moved_it_is_left_alone(clock: SimpleNamespace):
    page = Page()
    shown, handle = a_field(page)
    handle.put_in(5.0)
    clock.s += QUIET_S / 2
    page.as_of_s = clock.s
    shown.show(1.0)
    assert handle.value == 5.0


def test_what_was_put_in_is_not_shown_over_before_it_is_heard(clock: SimpleNamespace):
    page = Page(as_of_s=clock.s)
    shown, handle = a_field(page)
    shown.show(2.0)
    handle.value = 5.0  # has come, and waits for a thread that tells
    clock.s += 10.0
    page.as_of_s = clock.s
    shown.show(2.0)
    assert handle.value == 5.0
    handle.tell()
    assert shown.put == [5.0]
    assert handle.value == 5.0
