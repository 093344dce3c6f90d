"""Reports of a browser, as the page takes them: in the order in which they were written, whatever thread is first."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from wafer_viewer.gui.page.browser_info import BrowserEvents
from wafer_viewer.gui.state.view_state import BrowserIdentity, View
from wafer_viewer.session.state.snapshot import Snapshot


class Panel:
    """The left panel: what it was told, in order."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def set_width(self, width_px: int) -> None:
        pass

    def minimize(self) -> None:
        self.told.append("fold")

    def expand(self) -> None:
        self.told.append("unfold")


class PageOfReports:
    """A page with the hidden field alone; `report` is what its browser writes into it."""

    def __init__(self) -> None:
        self.gui = self
        self.session = SimpleNamespace()
        self.browser = BrowserIdentity()
        self.viewport = SimpleNamespace(set_size=lambda *size: None)
        self.view, self.watches_scan = View(), False
        self.main_panel = Panel()

    def add_html(self, text: str, order: float | None = None) -> None:
        pass

    def add_text(self, label: str, value: str) -> PageOfReports:
        return self

    def on_update(self, callback: Any) -> None:
        self.report = lambda **facts: callback(SimpleNamespace(target=SimpleNamespace(value=json.dumps(facts))))

    def remember(self, browser: BrowserIdentity) -> None:
        self.browser = browser

    def tell(self, fault: Any) -> None:
        raise AssertionError(fault)

    def redraw(self) -> None:
        pass

    def change(self, **choices: Any) -> None:
        self.view = replace(self.view, **choices)


@pytest.fixture
def page() -> PageOfReports:
    return PageOfReports()


@pytest.fixture
def left(page: PageOfReports) -> Panel:
    events = BrowserEvents(page)  # type: ignore[arg-type]
    events.left = Panel()
    events.show(Snapshot(), View())
    return events.left


def test_a_report_that_is_overtaken_does_not_fold_the_panel_of_a_window_that_is_wide_again(
    page: PageOfReports, left: Panel
):
    page.report(window=1024, left=[304, False], at_ms=10.0)
    page.report(window=1366, left=[38, True], at_ms=30.0)
    page.report(window=1024, left=[38, True], at_ms=20.0)
    assert left.told == ["fold", "unfold"]


def test_a_panel_that_is_still_folded_when_there_is_room_again_was_not_folded_by_a_person(
    page: PageOfReports, left: Panel
):
    page.report(window=1024, left=[304, False], at_ms=1.0)
    page.report(window=1366, left=[38, True], at_ms=2.0)
    page.report(window=1366, left=[38, True], scene=[900, 500], at_ms=3.0)
    page.report(window=1024, left=[38, True], at_ms=4.0)
    page.report(window=1366, left=[38, True], at_ms=5.0)
    assert left.told == ["fold", "unfold", "fold", "unfold"]
    assert not page.browser.layout.left_folded


def test_a_panel_that_a_person_folded_stays_folded(page: PageOfReports, left: Panel):
    page.report(window=1366, left=[38, True], at_ms=1.0)
    page.report(window=1024, left=[38, True], at_ms=2.0)
    page.report(window=1366, left=[38, True], at_ms=3.0)
    assert left.told == ["fold"]
    assert page.browser.layout.left_folded


def test_a_page_has_the_colours_of_the_system_until_a_person_chooses(page: PageOfReports, left: Panel):
    page.report(dark=True)
    assert page.view.dark
    page.change(dark=False, theme_chosen=True)
    page.report(dark=True)
    assert not page.view.dark


def test_a_window_as_narrow_as_a_phone_watches_the_scan(page: PageOfReports, left: Panel):
    seen = []
    for window in (390, 0, 1366):
        page.report(window=window)
        seen.append(page.watches_scan)
    assert seen == [True, False, False]
