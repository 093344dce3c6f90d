"""Measuring as an operator does it: every tool on a surface that is seen, results kept and found again, any zero."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.steps import go_to, press, title_is, type_into
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
UNITS = {"angle": "°", "volume": "pl"}
ELSEWHERE = ("profile", "kerf", "die", "circle", "chipping", "coplanarity", "particles")
"""These are measured in tests of their own."""
KEYS = {"point": "x", "distance": "m", "step": "k", "radius": "r", "flatness": "Shift+F"}
"""The other tools are taken from the toolbar, or by their key where it has no room for them."""


@pytest.fixture
def session() -> MeasuringSession:
    return MeasuringSession()


@pytest.fixture
def page(session: MeasuringSession, serve: Callable[[MeasuringSession], Page]) -> Page:
    """The page in Measure, with the surface in sight and no tool in use."""
    shown = serve(session)
    go_to(shown, "Measure")
    title_is(shown, "Measure")
    expect(shown.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    return shown


def answer(page: Page) -> Locator:
    return page.locator(".wv-answer")


def results(page: Page) -> Locator:
    return page.locator("tr[data-pick=finding]")


def scale(page: Page) -> Locator:
    return page.locator(".wv-scale b")


def take(page: Page, tool: str) -> None:
    """Take a tool by its key or on the toolbar, and wait for its answer."""
    if tool in KEYS:
        page.keyboard.press(KEYS[tool])
    elif not TOOLS[tool].on_toolbar:
        key = TOOLS[tool].key
        page.keyboard.press(f"Shift+{key}" if TOOLS[tool].shift else key.lower())
    else:
        page.locator(".wv-tools").locator(f"[data-pick=tool][data-k={tool}]").click()
    expect(page.locator(".wv-title").first).to_contain_text(TOOLS[tool].title)
    expect(answer(page)).to_contain_text("Not kept yet")


def choose(page: Page, label: str, option: str) -> None:
    page.get_by_label(label).click()
    page.get_by_role("option", name=option, exact=True).click()


def read_from(page: Page, zero: str) -> None:
    choose(page, "Heights from", zero)


def keep(page: Page, name: str) -> None:
    n = results(page).count()
    type_into(page, "Name", name)
    press(page, "Keep result")
    expect(results(page)).to_have_count(n + 1)
    expect(answer(page)).not_to_contain_text("Not kept yet")


def test_every_tool_answers_with_its_uncertainty_and_is_kept(page: Page, session: MeasuringSession):
    for tool in (name for name in TOOLS if name not in ELSEWHERE):
        take(page, tool)
        expect(answer(page)).to_contain_text(UNITS.get(tool, "µm"))
        keep(page, f"My {tool}")
        expect(results(page).last).to_contain_text(f"My {tool}")
        expect(results(page).last.locator("img")).to_have_count(1)
    step = next(f for f in session.snapshot.findings if f.name == "My step")
    assert step.main.expanded is not None
    page.locator(f"tr[data-pick=finding][data-k='{step.number}']").click()
    expect(answer(page)).to_contain_text("expanded, k = 2")
    expect(page.locator("[data-dock-region=right]")).to_contain_text("Step at the joint")


def test_all_tools_are_offered_by_name_and_left_by_escape(page: Page):
    for tool in TOOLS.values():
        expect(page.locator(".wv-cards").get_by_role("button", name=tool.title, exact=True)).to_be_visible()
    page.locator(".wv-cards").get_by_role("button", name="Radius").click()
    title_is(page, "Radius")
    page.keyboard.press("Escape")
    title_is(page, "Measure")


@pytest.mark.campaign
def test_the_zero_is_chosen_said_and_left_with_one_click(page: Page):
    take(page, "point")
    expect(page.get_by_text("Heights are read from the stage's zero.").first).to_be_visible()
    before = answer(page).inner_text()
    for zero, said in (("Plane", "the plane of the whole surface"), ("Three points", "Drag the points 1, 2, 3.")):
        read_from(page, zero)
        expect(page.locator(".wv-zero")).to_contain_text(said)
        expect(answer(page)).not_to_have_text(before, use_inner_text=True)
    page.get_by_text("Back to the stage").click()
    expect(page.locator(".wv-zero")).to_contain_text("the stage's zero")
    expect(answer(page)).to_have_text(before, use_inner_text=True)


def test_results_are_renamed_deleted_undone_and_redone(page: Page, session: MeasuringSession):
    take(page, "flatness")
    keep(page, "Face")
    take(page, "texture")
    keep(page, "Grain")
    press(page, "Delete")
    expect(results(page)).to_have_count(1)
    page.keyboard.press("Control+z")
    expect(results(page)).to_have_count(2)
    press(page, "Redo")
    expect(results(page)).to_have_count(1)
    press(page, "Undo")
    expect(results(page).last).to_contain_text("Grain")
    assert [f.name for f in session.snapshot.findings] == ["Face", "Grain"]


@pytest.mark.campaign
def test_a_click_on_a_result_flies_there_and_takes_its_tool(page: Page):
    take(page, "angle")
    keep(page, "Bevel")
    page.keyboard.press("Escape")
    page.keyboard.press("Home")
    whole = scale(page).inner_text()
    results(page).first.click()
    expect(page.locator(".wv-title").first).to_contain_text("Angle")
    expect(answer(page)).to_contain_text("Bevel")
    expect(scale(page)).not_to_have_text(whole)


def test_a_result_of_another_surface_says_so_and_shows_it(page: Page, session: MeasuringSession):
    take(page, "flatness")
    keep(page, "Face")
    session.keep(replace(session.snapshot.findings[0], name="Of one field", show=1))
    expect(results(page).last).to_contain_text("field 1")
    results(page).last.click()
    expect(results(page).first).to_contain_text("stitched surface")
    expect(results(page).last).not_to_contain_text("field 1")


def test_where_nothing_can_be_measured_the_panel_says_why(page: Page, session: MeasuringSession):
    def refuse(*_: object) -> None:
        raise MeasureError("The region has 3 measured points: 12 um x 12 um hold at least 20.")

    session.measure = refuse  # type: ignore[method-assign]
    page.keyboard.press("r")
    expect(page.locator(".wv-empty", has_text="The region has 3 measured points: 12 µm")).to_be_visible()
    expect(page.get_by_role("button", name="Keep result")).to_be_disabled()


@pytest.mark.campaign
def test_a_reload_brings_back_the_tool_its_places_and_the_zero(page: Page):
    take(page, "radius")
    read_from(page, "Plane")
    expect(page.locator(".wv-zero")).to_contain_text("the plane of the whole surface")
    expect(page.locator(".wv-lab", has_text="from the plane of the whole surface")).to_be_visible()  # it is measured
    before = answer(page).inner_text()
    page.reload()
    expect(page.locator(".wv-title").first).to_contain_text("Radius")
    expect(page.locator(".wv-zero")).to_contain_text("the plane of the whole surface")
    expect(answer(page)).to_have_text(before, use_inner_text=True)


@pytest.mark.campaign
def test_what_is_set_of_a_tool_is_measured_with_at_once_and_stays_over_a_reload(page: Page, session: MeasuringSession):
    take(page, "volume")
    panel = page.locator("[data-dock-region=right]")
    expect(panel).to_contain_text("the plane through the region's border")
    choose(page, "Reference", "Zero of heights")
    expect(panel).to_contain_text("Above and below the zero of heights")
    page.reload()
    expect(panel).to_contain_text("Above and below the zero of heights")
    take(page, "flatness")
    expect(page.get_by_label("Reference")).to_be_hidden()


def test_what_is_known_of_a_step_is_in_its_budget_and_the_rest_is_listed(page: Page):
    take(page, "step")
    panel = page.locator("[data-dock-region=right]")
    expect(panel).to_contain_text("Not evaluated: z linearity, drift during the scan, repeatability")
    type_into(page, "Repeats s, µm", "0.05")
    expect(panel).to_contain_text("Not evaluated: z linearity, drift during the scan, temperature")
    choose(page, "Height taken", "At the joint")
    expect(panel).to_contain_text("Both faces extended to the middle between the regions.")


@pytest.mark.campaign
def test_faces_are_looked_for_and_where_there_are_none_it_says_so(page: Page, session: MeasuringSession):
    take(page, "step")
    press(page, "Find the faces")
    expect(page.locator(".wv-why", has_text="draw the two regions by hand")).to_be_visible()
    at = Region.rectangle(0, -30, 30, 0), Region.rectangle(140, -30, 160, 0)
    session.gauge.find_faces = lambda show=0: at
    press(page, "Find the faces")
    expect(page.locator(".wv-why", has_text="by hand")).to_be_hidden()
    keep(page, "Found")
    assert (session.snapshot.findings[-1].upper, session.snapshot.findings[-1].lower) == at
