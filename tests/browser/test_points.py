"""What is shown is what is counted: the true session's surface, its fields and its numbers on the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.points_dataset import FIELD, PILLAR_UM, points_dataset
from tests.browser.steps import eventually, go_to, press, title_is
from wafer_viewer.draw.numbers import number, share
from wafer_viewer.gui.points_section import amount
from wafer_viewer.model.surface import HeightMap
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Session, HeightMap]]:
    """A session with the dataset open and stitched, and the surface of its field 5."""
    folder: Path = tmp_path_factory.mktemp("wafers")
    field = points_dataset(folder / "pillar.wafer")
    session = Session(folder)
    session.open_dataset(folder / "pillar.wafer").result(WORK_S)
    session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    yield session, field
    session.close()


@pytest.fixture
def session(opened: tuple[Session, HeightMap]) -> Session:
    return opened[0]


def figure(page: Page, name: str) -> Locator:
    """The value beside a name in the panel."""
    return page.locator(".wv-kv > div", has_text=name).first.locator("xpath=following-sibling::div[1]")


def show(page: Page, name: str) -> None:
    page.get_by_label("Show", exact=True).click()
    page.get_by_role("option", name=name, exact=True).click()


def test_the_numbers_are_those_of_what_is_shown(page: Page, opened: tuple[Session, HeightMap]):
    session, field = opened
    info = session.snapshot.surface
    assert info is not None
    go_to(page, "Surface")
    title_is(page, "Surface")
    sentence = page.locator(".wv-sub").first
    expect(sentence).to_contain_text(f"{number(info.cols, 0)} × {number(info.rows, 0)} points")

    show(page, f"Field {FIELD}")
    rows, cols = field.shape
    expect(sentence).to_contain_text(f"Field {FIELD} · {number(cols, 0)} × {number(rows, 0)} points")
    expect(sentence).to_contain_text(f"{share(float(field.measured.mean()))} measured")
    expect(figure(page, "Highest")).to_contain_text(number(float(np.nanmax(field.z_um)), 2, signed=True))
    expect(figure(page, "no texture")).to_contain_text(share(float((field.origin == 12).mean())))

    show(page, "Stitched surface")
    expect(sentence).to_contain_text(f"{number(info.cols, 0)} × {number(info.rows, 0)} points")
    expect(figure(page, "Highest")).to_contain_text(number(info.highest_um, 2, signed=True))


def drag(page: Page, box: dict[str, float], start: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag between two places of a box, as shares of its sides."""
    (x0, y0), (x1, y1) = ((box["x"] + u * box["width"], box["y"] + v * box["height"]) for u, v in (start, end))
    page.mouse.move(x0, y0)
    page.mouse.down()
    page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2, steps=3)
    page.mouse.move(x1, y1, steps=3)
    page.mouse.up()


def test_brushed_heights_are_told_and_lead_on(page: Page, opened: tuple[Session, HeightMap]):
    _, field = opened
    go_to(page, "Surface")
    show(page, f"Field {FIELD}")
    expect(page.locator(".wv-sub").first).to_contain_text(f"Field {FIELD} · 360")
    area = page.locator(".wv-brush")
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    assert box is not None
    drag(page, box, (0.7, 0.5), (1.0, 0.5))
    brushed = np.isfinite(field.z_um) & (field.z_um > 0.8 * PILLAR_UM)
    expect(figure(page, "Mean, spread")).to_contain_text(number(PILLAR_UM, 2, signed=True))
    expect(page.locator(".wv-kv").first).to_contain_text(number(brushed.sum(), 0))
    expect(page.locator(".wv-map-marks rect[fill='#C2255C']")).not_to_have_count(0)

    page.keyboard.press("Escape")
    expect(page.get_by_text("Drag to brush")).to_be_visible()
    expect(page.locator(".wv-map-marks rect[fill='#C2255C']")).to_have_count(0)

    drag(page, box, (0.7, 0.5), (1.0, 0.5))
    press(page, "Keep only these")
    expect(page.locator(".wv-points")).to_contain_text("clipped")
    expect(page.locator(".wv-points")).to_contain_text(f"{amount(brushed.sum())} of ")


def test_a_drag_over_the_surface_selects_and_is_counted(page: Page, opened: tuple[Session, HeightMap]):
    session, _ = opened
    go_to(page, "Surface")
    show(page, "Stitched surface")
    page.locator("[data-pick=look][data-k=top]").click()
    expect(page.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    page.locator("[data-pick=select]").click()
    expect(page.locator("[data-pick=select]")).to_have_attribute("aria-pressed", "true")
    canvas = page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None
    sentence = page.locator(".wv-sub").first

    def selects() -> bool:
        """The browser hears of the tool a moment after the button; until then a drag turns the camera."""
        drag(page, canvas, (0.42, 0.45), (0.55, 0.6))
        page.wait_for_timeout(500)
        return "selection" in sentence.inner_text()

    eventually(selects, "a selection")
    expect(sentence).to_contain_text("Stitched surface, selection")
    info = session.snapshot.surface
    assert info is not None
    expect(sentence).not_to_contain_text(f"{number(info.cols, 0)} ×")
    press(page, "Measure the selection")
    title_is(page, "Flatness")
