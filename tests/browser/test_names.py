"""Every input has a name that assistive technology reads, that of its label, in every step of the true page's parts."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import go_to, numbers, press

pytestmark = [
    pytest.mark.browser,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]
UNNAMED = """() => [...document.querySelectorAll('input:not([type=hidden]), textarea, [role=slider], [role=combobox]')]
    .filter(at => at.getClientRects().length && !at.closest('[aria-hidden=true]'))
    .filter(at => !(at.getAttribute('aria-label') || at.getAttribute('aria-labelledby') || at.labels?.length))
    .map(at => at.outerHTML.slice(0, 200))"""
PLAN = (
    *("Name", "Lot", "Wafer id", "Product", "Operator", "Size, mm", "Columns, rows", "Overlap, %", "Centre, µm"),
    *("From, to, µm", "Step, µm", "Exposures, µs"),
)


def wait_for_names(page: Page) -> None:
    page.wait_for_function(f"() => ({UNNAMED})().length === 0")


def test_every_input_of_plan_is_found_by_its_label(serve: Serve):
    page = serve(fake.FakeSession(fake.planned()))
    panel = page.locator("[data-dock-region=right]")
    for label in PLAN:
        n_inputs = 2 if label == "Overlap, %" else 1  # a slider, and the number beside it
        expect(panel.get_by_label(label, exact=True)).to_have_count(n_inputs)
    for label in ("Columns, rows", "Centre, µm", "From, to, µm"):
        expect(panel.get_by_label(f"{label}, second", exact=True)).to_have_count(1)
    wait_for_names(page)
    panel.get_by_role("textbox", name="Lot", exact=True).fill("L99")
    hidden = page.locator("div:has(>.wv-picks)+div input")
    expect(hidden).to_have_attribute("tabindex", "-1")


def test_the_ends_of_a_slider_can_be_read(serve: Serve):
    page = serve(fake.FakeSession(fake.planned()))
    ends = page.locator("[data-dock-region=right] .mantine-Slider-markLabel")
    expect(ends).to_have_text(["0", "50"])
    ends_lie_within(page.locator("[data-dock-region=right] .mantine-Slider-root").first, ends)


def test_the_ends_of_a_range_can_be_read(serve: Serve):
    page = serve(fake.FakeSession(fake.measured()))
    go_to(page, "Surface")
    ends = numbers(page, "From, to")
    expect(ends).to_have_count(2)
    low, high = (float(ends.nth(k).input_value()) for k in (0, 1))
    assert low < high
    cut = page.evaluate("fields => fields.filter(at => at.scrollWidth > at.clientWidth).length", ends.element_handles())
    assert cut == 0
    expect(page.locator(".multi-slider-thumb")).to_have_count(2)


def ends_lie_within(around: Locator, ends: Locator) -> None:
    slider = around.bounding_box()
    assert slider is not None
    for k in (0, 1):
        box = ends.nth(k).bounding_box()
        assert box is not None
        assert slider["x"] - 5 <= box["x"]
        assert box["x"] + box["width"] <= slider["x"] + slider["width"] + 5
        assert box["y"] + box["height"] <= slider["y"] + slider["height"] + 1
        colour, size = ends.nth(k).evaluate("at => [getComputedStyle(at).color, getComputedStyle(at).fontSize]")
        assert contrast_on_white(colour) >= 4.5
        assert float(size.removesuffix("px")) >= 11


def contrast_on_white(colour: str) -> float:
    """The contrast of a CSS colour ``rgb(r, g, b)`` by WCAG 2."""
    levels = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in levels]
    return 1.05 / (0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] + 0.05)


def test_no_input_is_without_a_name_in_any_step_or_dialog(serve: Serve):
    shown = serve(fake.FakeSession(fake.measured()))
    for step in ("Acquire", "Surface", "Measure", "Gauge check", "Review", "Report", "Plan"):
        go_to(shown, step)
        wait_for_names(shown)
    for opener in ("Open…", "Import…"):
        press(shown, opener)
        dialog = shown.get_by_role("dialog")
        expect(dialog.get_by_label("Path", exact=True)).to_have_count(1)
        if opener == "Import…":
            pixel = dialog.get_by_label("Pixel, µm", exact=True)
            expect(pixel).to_have_value("")
            expect(pixel).to_have_attribute("placeholder", "not given")
        wait_for_names(shown)
        shown.keyboard.press("Escape")
        expect(dialog).to_have_count(0)
