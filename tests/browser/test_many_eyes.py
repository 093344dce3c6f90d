"""Several browsers at one session, and a browser that comes back to where it was."""

from __future__ import annotations

import dataclasses
import gc
import weakref
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.fake_session import FakeSession
from tests.browser.steps import eventually, go_to, press, put, text_field, title_is, type_into
from wafer_viewer.gui import app
from wafer_viewer.gui.app import start
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[FakeSession], Page]
WIDTHS = """() => ['left', 'right'].map(edge => Math.round(
    document.querySelector(`[data-dock-region=${edge}]`).getBoundingClientRect().width))"""


def holder(page: Page) -> None:
    expect(page.locator(".wv-strip")).to_contain_text("You hold the controls")


def asked(session: FakeSession) -> list[str]:
    return [name for name, _, _ in session.asked]


def test_one_browser_holds_the_controls_and_passes_them_on(serve: Serve, look_at: Callable[[str], Page]):
    session = FakeSession(fake.planned())
    anna = serve(session)
    holder(anna)
    ben = look_at(anna.url)
    expect(ben.get_by_role("status").first).to_contain_text("holds the controls.")
    for name in ("Start scan", "Open…", "Cover the sample"):
        expect(ben.get_by_role("button", name=name, exact=True)).to_be_disabled()
        expect(anna.get_by_role("button", name=name, exact=True)).to_be_enabled()
    expect(text_field(ben, "Lot")).to_be_disabled()

    ben.get_by_role("button", name="Ask for control").click()
    put(ben, text_field(ben, "Your name"), "Ben")
    press(ben, "Ask for control")
    question = anna.get_by_role("alertdialog", name="Ben asks for the controls")
    question.get_by_role("button", name="Keep").click()
    expect(ben.locator(".mantine-Notification-root", has_text="keeps the controls")).to_be_visible()
    expect(question).to_have_count(0)

    ben.get_by_role("button", name="Ask for control").click()
    question.get_by_role("button", name="Hand over").click()
    holder(ben)
    expect(ben.get_by_role("button", name="Start scan")).to_be_enabled()
    expect(anna.get_by_role("status").first).to_contain_text("Ben holds the controls.")
    expect(anna.get_by_role("button", name="Start scan")).to_be_disabled()
    press(ben, "Start scan")
    eventually(lambda: "start_scan" in asked(session), "the scan was started")


def test_everybody_may_look_and_stop(serve: Serve, look_at: Callable[[str], Page]):
    session = FakeSession(fake.scanning())
    watcher = look_at(serve(session).url)
    go_to(watcher, "Acquire")
    expect(watcher.get_by_role("button", name="Pause")).to_be_disabled()
    watcher.locator("[data-pick=theme]").click()
    expect(watcher.locator(".wv-title").first).to_have_css("color", "rgb(233, 238, 243)")
    watcher.get_by_role("button", name="Stop", exact=True).click()
    eventually(lambda: "stop" in asked(session), "the scan was stopped")
    expect(watcher.get_by_text("3 of 9 fields are complete; all frames are kept.")).to_be_visible()
    expect(watcher.get_by_role("dialog")).to_have_count(0)


def test_a_reload_keeps_the_controls_the_place_and_what_was_half_typed(serve: Serve, look_at: Callable[[str], Page]):
    session = FakeSession(fake.planned())
    page = serve(session)
    holder(page)
    other = look_at(page.url)
    drag_edge(page, "left", -30)
    drag_edge(page, "right", -50)
    widths = page.evaluate(WIDTHS)
    assert widths == [274, 458]
    eventually(lambda: '"right_px":454' in remembered(page, "browser"), "the widths are remembered")
    type_into(page, "Exposures, µs", "quick")
    expect(page.get_by_text("Not yet: The exposures read 'quick'")).to_be_visible()
    page.reload()
    title_is(page, "Plan the scan")
    expect(text_field(page, "Exposures, µs")).to_have_value("quick")
    expect(page.get_by_text("Not yet: The exposures read 'quick'")).to_be_visible()
    holder(page)
    eventually(lambda: page.evaluate(WIDTHS) == widths, "the panels are as wide as before")
    expect(other.get_by_role("status").first).to_contain_text("holds the controls.")


@pytest.mark.campaign
def test_a_page_whose_panels_are_folded_away_still_shows_what_must_be_in_sight(serve: Serve):
    page = serve(FakeSession(fake.scanning()))
    go_to(page, "Acquire")
    page.locator("[data-dock-region-collapse=right]").click()
    expect(page.locator(".wv-title")).to_have_count(0)
    expect(page.get_by_role("button", name="Stop", exact=True)).to_be_enabled()
    expect(page.locator(".wv-pill")).to_contain_text("SIMULATED")
    for words in ("Lot L2231 · Wafer W07", "scanning", "Calibrat", "You hold the controls"):
        expect(page.locator(".wv-strip")).to_contain_text(words)
    eventually(lambda: '"right_folded":true' in remembered(page, "browser"), "that is remembered")
    page.reload()
    expect(page.get_by_role("button", name="Stop", exact=True)).to_be_enabled()
    eventually(lambda: page.evaluate(WIDTHS)[1] < 60, "the panel is folded away as before")


@pytest.mark.campaign
def test_after_a_restart_of_the_program_the_plan_is_there_and_waits_for_a_look_at_the_sample(
    look_at: Callable[[str], Page], tmp_path
):
    first = Session(tmp_path)
    running = start(first)
    page = look_at(running.address)
    first.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, 120)
    press(page, "Plan a scan")
    eventually(lambda: first.snapshot.draft.job is not None, "there is a plan")
    type_into(page, "Lot", "L4711")
    eventually(lambda: first.snapshot.draft.job.sample.lot == "L4711", "the lot was taken over")
    type_into(page, "Exposures, µs", "quick")
    eventually(lambda: first.snapshot.draft.typed is not None, "what makes no plan is kept")
    running.stop()
    first.close()

    again = Session(tmp_path)
    running = start(again, port=urlsplit(running.address).port)
    try:
        page.goto(running.address)
        expect(text_field(page, "Lot")).to_have_value("L4711")
        expect(text_field(page, "Exposures, µs")).to_have_value("quick")
        note = page.get_by_role("status").filter(has_text="Nothing moves before you confirm the sample")
        expect(note).to_contain_text("Lot L4711")
        note.get_by_role("button", name="It is this sample").click()
        expect(note).to_have_count(0)
        assert again.snapshot.draft.confirmed
    finally:
        page.goto("about:blank")
        running.stop()
        again.close()


def drag_edge(page: Page, edge: str, by_px: int) -> None:
    box = page.locator(f"[data-dock-region-resize={edge}]").bounding_box()
    x, y = box["x"] + (box["width"] - 3 if edge == "left" else 3), box["y"] + 300
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by_px, y, steps=4)
    page.mouse.up()


def remembered(page: Page, what: str) -> str:
    return page.evaluate(f"localStorage.getItem('viser-user:wafer-viewer-{what}') || ''")


@pytest.mark.campaign
def test_what_needs_a_person_is_told_again_after_a_reload_until_it_is_dealt_with(serve: Serve):
    session = FakeSession(dataclasses.replace(fake.planned(), faults=fake.at_fault().faults))
    page = serve(session)
    session.fails_with = DatasetError("The folder is full: free some space.")
    press(page, "Cover the sample")
    told = page.locator(".mantine-Notification-root")
    expect(told.filter(has_text="The folder is full")).to_be_visible()
    page.reload()
    for words in ("Import stopped at stack_041.tif", "The folder is full"):
        expect(page.locator(".wv-note.fault", has_text=words)).to_be_visible()
        expect(told.filter(has_text=words)).to_be_visible()
    page.locator(".wv-note.fault", has_text="The folder is full").get_by_role("button", name="dismiss").click()
    expect(told.filter(has_text="The folder is full")).to_have_count(0)
    page.reload()
    expect(page.locator(".wv-note.fault", has_text="Import stopped")).to_be_visible()
    expect(page.locator(".wv-note.fault", has_text="The folder is full")).to_have_count(0)


@pytest.mark.campaign
def test_a_page_that_is_closed_leaves_nothing_behind(serve_anew: Serve, monkeypatch: pytest.MonkeyPatch):
    made: list[weakref.ref[object]] = []
    build = app.build_page

    def build_and_note(client: Any, session: Any) -> Any:
        page = build(client, session)
        made.append(weakref.ref(page))
        return page

    monkeypatch.setattr(app, "build_page", build_and_note)
    gc.disable()  # what goes is what the viewer frees itself
    try:
        page = serve_anew(FakeSession(fake.measured()))
        holder(page)
        (found,) = made
        assert found() is not None
        page.close()
        eventually(lambda: found() is None, "the page is freed")
    finally:
        gc.enable()
