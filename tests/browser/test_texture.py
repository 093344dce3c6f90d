"""Texture and roughness as an operator measures them: filters are set in the panel, said, and refused."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.steps import go_to, set_numbers, title_is, type_into

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]


@pytest.fixture
def session() -> MeasuringSession:
    return MeasuringSession()


@pytest.fixture
def page(session: MeasuringSession, serve: Callable[[MeasuringSession], Page]) -> Page:
    shown = serve(session)
    go_to(shown, "Measure")
    title_is(shown, "Measure")
    expect(shown.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    return shown


def panel(page: Page) -> Locator:
    return page.locator("[data-dock-region=right]")


def test_texture_goes_through_the_filters_that_are_set(page: Page):
    page.keyboard.press("Shift+T")
    expect(panel(page)).to_contain_text("Smr1")
    expect(panel(page)).to_contain_text("filter: none")
    set_numbers(page, "S-filter, µm", 2)
    expect(panel(page)).to_contain_text("filter: Gaussian (ISO 16610-61), S 2 µm")
    set_numbers(page, "L-filter, µm", 5000)
    expect(panel(page)).to_contain_text("The L-filter of 5000 µm is longer than the face")
    expect(page.locator(".wv-answer")).to_have_count(0)
    type_into(page, "L-filter, µm", "")
    expect(page.locator(".wv-answer")).to_contain_text("Sa")


def test_a_filter_that_would_leave_nothing_is_refused_and_stays(page: Page):
    page.keyboard.press("Shift+T")
    set_numbers(page, "L-filter, µm", 12)
    expect(panel(page)).to_contain_text("filter: Gaussian (ISO 16610-61), L 12 µm")
    set_numbers(page, "S-filter, µm", 12)
    expect(page.locator(".mantine-Notification-root", has_text="must be under")).to_be_visible()
    expect(panel(page)).to_contain_text("filter: Gaussian (ISO 16610-61), L 12 µm")


@pytest.mark.campaign
def test_roughness_is_of_a_line_in_as_many_sampling_lengths_as_fit(page: Page):
    page.keyboard.press("Shift+J")
    expect(page.locator(".wv-answer")).to_contain_text("Ra")
    expect(panel(page)).to_contain_text("waviness included")
    set_numbers(page, "λc, µm", 10.5)
    expect(panel(page)).to_contain_text("3 × 10.5")
    expect(panel(page)).to_contain_text("3 of 5 sampling lengths")
