"""The tour by its true buttons: from an empty folder to a report on disk that opens in the browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.steps import notes
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.campaign,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240
"""Long enough for a machine that does other things too; a free one needs a tenth of it."""
MOST_PRESSES = 24
SETTLED_MS = 400
"""Longer than the page takes to put the focus where it goes after a press."""
FOCUSED = "at => at === document.activeElement"
NOWHERE = "[document.body, null].includes(document.activeElement)"


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers")
    yield opened
    opened.close()


def note(page: Page) -> Locator:
    return page.locator(".wv-tour")


def leads(page: Page, n: int, title: str, button: str) -> None:
    """Wait until the n-th note points at a button, with its ring round it."""
    expect(note(page)).to_contain_text(f"Tour · {n} of 7", timeout=1000 * WORK_S)
    expect(note(page)).to_contain_text(title)
    expect(note(page)).to_have_attribute("data-button", button, timeout=1000 * WORK_S)
    expect(page.locator(".wv-tour-ring")).to_be_visible()


class Keyboard:
    """Keys pressed one by one and counted; after each, the focus must be on something, not on the whole page."""

    def __init__(self, page: Page) -> None:
        self._page, self.presses = page, 0

    def press(self, key: str) -> None:
        self._page.keyboard.press(key)
        self.presses += 1
        self._page.wait_for_timeout(SETTLED_MS)
        assert not self._page.evaluate(NOWHERE), f"press {self.presses}, {key}: the focus fell back to the page"

    def tab_to(self, target: Locator) -> None:
        while not target.evaluate(FOCUSED):
            assert self.presses < MOST_PRESSES, f"Tab does not come to {target}"
            self.press("Tab")

    def enter(self, target: Locator) -> None:
        """Press what the focus is on, or comes to by itself."""
        expect(target).to_be_focused()
        self.press("Enter")


def button(page: Page, name: str) -> Locator:
    return page.get_by_role("button", name=name, exact=True).last


def test_the_tour_leads_by_keyboard_from_an_empty_folder_to_a_report_that_opens(page: Page, session: Session):
    folder, keyboard = session.snapshot.data_folder, Keyboard(page)
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    keyboard.tab_to(page.locator("[data-pick=tour]"))
    keyboard.press("Enter")
    leads(page, 1, "Scan a wafer", "Start scan")
    keyboard.enter(button(page, "Start scan"))
    leads(page, 2, "Watch the surface grow", "Look at the surface")
    keyboard.enter(button(page, "Look at the surface"))
    leads(page, 3, "Turn the surface", "Measure this surface")
    keyboard.enter(button(page, "Measure this surface"))
    expect(note(page)).to_contain_text("Measure a step", timeout=1000 * WORK_S)
    keyboard.enter(page.locator("[data-pick=tool][data-k=step]"))
    expect(page.locator(".wv-answer")).to_contain_text("µm", timeout=1000 * WORK_S)
    leads(page, 4, "Measure a step", "Keep result")
    keyboard.enter(button(page, "Keep result"))
    leads(page, 5, "Find the defects", "Review")
    keyboard.enter(page.get_by_role("navigation").get_by_role("button", name="Review"))
    leads(page, 5, "Find the defects", "Inspect")
    keyboard.enter(button(page, "Inspect"))
    leads(page, 6, "Judge a defect", "Real defect")
    kinds = {defect.seen_as for defect in session.snapshot.inspection.inspection.found}
    assert kinds >= {"residue", "scratch", "particle"}
    keyboard.enter(button(page, "Real defect"))
    leads(page, 7, "Write the report", "Report")
    keyboard.enter(page.get_by_role("navigation").get_by_role("button", name="Report"))
    leads(page, 7, "Write the report", "Write report")
    keyboard.enter(button(page, "Write report"))

    card = page.get_by_role("dialog", name="Results of the tour")
    expect(card).to_contain_text("Seen, measured, reported", timeout=1000 * WORK_S)
    for words in ("9 fields", " ± ", f"{len(session.snapshot.inspection.inspection.found)} defects", "SIMULATED"):
        expect(card).to_contain_text(words)
    assert notes(page).count() == 0
    with page.context.expect_page() as opening:
        keyboard.enter(card.get_by_role("link", name="Open the report"))
    report = opening.value
    expect(report.locator("body")).to_contain_text("SIMULATED")
    for section in ("Results", "Defects", "Plan", "Checksums"):
        expect(report.get_by_role("heading", name=section)).to_be_visible()
    expect(report.locator("body")).to_contain_text(session.snapshot.findings[0].name)
    (path,) = folder.glob("*-report-1.html")
    assert report.title() in path.read_text()
    report.close()
    keyboard.tab_to(card.get_by_role("button", name="Close"))
    keyboard.press("Enter")
    expect(card).to_have_count(0)
    assert keyboard.presses <= MOST_PRESSES


def test_escape_ends_the_tour_and_a_reload_does_not(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    page.locator("[data-pick=tour]").click()
    leads(page, 1, "Scan a wafer", "Start scan")
    page.reload()
    leads(page, 1, "Scan a wafer", "Start scan")
    note(page).get_by_role("button", name="Skip").click()
    expect(note(page)).to_contain_text("Tour · 2 of 7")
    page.keyboard.press("Escape")
    expect(note(page)).to_have_count(0)
    page.reload()
    expect(page.get_by_role("button", name="Start scan")).to_be_visible()
    expect(note(page)).to_have_count(0)
