"""A screen with two pixels to a CSS pixel: panels and glass are laid out, and lengths drawn, in CSS pixels."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.conftest import WINDOW
from tests.browser.kept_page import PATIENCE_MS
from tests.browser.sessions.seen_session import SeenSession
from tests.browser.steps import ANSWER_MS, eventually, go_to
from wafer_viewer.gui.app import start

pytestmark = [pytest.mark.browser, pytest.mark.slow]
NEAR_PX, NEAR = 6, 0.2
"""The relief stands nearer to the camera than the ground that the bar is drawn for; a wrong ratio doubles it."""
SCALE = 2
APART_PX = 120
SCENE = "canvas[data-engine]"


@pytest.fixture
def sharp(browser: Browser) -> Iterator[Page]:
    session = SeenSession()
    running = start(session)
    context = browser.new_context(viewport=WINDOW, device_scale_factor=SCALE)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(running.address)
    page.locator(".wv-title").first.wait_for()
    yield page
    context.close()
    running.stop()
    session.close()


def width_of(page: Page, selector: str) -> float:
    return page.evaluate("s => document.querySelector(s)?.getBoundingClientRect().width ?? 0", selector)


@pytest.mark.campaign
def test_curves_are_as_wide_as_the_scene_and_the_scale_bar_as_long_as_it_says(sharp: Page):
    sharp.locator(SCENE).wait_for()
    drawn_px = sharp.evaluate("s => document.querySelector(s).width", SCENE)
    assert drawn_px > 1.2 * width_of(sharp, SCENE), "this browser draws no finer than a CSS pixel"
    go_to(sharp, "Measure")
    sharp.locator("[data-pick=tool][data-k=profile]").first.click()
    dock = "[data-floating-window]:has(.wv-bottom)"
    eventually(
        lambda: width_of(sharp, dock) > 0 and abs(width_of(sharp, dock) - width_of(sharp, SCENE)) < NEAR_PX,
        "the curve is as wide as the scene",
    )
    go_to(sharp, "Surface")
    sharp.keyboard.press("t")
    expect(sharp.locator(".wv-scale b")).to_be_visible()
    eventually(lambda: abs(um_per_px_of_bar(sharp) / um_per_px_of_scene(sharp) - 1) < NEAR, "the scale bar is right")


def um_per_px_of_bar(page: Page) -> float:
    text = page.locator(".wv-scale b").inner_text().replace("\u202f", " ").split()
    return float(text[0]) * {"µm": 1.0, "mm": 1000.0}[text[1]] / width_of(page, ".wv-scale i")


def um_per_px_of_scene(page: Page) -> float:
    """From two clicks on the surface, seen from above, by the places that the read-out tells."""
    left, right = (x_um_at(page, along) for along in (-APART_PX / 2, APART_PX / 2))
    return (right - left) / APART_PX


def x_um_at(page: Page, right_px: float) -> float:
    box = page.locator(SCENE).bounding_box()
    assert box is not None
    read_out = page.locator(".wv-read")
    before = read_out.inner_text() if read_out.is_visible() else ""

    def answered() -> bool:
        page.mouse.click(box["x"] + box["width"] / 2 + right_px, box["y"] + box["height"] / 2)
        with suppress(AssertionError):
            expect(read_out).to_be_visible(timeout=ANSWER_MS)
            expect(read_out).not_to_have_text(before, timeout=ANSWER_MS)
            return True
        return False

    eventually(answered, "the surface was hit", 60)
    said = re.match(r"x\s*([\d.\s\u2212-]+?)\s*y", read_out.inner_text())
    assert said is not None, read_out.inner_text()
    return float(re.sub(r"\s", "", said[1]).replace("\u2212", "-"))
