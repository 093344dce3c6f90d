"""How much is on its way to a browser: as much as it takes, nothing to one that does not answer."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future

import pytest

from tests.support.stage_props import RecordingScene
from wafer_viewer.gui.scene.reconciler import FIRST_BYTES, SceneItem, SceneReconciler, SendWindow, TileExtent
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey

SOURCE = SurfaceKey(None, "", 0, 1)  # type: ignore[arg-type]


class Browser:
    """Answers fences when it is let."""

    def __init__(self) -> None:
        self.answers = threading.Semaphore(0)
        self.asked, self.opened = threading.Semaphore(0), threading.Semaphore(0)
        self.gone = False

    def fence(self) -> None:
        self.asked.release()
        self.answers.acquire(timeout=20)
        if self.gone:
            raise RuntimeError("The browser has gone.")


@pytest.fixture
def browser() -> Browser:
    return Browser()


@pytest.fixture
def gate(browser: Browser) -> Iterator[SendWindow]:
    made = SendWindow(browser.fence, browser.opened.release)
    yield made
    browser.gone = True
    browser.answers.release()
    made.close()


def test_a_browser_that_does_not_answer_gets_no_more_and_goes_on_when_it_is_back(
    gate: SendWindow, browser: Browser
) -> None:
    gate.sent(FIRST_BYTES // 2)
    assert gate.has_room
    assert browser.asked.acquire(timeout=20)
    gate.sent(FIRST_BYTES // 2)
    assert not gate.has_room
    browser.answers.release()
    assert browser.opened.acquire(timeout=20)
    assert gate.has_room


def test_a_slow_browser_is_sent_less_at_a_time(browser: Browser) -> None:
    times = itertools.chain([0.0, 8.0], itertools.repeat(8.0))
    gate = SendWindow(browser.fence, browser.opened.release, lambda: next(times))
    gate.sent(FIRST_BYTES)
    browser.answers.release()
    assert browser.opened.acquire(timeout=20)
    gate.sent(FIRST_BYTES // 2)
    assert not gate.has_room
    browser.gone = True
    browser.answers.release()
    gate.close()


def tile(name: str, rows: tuple[int, int], cols: tuple[int, int], k: int) -> SceneItem:
    request = RenderRequest(SOURCE, "tile", k=k)
    return SceneItem(name, request, lambda s, n, d: s.add_glb(n, d), request, cover=TileExtent("surface", rows, cols))


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[int, Future[bytes]]], SceneReconciler]:
    monkeypatch.setattr("wafer_viewer.gui.scene.reconciler._GRACE_S", 0.0)
    return lambda made: SceneReconciler(RecordingScene(), lambda r: made.setdefault(r.k, Future()), lambda: None)  # type: ignore


def test_a_tile_leaves_when_others_cover_it_and_not_before(
    stage: Callable[[dict[int, Future[bytes]]], SceneReconciler],
) -> None:
    made: dict[int, Future[bytes]] = {}
    stands = stage(made)
    coarse = [tile("left", (0, 8), (0, 8), 1), tile("right", (0, 8), (8, 16), 2)]
    stands.show(coarse, 1.0)
    for k in (1, 2):
        made[k].set_result(b"glTF")
    stands.show(coarse, 1.0)
    fine = [tile(f"fine{n}", (4 * (n // 2), 4 * (n // 2) + 4), (4 * (n % 2), 4 * (n % 2) + 4), 3 + n) for n in range(4)]
    wanted = [*fine, tile("far", (0, 8), (8, 12), 7), tile("farther", (0, 8), (12, 16), 8)]
    assert not stands.show(wanted, 1.0)
    for k in (3, 4, 5):
        made[k].set_result(b"glTF")
    stands.show(wanted, 1.0)
    assert {"left", "right"} <= set(stands.names)
    made[6].set_result(b"glTF")
    stands.show(wanted, 1.0)
    assert "left" not in stands.names
    assert "right" in stands.names


def test_nothing_is_drawn_that_a_full_browser_would_have_to_wait_for(browser: Browser, gate: SendWindow) -> None:
    made: dict[int, Future[bytes]] = {}
    stands = SceneReconciler(RecordingScene(), lambda r: made.setdefault(r.k, Future()), lambda: None, gate)  # type: ignore
    items = [tile("a", (0, 1), (0, 1), 1), tile("b", (0, 1), (1, 2), 2)]
    stands.show(items, 1.0)
    made[1].set_result(b"g" * FIRST_BYTES)
    made[2].set_result(b"g")
    assert not stands.show(items, 1.0)
    assert stands.names == ("a",)
    browser.answers.release()
    assert browser.opened.acquire(timeout=20)
    assert stands.show(items, 1.0)
    assert stands.names == ("a", "b")
