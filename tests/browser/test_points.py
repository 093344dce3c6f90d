"""The true session's surface on the page: what is shown is counted; refused points, clip box and slab of its points."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions.points_dataset import FIELD, REFUSED_UM, points_dataset
from tests.browser.steps import (
    camera_at_rest,
    drag_at,
    eventually,
    go_to,
    numbers,
    on_screen,
    press,
    set_numbers,
    stored,
    title_is,
)
from wafer_viewer.draw.number_format import number, share
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.steps.surface.points import amount
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, HeightMap, Origin
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceStatistics
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240
FIRST_MS = 120_000
"""Until the first picture: the painter of a new session has everything to import."""


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Session, HeightMap]]:
    """A session with the dataset open and stitched, and the surface of its field 5."""
    folder: Path = tmp_path_factory.mktemp("wafers")
    field = points_dataset(folder / "pillar.wafer")
    session = Session(folder)
    session.open_dataset(folder / "pillar.wafer").result(WORK_S)
    session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    yield session, field
    session.close()


@pytest.fixture
def session(opened: tuple[Session, HeightMap]) -> Session:
    return opened[0]


def figure(page: Page, name: str) -> Locator:
    """The value beside a name in the panel."""
    return page.locator(".wv-kv > div", has_text=name).first.locator("xpath=following-sibling::div[1]")


def show(page: Page, name: str) -> None:
    page.get_by_label("Show", exact=True).click()
    page.get_by_role("option", name=name, exact=True).click()


def test_the_numbers_are_those_of_what_is_shown(page: Page, opened: tuple[Session, HeightMap]):
    session, field = opened
    info = session.snapshot.surface
    assert info is not None
    go_to(page, "Surface")
    title_is(page, "Surface")
    sentence = page.locator(".wv-sub").first
    expect(sentence).to_contain_text(f"{number(info.cols, 0)} × {number(info.rows, 0)} points")

    show(page, f"Field {FIELD}")
    rows, cols = field.shape
    expect(sentence).to_contain_text(f"Field {FIELD} · {number(cols, 0)} × {number(rows, 0)} points")
    expect(sentence).to_contain_text(f"{share(float(field.measured.mean()))} measured")
    expect(figure(page, "Highest")).to_contain_text(number(float(np.nanmax(field.z_um)), 2, signed=True))
    expect(figure(page, "no texture")).to_contain_text(share(float((field.origin == 12).mean())))

    show(page, "Stitched surface")
    expect(sentence).to_contain_text(f"{number(info.cols, 0)} × {number(info.rows, 0)} points")
    expect(figure(page, "Highest")).to_contain_text(number(info.highest_um, 2, signed=True))


def reasons(page: Page) -> dict[str, int]:
    """The legend of refused points: how many there are for each reason."""
    cells = page.locator(".wv-reasons > span, .wv-reasons > b").all_inner_texts()
    return {name: int(re.sub(r"\D", "", n)) for name, n in zip(cells[::2], cells[1::2], strict=True)}


def choose(page: Page, name: str) -> None:
    """Press one of the buttons of a choice in the panel."""
    page.get_by_role("button", name=name, exact=True).last.click()


@pytest.mark.campaign
def test_refused_points_are_drawn_by_reason_and_counted(page: Page, opened: tuple[Session, HeightMap]):
    session, field = opened
    assert field.refused is not None
    go_to(page, "Surface")
    choose(page, "Points")
    head = page.locator(".wv-points")
    expect(head).to_be_visible(timeout=FIRST_MS)
    show(page, f"Field {FIELD}")
    n_heights = int(np.isfinite(field.z_um).sum())
    expect(head).to_contain_text(f"of {amount(n_heights)} points")
    page.get_by_role("button", name="Show", exact=True).first.click()
    expect(head).to_contain_text(f"of {amount(n_heights + len(field.refused))} points")
    expect(head).to_contain_text(f"{amount(len(field.refused))} of them refused")
    codes, counts = np.unique(field.refused.reason, return_counts=True)
    expected = {ORIGIN_TITLES[Origin(code)]: n for code, n in zip(codes.tolist(), counts.tolist(), strict=True)}
    eventually(lambda: reasons(page) == expected, "the legend of this field")

    show(page, "Stitched surface")
    kept = Dataset.open(session.snapshot.dataset.path).result("default")
    fields = Dataset.open(session.snapshot.dataset.path).fields
    n_all = sum(len(kept.surface(f).refused) for f in fields)
    eventually(lambda: sum(reasons(page).values()) == n_all, "the legend of all fields")

    set_numbers(page, "Z, µm", -1e4, REFUSED_UM / 2)
    expect(head).to_contain_text("clipped")
    eventually(lambda: sum(reasons(page).values()) < n_all / 2, "refused points that are clipped")
    press(page, "Reset")
    expect(head).not_to_contain_text("clipped")
    eventually(lambda: sum(reasons(page).values()) == n_all, "all refused points again")


@pytest.mark.campaign
def test_the_clip_box_follows_its_balls_and_its_numbers(page: Page, session: Session):
    source = source_of(session.snapshot, 0)
    assert source is not None
    facts = msgspec.msgpack.decode(session.paint(RenderRequest(source, "facts")).result(WORK_S), type=SurfaceStatistics)
    go_to(page, "Surface")
    choose(page, "Points")
    head = page.locator(".wv-points")
    expect(head).to_contain_text("points", timeout=FIRST_MS)
    press(page, "Whole surface")
    left, right = (float(field.input_value()) for field in numbers(page, "X, µm").all())
    low, high = (float(field.input_value()) for field in numbers(page, "Y, µm").all())
    width = right - left
    set_numbers(page, "X, µm", left + width / 4, right - width / 4)
    set_numbers(page, "Z, µm", facts.low_um, facts.high_um)
    expect(head).to_contain_text("outside of the box")
    eventually(lambda: camera_at_rest(page), "the camera at rest")
    view = stored(page, "view")
    z0_um = facts.lowest_um - 0.02 * (facts.high_um - facts.low_um)
    middle_um = sum(view["clip"]["heights_um"]) / 2
    ball = (left + width / 4) * 1e-3, (low + high) / 2e3, (middle_um - z0_um) * 1e-3 * view["exaggeration"]
    n_out = head.inner_text()

    def is_pulled() -> bool:
        at, further = on_screen(page, ball), on_screen(page, (ball[0] + width * 1e-4, *ball[1:]))
        drag_at(page, at, (further[0] - at[0], further[1] - at[1]))
        page.wait_for_timeout(1000)
        return float(numbers(page, "X, µm").first.input_value()) > left + width / 4 + 1

    eventually(is_pulled, "the ball of the left face was dragged", 60)
    expect(head).not_to_have_text(n_out)
    x0 = float(numbers(page, "X, µm").first.input_value())
    assert x0 == pytest.approx(left + 0.35 * width, abs=0.05 * width)
    assert stored(page, "view")["clip"]["box_um"] == pytest.approx([x0, low, right - width / 4, high], abs=0.1)
    press(page, "Reset")
    expect(head).not_to_contain_text("outside of the box")


@pytest.mark.campaign
def test_a_slab_fills_the_profile_with_its_points(page: Page, session: Session):
    go_to(page, "Surface")
    choose(page, "Points")
    page.keyboard.press("l")
    title_is(page, "Profile")
    points = page.locator(".wv-slab-points")
    expect(points).to_have_count(1, timeout=FIRST_MS)
    narrow = int(points.get_attribute("data-points") or 0)
    set_numbers(page, "Width, µm", 20)
    eventually(lambda: int(points.get_attribute("data-points") or 0) > 10 * narrow, "more points in a wider slab")
    line = page.locator(".wv-line.sel")
    expect(line).to_contain_text("20.0")
    n_points = int(points.get_attribute("data-points") or 0)
    expect(page.locator(".wv-dock")).to_contain_text("running median")
    assert number(n_points, 0) in line.inner_text()
    grips = page.locator(".wv-slide")
    expect(grips).to_have_count(2)
    before = page.locator(".wv-end").inner_text()
    grips.first.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    expect(page.locator(".wv-end")).not_to_have_text(before)
    choose(page, "Pale")
    page.keyboard.press("Escape")
