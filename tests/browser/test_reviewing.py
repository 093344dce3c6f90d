"""Defects reviewed by keyboard alone: on, back, real or not, the class, a note, and taken back."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions.inspected_session import InspectedSession, inspected_session
from tests.browser.steps import eventually, notes, title_is, type_into

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]


def defect(session: InspectedSession, number: int):
    return session.snapshot.inspection.defect(number)


def test_defects_are_gone_through_judged_and_classed_without_the_mouse(serve: Callable[..., Page]):
    session = inspected_session()
    page = serve(session)
    page.keyboard.press("Shift+R")
    title_is(page, "D5 · Scratch")
    expect(page.locator(".wv-over-picture img")).to_have_count(3)
    page.keyboard.press("PageDown")
    title_is(page, "D2 · Residue")
    expect(page.locator(".wv-below .wv-curve")).to_have_count(2)
    expect(page.locator(".wv-defects tr.sel")).to_contain_text("D2")
    page.keyboard.press("6")
    eventually(lambda: defect(session, 2).judged_kind == "pit", "it is a pit")
    assert defect(session, 2).judgement == "real"
    title_is(page, "D6 · Edge chip")
    page.keyboard.press("Control+z")
    title_is(page, "D2 · Residue")
    assert defect(session, 2).judgement == "open"
    page.keyboard.press("n")
    eventually(lambda: defect(session, 2).judgement == "nuisance", "it is none")
    title_is(page, "D6 · Edge chip")
    page.keyboard.press("PageUp")
    title_is(page, "D2 · Residue")
    expect(page.locator(".wv-judging")).to_contain_text("not a defect")
    page.locator("[data-pick=review-reopen]").press("Enter")
    eventually(lambda: defect(session, 2).judgement == "open", "it is open again")
    title_is(page, "D2 · Residue")
    page.keyboard.press("Shift+Enter")
    dialog = page.locator(".mantine-Modal-content")
    expect(dialog.locator("input")).to_be_visible()
    dialog.locator("input").focus()
    page.keyboard.type("dust")
    page.wait_for_timeout(200)
    page.keyboard.press("Enter")
    eventually(lambda: any(d.note == "dust" for d in session.snapshot.inspection.defects), "it is noted down")
    assert notes(page).count() == 0


def test_all_of_a_class_are_judged_at_once_and_taken_back_at_once(serve: Callable[..., Page]):
    session = inspected_session()
    page = serve(session)
    page.keyboard.press("Shift+R")
    page.locator("[data-pick=defect-kind][data-k=particle]").click()
    title_is(page, "D1 · Particle")
    expect(page.locator(".wv-judging")).to_contain_text("Shift + key: 2 open particle")
    page.keyboard.press("Shift+Digit3")
    eventually(lambda: {defect(session, n).judged_kind for n in (1, 4)} == {"residue"}, "both are residue")
    assert {defect(session, n).judgement for n in (1, 4)} == {"real"}
    page.keyboard.press("Control+z")
    eventually(lambda: {defect(session, n).judgement for n in (1, 4)} == {"open"}, "both are taken back")
    title_is(page, "D1 · Particle")


@pytest.mark.campaign
def test_several_are_selected_in_the_gallery_and_judged_with_one_key(serve: Callable[..., Page]):
    session = inspected_session()
    page = serve(session)
    page.keyboard.press("Shift+R")
    title_is(page, "D5 · Scratch")
    page.keyboard.press("z")
    tiles = page.locator("[data-pick=tile]")
    expect(tiles).to_have_count(8)
    expect(tiles.locator("img")).to_have_count(8)
    tiles.nth(2).click(modifiers=["Control"])
    tiles.nth(4).click(modifiers=["Control"])
    expect(page.locator(".wv-tile.marked")).to_have_count(3)
    tiles.nth(4).click(modifiers=["Control"])
    expect(page.locator(".wv-tile.marked")).to_have_count(2)
    expect(page.locator(".wv-judging")).to_contain_text("Shift + key: 2 selected")
    page.keyboard.press("Shift+N")
    eventually(lambda: [defect(session, n).judgement for n in (5, 6)] == ["nuisance"] * 2, "both are none")
    expect(page.locator(".wv-tile.marked")).to_have_count(0)
    assert sum(d.judgement != "open" for d in session.snapshot.inspection.defects) == 2
    tiles.nth(3).click()
    title_is(page, "D1 · Particle")
    page.keyboard.press("Escape")
    expect(tiles).to_have_count(0)
    expect(page.locator(".wv-over-picture img")).to_have_count(3)


@pytest.mark.campaign
def test_a_filter_by_size_lists_what_is_as_large(serve: Callable[..., Page]):
    page = serve(inspected_session())
    page.keyboard.press("Shift+R")
    page.locator("[data-pick=defect-filter]").click()
    type_into(page, "Size ≤, µm", "22")
    expect(page.locator(".wv-alone")).to_contain_text("size ≤, µm 22 alone")
    expect(page.locator(".wv-defects tr")).to_have_count(3)
    title_is(page, "D7 · Pattern")
    page.locator("[data-pick=defect-all]").click()
    expect(page.locator(".wv-alone")).to_have_count(0)
    expect(page.locator(".wv-over-head")).to_contain_text("of 8")


@pytest.mark.campaign
def test_a_die_of_the_map_and_a_class_of_the_chart_are_listed_alone_by_a_click(serve: Callable[..., Page]):
    page = serve(inspected_session())
    page.keyboard.press("Shift+R")
    title_is(page, "D5 · Scratch")
    page.locator(".wv-map [data-die='2,0']").click()
    expect(page.locator(".wv-alone")).to_contain_text("Die 2,0 (clean) alone")
    page.locator(".wv-map [data-die='1,-1']").click(position={"x": 4, "y": 4})
    title_is(page, "D6 · Edge chip")
    expect(page.locator(".wv-defects tr")).to_have_count(1)
    page.locator(".wv-alone [data-pick=defect-all]").click()
    expect(page.locator(".wv-alone")).to_have_count(0)
    page.locator("[data-pick=defect-kind][data-k=pit]").click()
    title_is(page, "D3 · Pit")
    page.locator(".wv-map [data-d='defect 3']").click()
    expect(page.locator(".wv-alone")).to_contain_text("Pit alone")


def test_a_surface_that_was_not_inspected_says_what_to_do(serve: Callable[..., Page]):
    session = inspected_session(0)
    session.change(inspection=type(session.snapshot.inspection)())
    page = serve(session)
    page.keyboard.press("Shift+R")
    expect(page.get_by_text("Not inspected yet:")).to_be_visible()
    page.get_by_role("button", name="Inspect", exact=True).click()
    eventually(lambda: any(verb == "defects.inspect" for verb, _, _ in session.asked), "it is searched")
