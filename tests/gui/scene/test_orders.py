"""Orders of pictures: one that is lost with the painter's process is made by the process that takes its place."""

from __future__ import annotations

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from wafer_viewer.gui.scene.reconciler import BakeCache, NotReady, RenderQueue, SceneItem
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey

REQUEST = RenderRequest(SurfaceKey(Path("x"), "default", 5, 1), "points")


class Painter:
    """Every answer is a future that the test completes."""

    def __init__(self) -> None:
        self.futures: list[Future[bytes]] = []

    def paint(self, request: RenderRequest) -> Future[bytes]:
        self.futures.append(Future())
        return self.futures[-1]


def test_what_was_lost_with_the_painter_is_ordered_once_more():
    painter, news = Painter(), []
    orders = RenderQueue(painter.paint, lambda: news.append("arrived"))
    with pytest.raises(NotReady):
        orders.outcome(REQUEST)
    painter.futures[0].set_exception(BrokenProcessPool("died"))
    with pytest.raises(NotReady):
        orders.outcome(REQUEST)
    painter.futures[1].set_result(b"tile")
    assert orders.outcome(REQUEST).result() == b"tile"
    assert news == ["arrived", "arrived"]


def test_a_picture_that_ends_the_painter_twice_is_told():
    painter = Painter()
    orders = RenderQueue(painter.paint, lambda: None)
    for attempt in range(2):
        with pytest.raises(NotReady):
            orders.outcome(REQUEST)
        painter.futures[attempt].set_exception(BrokenProcessPool("died"))
    assert isinstance(orders.outcome(REQUEST).exception(), BrokenProcessPool)
    assert len(painter.futures) == 2


def test_what_is_baked_is_baked_once_for_all_browsers():
    baked = list[str]()

    def bake() -> bytes:
        baked.append("once")
        return bytes(1000)

    cache = BakeCache()
    items = [SceneItem("ground", ("box", True), lambda *_: None, bake=bake) for _ in range(3)]
    first, *others = [cache.data(item, bake) for item in items]
    assert all(data is first for data in others)
    assert baked == ["once"]
    cache.data(SceneItem("ground", ("box", False), lambda *_: None), bake)
    assert baked == ["once", "once"]


def test_baked_data_of_long_ago_are_given_back():
    cache = BakeCache()
    kept = [cache.data(SceneItem("ground", n, lambda *_: None), lambda: bytes(1000)) for n in range(100)]
    again = cache.data(SceneItem("ground", 0, lambda *_: None), lambda: bytes(1000))
    assert again is not kept[0]
    assert cache.data(SceneItem("ground", 99, lambda *_: None), lambda: bytes(1000)) is kept[99]
