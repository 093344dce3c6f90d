"""Stop as an operator presses it: on a rig that lives in real time, and on a session that stands still."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import eventually, notes
from wafer_viewer.model.errors import MotionStopped
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
READY_S = 180
ENDS_UM = -9_900.0, 9_900.0


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers", RigConfig(real_time=True))
    yield opened
    opened.close()


def stop_button(page: Page):
    return page.get_by_role("button", name="Stop", exact=True)


@pytest.mark.campaign
def test_stop_breaks_off_a_move_and_the_next_one_works(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, READY_S)
    session.take_tour().result(READY_S)
    field = page.get_by_role("button", name=re.compile(r"^Field 1,"))
    field.wait_for()
    expect(stop_button(page)).to_be_disabled()
    ways = [session.move_to(z_um=ENDS_UM[k % 2]) for k in range(5)]  # one alone is too short for a busy machine
    field.click()
    expect(page.locator(".wv-strip")).to_contain_text("moving")
    expect(stop_button(page)).to_be_enabled()
    stop_button(page).click()
    expect(page.get_by_text(re.compile(r"The move was stopped at X .*, Y .*, Z .* mm\."))).to_be_visible()
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert any(isinstance(way.exception(READY_S), MotionStopped) for way in ways)
    expect(page.locator(".wv-strip")).to_contain_text("at rest")
    expect(stop_button(page)).to_be_disabled()
    stood = session.snapshot.rig
    assert ENDS_UM[0] < stood.z_um < ENDS_UM[1]
    expect(page.locator(".wv-where")).to_contain_text(f"{abs(stood.z_um) / 1000:.4f}")
    assert notes(page).count() == 0
    field.click()
    eventually(lambda: session.snapshot.rig.x_um != stood.x_um, "the stage is at the field")
    assert session.snapshot.rig.z_um == pytest.approx(stood.z_um, abs=1e-3)


def test_a_scan_is_halted_at_once_continued_and_ended(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, READY_S)
    session.take_tour().result(READY_S)
    session.start_scan("halted").result(READY_S)
    session.wait_until(lambda now: now.scan is not None and now.scan.frames_done > 5, READY_S)
    stop_button(page).click()
    session.wait_until(lambda now: now.rig.state == "ready", READY_S)
    assert not session.snapshot.dataset.finished
    question = page.get_by_role("dialog")
    question.get_by_role("button", name="Continue the scan").click()
    expect(question).to_have_count(0)
    session.wait_until(lambda now: now.rig.state == "scanning", READY_S)
    page.keyboard.press("Shift+Escape")
    question.get_by_role("button", name="End the scan").click()
    expect(question).to_have_count(0)
    session.wait_until(lambda now: now.rig.state == "ready", READY_S)
    expect(stop_button(page)).to_be_disabled()
    assert notes(page).count() == 0


class MovingSession(fake.FakeSession):
    """Its stage is on its way until it is stopped."""

    def __init__(self) -> None:
        super().__init__(dataclasses.replace(fake.planned(), rig=dataclasses.replace(fake.RIG, state="moving")))

    def stop(self) -> Future[bool]:
        answer: Future[bool] = Future()
        answer.set_result(self.snapshot.rig.state == "moving")
        self.change(rig=fake.RIG)
        return answer


def test_a_watcher_may_stop_is_told_where_it_stands_and_that_nothing_moves_any_more(
    serve: Callable[[fake.FakeSession], Page], look_at: Callable[[str], Page]
):
    watcher = look_at(serve(MovingSession()).url)
    expect(stop_button(watcher)).to_have_css("color", "rgb(180, 35, 24)")
    stop_button(watcher).click()
    expect(watcher.get_by_text("The stage stands at X −0.3120, Y +0.1450, Z +2.0431 mm.")).to_be_visible()
    expect(stop_button(watcher)).to_be_disabled()
    watcher.keyboard.press("Shift+Escape")
    expect(watcher.get_by_text("Nothing moves.")).to_be_visible()
