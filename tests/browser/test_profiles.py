"""Profiles as an operator cuts, reads, compares and writes them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.steps import eventually, numbers, press, put, set_numbers

pytestmark = [pytest.mark.browser, pytest.mark.slow]


ROW_OF_HOLE = 398
"""A row through what is not measured in the die."""


@pytest.fixture
def cutting(serve: Callable[[MeasuringSession], Page]) -> Page:
    """A page whose first line lies on the surface."""
    page = serve(MeasuringSession())
    page.get_by_role("button", name="Measure", exact=True).first.click()
    page.locator("[data-pick=tool][data-k=profile]").first.click()
    expect(curve(page, "A")).to_have_count(1)
    return page


def curve(page: Page, name: str) -> Locator:
    return page.locator(f'path[data-curve="{name}"]')


def head(page: Page) -> Locator:
    return page.locator(".wv-lines")


def written(page: Page, kind: str) -> bytes:
    with page.expect_download() as download:
        press(page, f"Profiles as {kind}")
    assert download.value.suggested_filename.endswith(f"-profiles.{kind.lower()}")
    return Path(download.value.path()).read_bytes()


def columns(text: str) -> dict[str, list[float]]:
    rows = list(csv.reader(line for line in text.splitlines() if not line.startswith("#")))
    return {name: [float(v) for v in column if v] for name, *column in zip(*rows, strict=True)}


def test_lines_are_cut_read_compared_and_written(cutting: Page):
    page = cutting
    press(page, "Add line")
    expect(curve(page, "B")).to_have_count(1)
    expect(head(page).get_by_label("Line B")).to_have_attribute("aria-pressed", "true")

    press(page, "Horizontal cut")
    expect(head(page)).to_contain_text(re.compile(r"336.µm long"))  # a person waits for the curve, too
    row = numbers(page, "Row").first
    put(page, row, "200")
    expect(page.get_by_text("Rows 0 to")).to_be_visible()
    set_numbers(page, "Cursors, µm", 20, 120)
    expect(head(page)).to_contain_text(re.compile(r"Δx 100\.\d"))

    page.get_by_label("Compare with").click()
    page.get_by_role("option", name="measured and filtered heights").click()
    expect(curve(page, "B+")).to_have_count(1)
    expect(head(page)).to_contain_text("filled heights")

    text = written(page, "CSV").decode()
    table = columns(text)
    assert {name.rpartition(" ")[0] for name in table} == {"A", "B", "B filtered and filled heights"}
    assert len(set(table["B y_um"])) == 1
    assert text.startswith("# Wafer Viewer")
    assert "levelled by stage" in text
    assert Image.open(io.BytesIO(written(page, "PNG"))).size[0] > 1900

    head(page).get_by_label("Line A").click()
    expect(curve(page, "A+")).to_have_count(1)
    press(page, "Remove line")
    expect(curve(page, "B")).to_have_count(0)
    expect(page.get_by_role("button", name="Remove line", exact=True)).to_be_disabled()


@pytest.mark.campaign
def test_the_plot_is_read_and_looked_into_by_hand(cutting: Page):
    page = cutting
    area = page.locator(".wv-zoom")
    box = area.bounding_box()
    whole = curve(page, "A").get_attribute("d")

    area.click(position={"x": box["width"] * 0.25, "y": 40})
    expect(page.locator("path.wv-cursor").first).not_to_have_attribute("d", re.compile("^M0 "))
    stands = page.locator("path.wv-cursor").first.get_attribute("d")
    slider = page.get_by_label("Cursor 1, µm")
    expect(slider).not_to_have_value("0")
    slider.press("ArrowRight")
    slider.press("ArrowRight")
    expect(page.locator("path.wv-cursor").first).not_to_have_attribute("d", stands)

    page.mouse.move(box["x"] + box["width"] * 0.3, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.4, box["y"] + 50, steps=4)
    area.evaluate("area => area.replaceWith(area.cloneNode(true))")  # as when the plot is drawn anew meanwhile
    page.mouse.move(box["x"] + box["width"] * 0.6, box["y"] + 50, steps=4)
    page.mouse.up()
    expect(page.get_by_text("Whole line")).to_be_visible()
    expect(curve(page, "A")).not_to_have_attribute("d", whole)
    page.get_by_text("Whole line").click()
    expect(curve(page, "A")).to_have_attribute("d", whole)


@pytest.mark.campaign
def test_lines_come_back_after_a_reload(cutting: Page):
    page = cutting
    page.keyboard.press("Shift+V")
    page.keyboard.press("Shift+L")
    expect(curve(page, "B")).to_have_count(1)
    page.reload()
    expect(curve(page, "B")).to_have_count(1)
    expect(head(page).get_by_label("Line B")).to_have_attribute("aria-pressed", "true")


@pytest.mark.campaign
def test_a_cursor_stands_where_it_reads_beside_a_gap(cutting: Page):
    """Fields, grips, lines and the numbers say one distance: that of the nearest measured point."""
    page = cutting
    put(page, numbers(page, "Row").first, str(ROW_OF_HOLE))
    expect(head(page)).to_contain_text(re.compile(r"336.µm long"))
    wanted_um = 125.0  # in the hole, which begins at about 116 um
    set_numbers(page, "Cursors, µm", 20, wanted_um)
    grips = page.locator(".wv-slide")
    expect(grips).to_have_count(2)
    eventually(lambda: 112 < float(grips.nth(1).input_value()) < 119, "the grip at the edge of the hole")
    fields = numbers(page, "Cursors, µm")
    eventually(lambda: float(fields.nth(1).input_value()) < 119, "the field as the grip")
    first, second = (float(fields.nth(k).input_value()) for k in (0, 1))
    assert second == pytest.approx(float(grips.nth(1).input_value()), abs=0.051)
    shown = re.search(r"Δx (\S+)", head(page).inner_text().replace("\n", " "))
    assert shown is not None
    assert float(shown[1]) == pytest.approx(second - first, abs=0.101)
    across = page.locator("path.wv-cursor").nth(1).get_attribute("d")
    assert across is not None
    assert float(across.removeprefix("M").split()[0]) / 8000 * 336.0 == pytest.approx(second, abs=0.3)


@pytest.mark.campaign
def test_keys_take_a_cursor_over_a_gap(cutting: Page):
    page = cutting
    put(page, numbers(page, "Row").first, str(ROW_OF_HOLE))
    expect(head(page)).to_contain_text(re.compile(r"336.µm long"))
    set_numbers(page, "Cursors, µm", 20, 125.0)
    grip = page.locator(".wv-slide").nth(1)
    eventually(lambda: 112 < float(grip.input_value()) < 119, "the grip at the edge of the hole")
    grip.press("ArrowRight")
    eventually(lambda: 138 < float(grip.input_value()) < 144, "the grip beyond the hole")
    expect(grip).to_be_focused()
    grip.press("ArrowLeft")
    eventually(lambda: 112 < float(grip.input_value()) < 119, "the grip before the hole")
