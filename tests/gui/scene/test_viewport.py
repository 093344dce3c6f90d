"""The size of the scene in CSS pixels, whatever the browser draws it with."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from wafer_viewer.gui.scene.viewport import Viewport


@pytest.fixture
def camera() -> SimpleNamespace:
    made = SimpleNamespace(image_width=1600, image_height=1200, listeners=[])
    made.on_update = made.listeners.append
    return made


def test_the_browser_s_own_size_holds_when_the_scene_is_drawn_coarser(camera):
    viewport = Viewport(camera)
    viewport.set_size(800, 600)
    camera.image_width, camera.image_height = 1200, 900  # viser keeps up by drawing less; the scene is as large
    assert (viewport.width_px, viewport.height_px) == (800, 600)


def test_before_the_browser_reports_the_drawing_buffer_is_taken(camera):
    viewport = Viewport(camera)
    viewport.set_size(0, 0)
    assert (viewport.width_px, viewport.height_px) == (1600, 1200)


def test_listeners_hear_of_another_size_once(camera):
    viewport, heard = Viewport(camera), []
    viewport.on_change(lambda: heard.append(viewport.width_px))
    for size in ((800, 600), (800, 600), (700, 600)):
        viewport.set_size(*size)
    assert heard == [800, 700]


def test_the_last_size_is_heard_last_though_reports_come_on_several_threads(camera):
    viewport, heard, begun = Viewport(camera), [], threading.Event()
    later = threading.Thread(target=lambda: viewport.set_size(900, 600))

    def listen():
        width_px = viewport.width_px
        if not begun.is_set():  # the thread with the older size is held up
            begun.set()
            later.start()
            later.join(0.1)
        heard.append(width_px)

    viewport.on_change(listen)
    camera.listeners[0](None)
    later.join()
    assert heard == [1600, 900]
