"""What is shown is what is counted: the true session's surface, its fields and its numbers on the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.points_dataset import FIELD, points_dataset
from tests.browser.steps import go_to, title_is
from wafer_viewer.draw.numbers import number, share
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
