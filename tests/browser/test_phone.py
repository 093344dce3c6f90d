"""The page in a window as narrow as a phone: to watch a scan and to stop it; and the colours of the system."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as operator
from tests.browser.steps import eventually, title_is

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]
HIT = """element => {
  const box = element.getBoundingClientRect();
  return element.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
}"""


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("width", [390, 640])
def test_a_scan_is_watched_and_stopped_in_a_narrow_window(serve_anew: Serve, width: int):
    session = fake.FakeSession(fake.scanning())
    session.latest_frame = fake.a_frame(session.snapshot)
    page = serve_anew(session)
    title_is(page, "Plan the scan")
    page.set_viewport_size({"width": width, "height": 844})
    expect(page.locator(".wv-title", has_text="Scanning field 5, 5 of 9")).to_be_in_viewport()
    stop = page.get_by_role("button", name="Stop", exact=True)
    for seen in (stop, page.locator(".wv-pill"), page.get_by_text("Time left"), page.get_by_text("50").first):
        expect(seen).to_be_visible()
        eventually(lambda at=seen: at.evaluate(HIT), "nothing lies over what is to be seen")
    expect(page.locator(".wv-nav")).to_be_hidden()
    picture = page.locator("img[src^=blob]")
    picture.scroll_into_view_if_needed()
    box = picture.bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    stop.click()
    eventually(lambda: "stop" in [name for name, *_ in session.asked], "the rig is told to stop")


def test_the_verdict_is_read_in_a_narrow_window_and_a_wide_one_has_all_again(serve_anew: Serve):
    page = serve_anew(fake.FakeSession(operator.judged(operator.PASS)))
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator(".wv-verdict")).to_be_in_viewport()
    expect(page.locator(".wv-verdict .wv-sim")).to_be_visible()
    expect(page.get_by_text("The other steps need a window at least 700 px wide.")).to_be_visible()
    for leads_elsewhere in ("Look at the surface", "Next wafer"):
        expect(page.get_by_role("button", name=leads_elsewhere)).to_be_hidden()
    page.set_viewport_size({"width": 1366, "height": 768})
    expect(page.locator(".wv-nav")).to_be_visible()
    title_is(page, "Coupon 6 mm")
    expect(page.get_by_text("The other steps need")).to_be_hidden()


@pytest.mark.campaign
def test_the_page_has_the_colours_of_the_system_until_a_person_chooses(serve_anew: Serve):
    page = serve_anew(fake.FakeSession(dataclasses.replace(fake.planned())))
    scheme = page.locator("html")
    expect(scheme).to_have_attribute("data-mantine-color-scheme", "light")
    page.emulate_media(color_scheme="dark")
    expect(scheme).to_have_attribute("data-mantine-color-scheme", "dark")
    page.get_by_role("button", name="Light page").click()
    expect(scheme).to_have_attribute("data-mantine-color-scheme", "light")
    page.wait_for_timeout(1500)
    expect(scheme).to_have_attribute("data-mantine-color-scheme", "light")
