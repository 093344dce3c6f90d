"""A drag over the histogram, over the scene and along a profile: what lights up, what is counted, where cursors go."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.steps import eventually, go_to, press, title_is
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.steps.surface.points import amount

pytestmark = [pytest.mark.browser, pytest.mark.slow]
LOW = 0.8
"""Where the brush begins on the histogram; it ends beyond its right end."""


@pytest.fixture
def looking(serve: Callable[[MeasuringSession], Page]) -> tuple[Page, MeasuringSession]:
    """A page in Surface whose histogram is there."""
    session = MeasuringSession()
    page = serve(session)
    go_to(page, "Surface")
    page.locator(".wv-brush").wait_for()
    return page, session


def figure(page: Page, name: str) -> Locator:
    """The value beside a name in the panel."""
    return page.locator(".wv-kv > div", has_text=name).first.locator("xpath=following-sibling::div[1]")


def drag(page: Page, over: Locator, start: tuple[float, float], end: tuple[float, float], held: str = "") -> None:
    """Drag between two places of an element, as shares of its sides."""
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    assert box is not None
    (x0, y0), (x1, y1) = ((box["x"] + u * box["width"], box["y"] + v * box["height"]) for u, v in (start, end))
    if held:
        page.keyboard.down(held)
    page.mouse.move(x0, y0)
    page.mouse.down()
    page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2, steps=3)
    page.mouse.move(x1, y1, steps=3)
    page.mouse.up()
    if held:
        page.keyboard.up(held)


@pytest.mark.campaign
def test_brushed_heights_light_up_and_are_told(looking: tuple[Page, MeasuringSession]):
    page, session = looking
    lit = page.locator(".wv-map-marks rect[fill='#C2255C']")
    drag(page, page.locator(".wv-brush"), (LOW, 0.5), (1.0, 0.5))
    head = page.locator(".wv-h", has_text="Brushed")
    expect(head).to_be_visible()
    low_um = float(head.inner_text().split("+")[1].split()[0])
    z = session.surface_source(0).z_um
    brushed = z[np.isfinite(z) & (z > low_um)]
    told = figure(page, "Mean, spread").inner_text()
    assert float(told.split()[0]) == pytest.approx(float(brushed.mean()), abs=0.02)
    expect(lit).not_to_have_count(0)
    eventually(lambda: any(r.look.brush_um is not None for r in session._painter.asked), "tiles in the brush's colour")

    page.keyboard.press("Escape")
    expect(page.get_by_text("Drag to brush")).to_be_visible()
    expect(lit).to_have_count(0)

    drag(page, page.locator(".wv-brush"), (LOW, 0.5), (1.0, 0.5))
    press(page, "Show only these")
    n_clipped = int(np.isfinite(z).sum()) - brushed.size
    expect(page.locator(".wv-points")).to_contain_text(f"{amount(n_clipped)} clipped")


def test_a_drag_with_shift_selects_what_is_counted_and_measured(looking: tuple[Page, MeasuringSession]):
    page, session = looking
    rows, cols = session.surface_source(0).shape
    sentence = page.locator(".wv-sub").first
    expect(sentence).to_contain_text(f"{number(cols, 0)} × {number(rows, 0)} points")
    drag(page, page.locator("canvas[data-engine]"), (0.45, 0.45), (0.55, 0.6), held="Shift")
    expect(sentence).to_contain_text("Stitched surface, selection · ")
    expect(sentence).not_to_contain_text(f"{number(cols, 0)} ×")
    press(page, "Measure the selection")
    title_is(page, "Flatness")


@pytest.mark.campaign
def test_a_click_on_the_line_puts_a_cursor_there(looking: tuple[Page, MeasuringSession]):
    page, _ = looking
    page.locator("[data-pick=look][data-k=top]").click()
    page.keyboard.press("l")
    grips = page.locator(".wv-slide")
    expect(grips).to_have_count(2)
    before = [float(grip.input_value()) for grip in grips.all()]
    canvas = page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None

    def is_put() -> bool:
        """The line runs along x somewhere over the middle: click down a column until it is met."""
        for share in np.linspace(0.2, 0.8, 31):
            page.mouse.click(canvas["x"] + 0.42 * canvas["width"], canvas["y"] + share * canvas["height"])
            page.wait_for_timeout(60)
        return [float(grip.input_value()) for grip in grips.all()] != before

    eventually(is_put, "a cursor where the line was clicked", 60)
