"""What the browser makes of the scene: its tone curve must not change the colours of the bar."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np
import pytest
import viser
from PIL import Image
from playwright.sync_api import Browser

from tests.gui.scenes.test_scene_view import until
from tests.support.page_stand_in import PIXEL_UM, MemoryShelf, StandIn, grid, height_map, job_and_plan, snapshot_of
from wafer_viewer.draw.colormaps import table
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.security.server import open_server
from wafer_viewer.gui.state.view_state import View

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.fixture
def stripes() -> Iterator[StandIn]:
    """Three levels side by side, from the lowest to the highest."""
    z = np.repeat(np.array([0.0, 10.0, 20.0], np.float32), 100)[None, :].repeat(300, axis=0)
    made = StandIn(MemoryShelf({0: height_map(z, PIXEL_UM, -149.5 * PIXEL_UM, 149.5 * PIXEL_UM)}))
    yield made
    made.close()


def test_colours_are_those_of_the_bar(browser: Browser, stripes: StandIn) -> None:
    job, plan = job_and_plan(grid(1, 1))
    snapshot = snapshot_of(stripes.shelf.surfaces[0], plan, job)
    view = View(step="surface", look="plan", hillshade=0.0, range_um=(0.0, 20.0))
    server, guard = open_server("127.0.0.1", 0)
    scenes: list[SceneView] = []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        scenes.append(SceneView(client, stripes))
        scenes[0].draw(snapshot, view)

    page = browser.new_page(viewport={"width": 900, "height": 700})
    page.goto(guard.address)
    until(lambda: scenes and not scenes[0].busy, 60)
    wanted = table("mako")[[0, 127, 255]].astype(int)

    def rarest_colour_px() -> int:
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        pixels = np.asarray(picture, int).reshape(-1, 3)
        return min(int((np.abs(pixels - colour).max(axis=1) <= 9).sum()) for colour in wanted)

    until(lambda: rarest_colour_px() > 0, 60)
    assert rarest_colour_px() > 2000
    page.close()
    scenes[0].close()
    server.stop()
