"""A defect beside its reference and all dies on one, by keys alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions.inspected_session import repeating_session
from tests.browser.steps import eventually, go_to

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.mark.campaign
def test_a_defect_is_seen_beside_its_like_and_a_repeated_place_is_listed_alone_by_keys(serve: Callable[..., Page]):
    session = repeating_session()
    page = serve(session)
    go_to(page, "Review")
    selected = page.locator(".wv-defects tr.sel")
    expect(selected).to_be_visible()

    pictures, head = page.locator(".wv-over-picture img"), page.locator(".wv-over-head")
    expect(pictures).to_have_count(3)
    first = head.inner_text()
    expect(page.locator(".wv-sheet-foot")).to_contain_text("median of 9")
    page.locator("[data-pick=compared][data-k=before]").press("Enter")
    expect(page.locator(".wv-sheet-foot")).to_contain_text("coupon-06")
    page.keyboard.press("PageDown")
    expect(head).not_to_have_text(first)
    expect(pictures).to_have_count(3)

    page.keyboard.press("Backspace")
    expect(pictures).to_have_count(0)
    places = page.locator(".wv-stack-list tr")
    expect(places).to_have_count(3)
    expect(page.locator(".wv-stack image")).to_have_count(1)
    page.keyboard.press("Backspace")
    expect(places.first).to_have_class(re.compile("sel"))
    expect(page.locator(".wv-alone")).to_contain_text("17 of one place")
    expect(selected).to_contain_text("Pattern")
    page.keyboard.press("y")
    judged = session.defects.views.repeats()[0].numbers
    eventually(
        lambda: any(session.snapshot.inspection.defect(n).judgement == "real" for n in judged), "one of them is real"
    )

    page.keyboard.press("Escape")
    expect(page.locator(".wv-stack")).to_have_count(0)
    expect(pictures).to_have_count(3)
    page.keyboard.press("Escape")
    expect(page.locator(".wv-alone")).to_have_count(0)


@pytest.mark.campaign
def test_a_place_listed_alone_is_forgotten_when_its_numbers_are_of_other_defects(serve: Callable[..., Page]):
    session = repeating_session()
    page = serve(session)
    go_to(page, "Review")
    expect(page.locator(".wv-over-picture img")).to_have_count(3)
    page.keyboard.press("Backspace")
    expect(page.locator(".wv-stack-list tr")).to_have_count(3)
    page.keyboard.press("Backspace")
    expect(page.locator(".wv-alone")).to_contain_text("17 of one place")
    now = session.snapshot.inspection
    session.change(inspection=replace(now, search=now.search + 1))
    expect(page.locator(".wv-alone")).to_have_count(0)
    page.reload()
    go_to(page, "Review")
    expect(page.locator(".wv-stack-list tr")).to_have_count(3)
    expect(page.locator(".wv-alone")).to_have_count(0)
