"""From the plan to a kept step height without touching the mouse: the way of test_main_job once more, by keys alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.steps import HAND_MS, eventually, notes, numbers, title_is
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.campaign,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
SCAN_S, WORK_S = 180, 240
MOST_TABS = 90
"""More than there are things to be reached on a page."""


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers")
    yield opened
    opened.close()


def test_plan_scan_surface_and_a_kept_step_height(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    by_name(page, "Plan a scan")
    eventually(lambda: session.snapshot.draft.job is not None, "there is a plan")
    fill(page, "Columns, rows", 2, 1)
    fill(page, "Centre, µm", 800, 560)
    fill(page, "From, to, µm", -6, 53)
    fill(page, "Step, µm", 1)
    eventually(lambda: session.snapshot.draft.job.sweep.n_frames == 60, "the form was taken over")
    page.keyboard.press("Escape")
    page.keyboard.press("g")
    session.wait_until(lambda now: now.scan is not None and now.scan.finished, SCAN_S)
    session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    page.keyboard.press("Shift+S")
    title_is(page, "Surface")
    page.keyboard.press("k")
    title_is(page, "Step height")
    expect(page.locator(".wv-answer")).to_contain_text("µm")
    page.keyboard.press("Control+Enter")
    eventually(lambda: len(session.snapshot.findings) == 1, "the step is kept")
    page.keyboard.press("Control+z")
    eventually(lambda: session.snapshot.findings == (), "it is taken back")
    page.keyboard.press("Control+Shift+Z")
    eventually(lambda: len(session.snapshot.findings) == 1, "it is there again")
    page.keyboard.press("Shift+R")
    page.keyboard.press("y")
    eventually(lambda: session.snapshot.notebook.book.judgements != (), "it is judged")
    assert notes(page).count() == 0


def by_name(page: Page, verb: str) -> None:
    """Do something by its name in the command palette."""
    page.keyboard.press("Control+k")
    page.get_by_placeholder("Search commands...").press_sequentially(verb)
    page.keyboard.press("Enter")


def fill(page: Page, label: str, *values: float) -> None:
    """Reach the fields of a row with the tab key and type numbers into them."""
    for k, value in enumerate(values):
        tab_to(page, numbers(page, label).nth(k))
        page.keyboard.press("Control+a")
        page.keyboard.type(f"{value:g}")
        page.wait_for_timeout(HAND_MS)


def tab_to(page: Page, field: Locator) -> None:
    """Press tab until a field has the focus, and see that the focus is drawn."""
    for _ in range(MOST_TABS):
        if field.evaluate("field => field === document.activeElement"):
            return
        page.keyboard.press("Tab")
    raise AssertionError("the tab key does not come to this field")
