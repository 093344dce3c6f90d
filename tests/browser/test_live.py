"""Live at the bench, on the true page: pictures, keys of the ringed pad, focus, marks, and their use for the plan."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 120


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers")
    yield opened
    opened.close()


def await_rest(session: Session) -> None:
    session.wait_until(lambda now: now.rig.state == "ready" and not now.works, WORK_S)


def until(condition, words: str) -> None:
    end = time.monotonic() + WORK_S
    while not condition():
        assert time.monotonic() < end, words
        time.sleep(0.05)


def stands(session: Session) -> bool:
    """Whether the stage stands for longer than a word of a jog lasts."""
    z_um = session.snapshot.rig.z_um
    time.sleep(1.0)
    return session.snapshot.rig.state == "ready" and session.snapshot.rig.z_um == z_um


def rate_is_beside_the_focus_bar(page: Page) -> bool:
    rate, bar = (page.locator(f".wv-live-{part}").bounding_box() for part in ("rate", "focus"))
    return rate is not None and bar is not None and rate["x"] + rate["width"] < bar["x"]


def test_an_operator_drives_by_keys_finds_the_focus_and_hands_the_marks_to_the_plan(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    page.keyboard.press("c")
    picture = page.locator("[data-floating-window]:has(.wv-live-root) img[src^=blob]")
    expect(page.locator(".wv-live-rate")).to_contain_text("frames/s")
    first = picture.get_attribute("src")
    expect(picture).not_to_have_attribute("src", first or "")

    page.get_by_text("Picture", exact=True).click()
    kept = session.snapshot.data_folder / "live-picture-1.ome.tif"
    expect(page.get_by_text(str(kept))).to_be_visible()
    assert kept.read_bytes()[:2] == b"II"

    lamp = page.get_by_label("Light, %")
    expect(lamp).to_have_value("100")
    lamp.fill("")
    positions: set[str] = set()
    session.subscribe(lambda now: positions.add(now.rig.positioners[0].reading.words))
    lamp.press_sequentially("50", delay=20)
    until(lambda: session.snapshot.rig.positioners[0].reading.words == "50.0 %", "the lamp follows its row")
    assert "5.0 %" not in positions, "half a number is no goal"
    session.live.set_positioner("lamp", 100.0).result(WORK_S)
    expect(lamp).to_have_value("100")

    exposure = page.get_by_label("Exposure, µs")
    exposures: set[float | None] = set()
    session.subscribe(lambda now: exposures.add(now.live.exposure_us))
    exposure.fill("")
    exposure.press_sequentially("120", delay=20)
    until(lambda: session.snapshot.live.exposure_us == 120.0, "the camera follows its row")
    assert not exposures & {1.0, 12.0}, "half a number is no exposure"

    page.keyboard.press("6")
    pad = page.locator(".wv-pad")
    pad.focus()
    page.keyboard.press("4")
    until(lambda: session.snapshot.rig.x_um == pytest.approx(-50.0), "a tapped key is a step, only within the pad")
    page.keyboard.press("1")
    expect(page.locator(".wv-steps")).to_contain_text("100")
    page.keyboard.press("Shift+8")
    until(lambda: session.snapshot.rig.y_um == pytest.approx(1000.0), "with Shift ten times")

    page.keyboard.down("Numpad9")
    until(lambda: session.snapshot.rig.z_um > 1.0, "a held key jogs")
    pad.blur()
    until(lambda: stands(session), "a pad that lost the focus stops the stage, though the key is down")
    page.keyboard.up("Numpad9")

    session.live.drive(x_um=0.0, y_um=0.0, z_um=10.0).result(WORK_S)
    pad.focus()
    page.keyboard.press("5")
    expect(page.get_by_text("Focus found here at z")).to_be_visible()
    page.set_viewport_size({"width": 944, "height": 768})
    until(lambda: rate_is_beside_the_focus_bar(page), "the rate is read in a narrower window too")
    page.set_viewport_size({"width": 1366, "height": 768})
    await_rest(session)
    for name in ("Corner 1 is here", "Lowest is here"):
        page.get_by_role("button", name=name).click()
    target = page.locator(".wv-live")
    box = target.bounding_box()
    assert box is not None
    target.click(position={"x": 0.75 * box["width"], "y": 0.75 * box["height"]})
    limits = session.snapshot.rig.limits
    until(lambda: session.snapshot.rig.x_um == pytest.approx(0.25 * limits.field_width_um, abs=2.0), "clicked place")
    assert session.snapshot.rig.y_um == pytest.approx(-0.25 * limits.field_height_um, abs=2.0)
    session.live.step(900.0, -700.0, 30.0).result(WORK_S)
    for name in ("Corner 2 is here", "Highest is here"):
        page.get_by_role("button", name=name).click()
    page.get_by_role("button", name="Use for the plan").click()
    expect(page.locator(".wv-title", has_text="Plan the scan")).to_be_visible()
    job = session.snapshot.draft.job
    assert job is not None
    assert job.grid is not None
    assert job.grid.width_um >= 900.0
    assert job.sweep.range_um >= 30.0
    page.keyboard.press("Control+z")
    session.wait_until(lambda now: now.draft.job is None, WORK_S)
