"""What is typed stands in the field and reaches the session, in whatever way the field is entered."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from itertools import cycle

import msgspec
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.gauge_blocks import certificate
from tests.browser.sessions.gauge_session import TERMS, GaugeSession
from tests.browser.steps import HAND_MS, eventually, go_to, notes, numbers, put, text_field
from wafer_viewer.gui.elements.elements import PAUSE_S
from wafer_viewer.model.acquisition.plan import FocusSweep
from wafer_viewer.session.state.inspection_state import GaugeState

pytestmark = [
    pytest.mark.browser,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]
Way = Callable[[Page, Locator], None]
RANGE = "From, to, µm"
TYPED = ("-12", "-6", "-6.5", "20", "-7.25", "3.5")
"""Negative over negative, and every change of sign."""


def clicks(count: int, across: float) -> Way:
    """Return a way of clicking so many times at a fraction of the field's width; numbers stand at its right."""

    def click(page: Page, field: Locator) -> None:
        box = field.bounding_box()
        assert box is not None
        field.click(click_count=count, position={"x": box["width"] * across, "y": box["height"] / 2})

    return click


def keys(*pressed: str, across: float = 0.5) -> Way:
    """Return a way of clicking once and then pressing keys, no faster than a hand: the page moves the caret late."""

    def press(page: Page, field: Locator) -> None:
        clicks(1, across)(page, field)
        for key in pressed:
            page.wait_for_timeout(HAND_MS)
            page.keyboard.press(key)
        page.wait_for_timeout(HAND_MS)

    return press


def tab(page: Page, field: Locator) -> None:
    """Come to the field by Tab from the one before it."""
    numbers(page, "Centre, µm").last.focus()
    while not field.evaluate("at => at === document.activeElement"):
        page.keyboard.press("Tab")


WAYS: dict[str, Way] = {
    **{f"{n} clicks at {across:.0%}": clicks(n, across) for n in (2, 3) for across in (0.03, 0.5, 0.66, 0.72)},
    "Ctrl+A": keys("Control+a"),
    "End, Shift+Home": keys("End", "Shift+Home"),
    "End, Backspace": keys("End", *["Backspace"] * 6),
    "Home, Delete": keys("Home", *["Delete"] * 6),
    "Tab": tab,
}


@pytest.fixture
def session() -> fake.FakeSession:
    """Every number that is typed is a whole number of steps from the range's end, which therefore stays where it is.

    A moved end would be shown with the start of the moment before, and a machine at work shows it late.
    """
    sweep = FocusSweep(z_step_um=0.25, n_frames=355)
    job = msgspec.structs.replace(fake.a_job(), sweep=sweep)
    return fake.FakeSession(dataclasses.replace(fake.planned(), draft=fake.draft_of(job)))


def start_um(session: fake.FakeSession) -> float:
    return session.snapshot.draft.job.z_start_um


def gets(session: fake.FakeSession, number: float) -> None:
    eventually(lambda: start_um(session) == number, f"the session has {number:g}, not {start_um(session):g}", 10)


@pytest.mark.campaign
def test_a_number_typed_over_another_replaces_it(serve: Serve, session: fake.FakeSession):
    page = serve(session)
    field = numbers(page, RANGE).first
    put(page, field, "-6")
    gets(session, -6)
    for (name, way), typed in zip(WAYS.items(), cycle(TYPED), strict=False):
        page.keyboard.press("Escape")
        way(page, field)
        page.keyboard.type(typed, delay=HAND_MS)
        assert field.input_value() == typed, f"{typed} over {start_um(session):g}, by {name}"
        gets(session, float(typed))


@pytest.mark.campaign
def test_a_sign_is_what_it_reads_as(serve: Serve, session: fake.FakeSession):
    page = serve(session)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    field = numbers(page, RANGE).first

    def keyed(*pressed: str, then: str) -> str:
        keys(*pressed)(page, field)
        page.keyboard.type(then, delay=HAND_MS)
        return field.input_value()

    put(page, field, "-6")
    assert keyed("End", "Shift+ArrowLeft", then="-12") == "-12", "over the digits alone"
    assert keyed("Control+a", then="\u22127") == "-7", "the character of typography"
    assert keyed("End", then="-2") == "-72", "a sign behind a number is none"
    assert keyed("Home", then="-3") == "-372", "nor is there a second one"
    assert keyed("Control+a", then="4,5") == "4.5", "a comma is a decimal point"
    for copied, stands in (("\u22126,5 µm", "-6.5"), ("-1e-1", "-0.1"), ("-1 2.5 um", "-12.5"), ("3 mm", "-12.5")):
        page.evaluate("text => navigator.clipboard.writeText(text)", copied)
        keys("Control+a", "Control+v")(page, field)
        expect(field, copied).to_have_value(stands)
    gets(session, -12.5)


@pytest.mark.campaign
def test_a_field_left_without_a_number_shows_its_own_again(serve: Serve, session: fake.FakeSession):
    page = serve(session)
    field = numbers(page, RANGE).first
    for leave in ("Tab", "Escape"):
        keys("Control+a", "Backspace", "-", leave)(page, field)
        expect(field).to_have_value("-45")
    keys("Control+a", "Backspace")(page, field)
    text_field(page, "Lot").click()
    expect(field).to_have_value("-45")
    expect(text_field(page, "Lot")).to_be_focused()


def test_decimals_are_taken_or_refused_and_never_shifted(serve: Serve, session: fake.FakeSession):
    page = serve(session)
    step, columns = numbers(page, "Step, µm").first, numbers(page, "Columns, rows").first
    clicks(2, 0.3)(page, step)
    page.keyboard.type("0.125", delay=HAND_MS)
    eventually(lambda: session.snapshot.draft.job.sweep.z_step_um == 0.125, "an eighth is taken")
    clicks(2, 0.3)(page, columns)
    page.keyboard.type("2.5", delay=HAND_MS)
    assert columns.input_value() == "2"
    eventually(lambda: session.snapshot.draft.job.grid.cols == 2, "2 and not 25 columns")


def test_a_double_click_in_a_text_takes_the_number_with_its_sign(serve: Serve, session: fake.FakeSession):
    page = serve(session)
    field = text_field(page, "Below, above focus, µm")
    put(page, field, "-3.5, 5")
    field.dblclick(position={"x": 15, "y": 10})
    page.keyboard.type("-12", delay=HAND_MS)
    assert field.input_value() == "-12, 5"


@pytest.mark.campaign
def test_half_a_number_is_not_judged_and_tab_takes_it(serve: Callable[[GaugeSession], Page]):
    session = GaugeSession(GaugeState(certificate=certificate(), terms=TERMS))
    page = serve(session)
    go_to(page, "Gauge check")
    limit = text_field(page, "Limit, ± µm")
    limit.fill("0")
    page.wait_for_timeout(PAUSE_S * 500)
    limit.fill("0.7")
    begun_s = time.monotonic()
    limit.press("Tab")
    eventually(lambda: session.snapshot.gauge.terms.limit_um == 0.7, "the limit")
    assert time.monotonic() - begun_s < PAUSE_S
    assert notes(page).count() == 0
    put(page, limit, "0")
    expect(notes(page)).to_have_count(1)
    put(page, limit, "-3")
    expect(notes(page)).to_contain_text("is −3")
    expect(notes(page)).to_have_count(1)
    put(page, limit, "0.6")
    expect(notes(page)).to_have_count(0)
