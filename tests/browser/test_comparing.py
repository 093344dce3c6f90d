"""Two surfaces compared in the browser, with the true session: choose, compare, look at the difference and at both."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.steps import eventually, notes, press
from tests.support.compared_surfaces import a_texture
from tests.support.datasets.compared_datasets import dataset_of, two_datasets
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("data") / "wafers"
    before, _ = two_datasets(folder)
    dataset_of(folder / "other.wafer", a_texture(5), "other", "2026-01-03T08:00:00")
    opened = Session(folder)
    opened.open_dataset(before).result(WORK_S)
    yield opened
    opened.close()


@pytest.fixture
def page(session: Session, serve: Callable[[Session], Page]) -> Page:
    shown = serve(session)
    press(shown, "Surface")
    bar(shown, "Height").wait_for()
    return shown


def bar(page: Page, title: str) -> Locator:
    """The colour bar of a quantity; the one before may still be going."""
    return page.locator("[data-floating-window]", has_text=title).last


def compare_with(page: Page, name: str) -> None:
    page.locator("[data-pick=compare-new]").click()
    page.get_by_label("Compare with").click()
    page.get_by_role("option", name=name, exact=True).click()
    press(page, "Compare")


@pytest.mark.campaign
def test_choose_compare_look_and_close(page: Page, session: Session):
    compare_with(page, "after")
    left = page.locator("[data-dock-region=left]")
    expect(left).to_contain_text("Sq of difference", timeout=1000 * WORK_S)
    expect(left).to_contain_text("First: before. Second: after.")
    expect(left).to_contain_text(re.compile(r"Shift x\s*\+[56]\.\d+ ± 0\.0\d+ µm"))
    expect(bar(page, "Second − first")).to_be_visible()
    press(page, "Second")
    expect(bar(page, "Height")).to_be_visible()
    page.locator("canvas").first.focus()
    page.keyboard.press("Shift+B")
    eventually(lambda: chosen(page) == "First", "the first surface is looked at")
    press(page, "Both")
    expect(left).to_contain_text("The second stands to the right of the first")
    page.reload()
    expect(page.locator("[data-dock-region=left]")).to_contain_text("after")
    page.locator("[data-pick=compare-look]").click()
    expect(bar(page, "Second − first")).to_be_visible()
    press(page, "Close comparison")
    expect(bar(page, "Height")).to_be_visible()
    page.locator("[data-pick=compare-remove]").click()
    eventually(lambda: session.snapshot.comparisons == (), "the comparison is gone")
    assert notes(page).count() == 0


@pytest.mark.campaign
def test_surfaces_of_different_samples_are_refused_with_the_way_out(page: Page, session: Session):
    compare_with(page, "other")
    expect(notes(page)).to_contain_text("The surfaces were not compared", timeout=1000 * WORK_S)
    expect(notes(page)).to_contain_text("align by the stage")
    assert session.snapshot.comparisons == ()


def chosen(page: Page) -> str:
    """Which of the faces is marked."""
    buttons = page.get_by_role("button", name=re.compile("^(Difference|First|Second|Both)$"))
    colours = buttons.evaluate_all("bs => bs.map(b => getComputedStyle(b).backgroundColor)")
    odd = next(c for c in colours if colours.count(c) == 1)
    return buttons.nth(colours.index(odd)).inner_text()
