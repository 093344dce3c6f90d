"""Tiles on their way to a browser that is hidden, slow, or reloaded meanwhile; a surface of 11 million points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import Future

import pytest
from playwright.sync_api import Page, expect

from tests.bench.big_mosaic import RESULT, big_dataset
from tests.browser.sessions.fake_session import FakeSession
from tests.browser.slow_line import SlowLine
from tests.browser.steps import click_the_surface, eventually, go_to
from tests.support.page_stand_in import grid, height_map, job_and_plan, snapshot_of
from wafer_viewer.gui.app import start
from wafer_viewer.gui.scene import surface_tiles
from wafer_viewer.gui.scene.reconciler import MOST_BYTES, SendWindow
from wafer_viewer.gui.scenes import scene_view
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic, Origin
from wafer_viewer.session.core.dataset_library import load_summary
from wafer_viewer.session.measurement.dataset_queries import ReadOut
from wafer_viewer.session.rendering.render_process import Painter, RenderRequest
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
SIDE_PX = 3300
TWO_MBIT = 250_000.0
SETTLED_S = 60.0
HIDE = """
window.held = [];
const draw = window.requestAnimationFrame;
window.requestAnimationFrame = then => window.held ? window.held.push(then) : draw.call(window, then);
0
"""
"""A browser does not draw a page out of sight."""
SHOW = "const due = window.held; window.held = null; due.forEach(then => window.requestAnimationFrame(then));"
HELD_BYTES, A_TILE_BYTES = 20_000, 60_000


class StoredSession(FakeSession):
    """A session that stands still, with a surface that lies on the disk and a true painter."""

    def __init__(self) -> None:
        path = big_dataset(SIDE_PX)
        job, plan = job_and_plan(grid(2, 2))
        shown = snapshot_of(height_map(Dataset.open(path).result(RESULT).mosaic().window(level=3).z_um), plan, job)
        result = Dataset.open(path).result(RESULT)
        info = load_summary(result)
        if shown.dataset is None or info is None:
            raise ValueError("There is no surface.")
        data = dataclasses.replace(shown.dataset, path=path)
        super().__init__(dataclasses.replace(shown, dataset=data, surface=dataclasses.replace(info, stamp=1)))
        self._mosaic, self._painter = result.mosaic(), Painter()

    def paint(self, request: RenderRequest) -> Future[bytes]:
        return self._painter.paint(request)

    def surface_source(self, show: int) -> Mosaic:
        return self._mosaic

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        at = self._mosaic.window(Region.rectangle(x_um, y_um, x_um, y_um))
        return ReadOut(float(at.z_um[0, 0]), float(at.confidence[0, 0]), Origin(int(at.origin[0, 0])))

    def close(self) -> None:
        self._painter.close()


class Sent:
    """Bytes of tiles that were given to viser to be sent, and whether the browsers have processed them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.n_bytes, self.n_tiles = 0, 0
        self._windows: list[SendWindow] = []
        add = surface_tiles.add_glb

        def counted(scene, name, data):
            self.n_bytes, self.n_tiles = self.n_bytes + len(data), self.n_tiles + 1
            return add(scene, name, data)

        def window(fence, arrived) -> SendWindow:
            self._windows.append(SendWindow(fence, arrived))
            return self._windows[-1]

        monkeypatch.setattr(surface_tiles, "add_glb", counted)
        monkeypatch.setattr(scene_view, "SendWindow", window)

    @property
    def processed(self) -> bool:
        """A page that is hidden before it has processed its tiles is sent no more, whatever changes."""
        return all(window.is_idle for window in self._windows)


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> Sent:
    return Sent(monkeypatch)


@pytest.fixture
def address() -> Iterator[str]:
    session = StoredSession()
    running = start(session)
    yield running.address
    running.stop()
    session.close()


@pytest.fixture
def line(address: str) -> Iterator[SlowLine]:
    made = SlowLine(address, TWO_MBIT)
    yield made
    made.close()


def at_rest(page: Page, sent: Sent) -> None:
    """Until tiles have been sent, no more follow, and those sent are processed."""
    eventually(lambda: sent.n_tiles > 0, "the first tile is sent", SETTLED_S)
    before = -1
    while before != sent.n_tiles or not sent.processed:
        before = sent.n_tiles
        page.wait_for_timeout(1500)


def zoom(page: Page, notches: int) -> None:
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    for _ in range(notches):
        page.mouse.wheel(0, -300)


@pytest.mark.campaign
def test_a_hidden_page_is_sent_no_more_until_it_is_seen_again(
    address: str, sent: Sent, look_at: Callable[[str], Page], monkeypatch: pytest.MonkeyPatch
):
    for limit in ("FIRST_BYTES", "MOST_BYTES"):
        monkeypatch.setattr(f"wafer_viewer.gui.scene.reconciler.{limit}", HELD_BYTES)
    page = look_at(address)
    go_to(page, "Surface")
    at_rest(page, sent)
    page.evaluate(HIDE)
    whole, drawn = sent.n_bytes, sent.n_tiles
    page.keyboard.press("h")  # another light: all tiles are made anew
    eventually(lambda: sent.n_tiles > drawn, "some of them are sent")
    page.wait_for_timeout(4000)
    held = sent.n_bytes - whole
    page.evaluate(SHOW)
    eventually(lambda: sent.n_bytes - whole > held, "it goes on", SETTLED_S)
    at_rest(page, sent)
    assert held <= HELD_BYTES + A_TILE_BYTES < sent.n_bytes - whole
    click_the_surface(page)
    expect(page.locator(".wv-read")).to_contain_text("confidence")


@pytest.mark.campaign
def test_over_a_slow_line_coarse_tiles_come_first_and_clicks_are_answered_between(
    line: SlowLine, sent: Sent, look_at: Callable[[str], Page]
):
    page = look_at(line.address)
    passed = line.passed
    go_to(page, "Surface")
    eventually(lambda: sent.n_tiles > 0, "there is a first picture", SETTLED_S)
    first_bytes = sent.n_bytes
    for _ in range(3):
        zoom(page, 3)
        click_the_surface(page, 40.0)
        expect(page.locator(".wv-read")).to_contain_text("confidence")
        assert sent.n_bytes - (line.passed - passed) < MOST_BYTES
    assert first_bytes < TWO_MBIT * 2
    at_rest(page, sent)


@pytest.mark.campaign
def test_a_page_reloaded_while_tiles_come_is_drawn_anew(address: str, sent: Sent, look_at: Callable[[str], Page]):
    page = look_at(address)
    go_to(page, "Surface")
    eventually(lambda: sent.n_tiles > 2, "tiles come")
    zoom(page, 5)
    drawn = sent.n_tiles
    page.reload()
    expect(page.locator(".wv-title").first).to_have_text("Surface")
    eventually(lambda: sent.n_tiles > drawn, "tiles come again", SETTLED_S)
    at_rest(page, sent)
    click_the_surface(page)
    expect(page.locator(".wv-read")).to_contain_text("confidence")
    expect(page.locator(".wv-note.fault")).to_have_count(0)
