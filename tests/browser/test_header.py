"""The header at every width: Stop and the steps have places of their own, and say what they are and why not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import title_is
from wafer_viewer.gui.page.work_steps import STEPS, TITLES

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]
WIDTHS = 768, 800, 943, 944, 1024, 1199, 1200, 1279, 1280, 1366, 1499, 1500, 1600
NAMED_FROM_PX, ROOMY_FROM_PX, CURRENT_NAMED_FROM_PX = 1280, 1200, 944
MEASURED = """([stop, steps, others]) => {
  const at = (element, x, y) => element.contains(document.elementFromPoint(x, y));
  const r = stop.getBoundingClientRect(), wrong = [];
  for (let x = r.left + 1; x < r.right; x += 5)
    for (let y = r.top + 1; y < r.bottom; y += 5) if (!at(stop, x, y)) wrong.push(`Stop is covered at ${x}, ${y}`);
  for (const step of steps) {
    const s = step.getBoundingClientRect();
    if (step.scrollWidth > step.clientWidth) wrong.push(`${step.textContent} is cut`);
    if (!at(step, s.left + s.width / 2, s.top + s.height / 2)) wrong.push(`${step.textContent} is covered`);
  }
  for (const other of others) {
    const o = other.getBoundingClientRect();
    if (o.left < r.right && r.left < o.right) wrong.push(`${other.className} enters the place of Stop`);
  }
  return { wrong, left: r.left, width: r.width, height: r.height };
}"""

CUT = """() => {
  const foot = document.querySelector('.wv-strip > div'), box = foot.getBoundingClientRect();
  const shown = [...foot.children].filter(at => at.getBoundingClientRect().top < box.bottom && at.offsetWidth);
  const whole = at => at.getBoundingClientRect().right <= box.right + 1 && at.scrollWidth <= at.clientWidth + 1;
  return shown.filter(at => !whole(at)).map(at => at.textContent);
}"""
"""Items of the line at the foot that are neither whole nor left out."""


def scanning_over_a_surface() -> fake.FakeSession:
    """All seven steps are possible, and Stop can be pressed."""
    now = fake.measured()
    rig = dataclasses.replace(now.rig, state="scanning", name="Bench 2, the one by the window", simulated=False)
    return fake.FakeSession(dataclasses.replace(now, rig=rig))


@pytest.fixture
def page(serve: Serve) -> Page:
    return serve(scanning_over_a_surface())


def button(page: Page, name: str):
    return page.get_by_role("button", name=name, exact=True).first


@pytest.mark.campaign
def test_stop_and_every_step_can_be_hit_at_every_width(page: Page):
    for step in ("Plan", "Gauge check"):
        button(page, step).click()
        title_is(page, {"Plan": "Plan the scan"}.get(step, step))
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 768})
            stop = button(page, "Stop").element_handle()
            steps = [button(page, name).element_handle() for name in TITLES.values()]
            others = [page.locator(other).element_handle() for other in (".wv-pill", ".wv-switch", ".wv-mark > div")]
            found = page.evaluate(MEASURED, [stop, steps, others])
            assert found["wrong"] == [], width
            assert (found["width"], found["height"]) == (96, 38)
            assert found["left"] == width - (404 if width >= ROOMY_FROM_PX else 340)


@pytest.mark.campaign
def test_names_give_way_first_then_places_and_what_is_real_never(page: Page):
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 768})
        for step in STEPS:
            label = button(page, TITLES[step]).locator("b").bounding_box()
            assert (label["width"] > 20) == (
                width >= NAMED_FROM_PX or (step == "plan" and width >= CURRENT_NAMED_FROM_PX)
            ), (step, width)
        expect(page.locator(".wv-where")).to_be_visible(visible=width >= ROOMY_FROM_PX)
        expect(page.locator(".wv-xyz")).to_be_visible(visible=width < ROOMY_FROM_PX)
        expect(page.locator(".wv-pill em")).to_have_text("REAL")
        expect(page.locator(".wv-pill")).to_contain_text("scanning")
        expect(page.locator(".wv-sim")).to_be_visible()  # the dataset is simulated, though the rig is real
    expect(page.locator(".wv-xyz")).to_have_text("X −0.3120 Y +0.1450 Z +2.0431 mm")


def test_a_step_says_its_name_and_why_not_under_the_pointer_and_the_focus(serve: Serve):
    page = serve(fake.FakeSession(fake.planned()))
    page.set_viewport_size({"width": 1280, "height": 720})
    tip = page.get_by_role("tooltip", name="Measure").or_(page.locator("#wv-tip-measure"))
    expect(tip).to_be_hidden()
    button(page, "Measure").hover()
    expect(tip).to_have_text("MeasureNot yet: no dataset is open.")
    expect(tip).to_be_visible()
    page.mouse.move(640, 500)
    expect(tip).to_be_hidden()
    button(page, "Surface").focus()
    page.keyboard.press("Tab")
    expect(tip).to_be_visible()
    expect(button(page, "Measure")).to_have_accessible_description("Measure Not yet: no dataset is open.")
    expect(button(page, "Measure")).to_be_disabled()
    page.keyboard.press("Enter")
    title_is(page, "Plan the scan")
    expect(page.locator(".mantine-Notification-root", has_text="Not yet: no dataset is open.")).to_be_visible()


def test_a_done_step_has_its_tick_and_the_present_one_is_the_current_one(page: Page):
    mark = "(button, [part, pseudo]) => getComputedStyle(button.querySelector(part), pseudo).backgroundColor"
    for width, part in (
        (1270, [".wv-i", "::after"]),
        (1600, ["b", "::before"]),
    ):
        page.set_viewport_size({"width": width, "height": 768})
        assert button(page, "Surface").evaluate(mark, part) == "rgb(24, 121, 78)"
        assert button(page, "Report").evaluate(mark, part) == "rgba(0, 0, 0, 0)"
    expect(button(page, "Plan")).to_have_attribute("aria-current", "step")
    button(page, "Measure").click()
    expect(button(page, "Measure")).to_have_attribute("aria-current", "step")
    expect(button(page, "Plan")).not_to_have_attribute("aria-current", "step")


def test_the_foot_cuts_nothing_in_two_and_keeps_what_the_rig_does(page: Page):
    for width in (390, 768, 944, 1280, 1600):
        page.set_viewport_size({"width": width, "height": 768})
        assert page.evaluate(CUT) == [], width
        expect(page.locator(".wv-strip .busy")).to_be_visible()


def test_stop_is_grey_at_rest_red_in_motion_and_struck_out_without_a_rig(serve: Serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    stop, label = button(page, "Stop"), button(page, "Stop").locator("b")
    expect(stop).to_have_css("color", "rgb(92, 107, 126)")
    session.change(rig=dataclasses.replace(fake.RIG, state="moving"))
    expect(stop).to_have_css("color", "rgb(180, 35, 24)")
    expect(label).not_to_have_css("text-decoration-line", "line-through")
    session.change(rig=dataclasses.replace(fake.RIG, state="absent", message="The box does not answer."))
    expect(label).to_have_css("text-decoration-line", "line-through")
    expect(stop).to_be_disabled()


def test_a_step_that_is_pressed_by_key_keeps_the_focus(page: Page):
    steps = page.get_by_role("navigation", name="Steps of work")
    surface = steps.get_by_role("button", name="Surface")
    surface.focus()
    page.keyboard.press("Enter")
    expect(surface).to_have_attribute("aria-current", "step")
    expect(surface).to_be_focused()
    page.keyboard.press("Tab")
    expect(steps.get_by_role("button", name="Measure")).to_be_focused()
