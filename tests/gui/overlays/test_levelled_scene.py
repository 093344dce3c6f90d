"""A surface over a zero of the operator's choice: how it is drawn, coloured and read; colours by what is in view."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.gui.scenes.test_scene_view import settled, until
from tests.support.page_stand_in import MemoryShelf, StandIn, grid, height_map, job_and_plan, snapshot_of
from tests.support.stage_props import Browser
from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.overlays.hud import Clicked, click_surface, read_out
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.ask import Answer
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.session.measurement.dataset_queries import ReadOut
from wafer_viewer.session.rendering.render_pictures import paint
from wafer_viewer.session.rendering.render_request import ColourScale, RenderRequest, SurfaceKey, SurfaceStatistics

PIXEL_UM, SIDE, TILT = 2.0, 400, 0.05
BY_PLANE = Levelling(by="plane")
PLANE = Datum(powers=((0, 0), (1, 0)), coefficients=(5.0, TILT))


def tilted() -> Any:
    """A tilted surface, 12 um higher in a square in its middle."""
    x = (np.arange(SIDE) - (SIDE - 1) / 2) * PIXEL_UM
    z = 5.0 + TILT * x[None, :] + np.zeros((SIDE, 1))
    z[150:250, 150:250] += 12.0
    z += np.random.default_rng(1).normal(0, 0.05, z.shape)
    return height_map(z, PIXEL_UM, float(x[0]), -float(x[0]))


JOB, PLAN = job_and_plan(grid(2, 2))
SNAPSHOT = snapshot_of(tilted(), PLAN, JOB)


class Levelled(StandIn):
    """Finds the same plane each time it is asked for one."""

    def datum(self, levelling: Levelling, show: int = 0) -> Datum:
        return PLANE


@pytest.fixture
def browser() -> Browser:
    return Browser()


@pytest.fixture
def scene(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> Iterator[SceneView]:
    monkeypatch.setattr("wafer_viewer.gui.scene.reconciler._GRACE_S", 0.0)
    session, faults = Levelled(MemoryShelf({0: tilted()})), list[Exception]()
    made = SceneView(browser, session, faults.append)  # pyright: ignore[reportArgumentType]
    yield made
    made.close()
    session.close()
    assert faults == []


def on_show(scene: SceneView, view: View) -> DisplayedSurface:
    """What the scene says of its colours when it has drawn a view."""
    heard: list[DisplayedSurface] = []
    scene.on_scale(lambda shown: heard.append(shown) if shown else None)
    scene.draw(SNAPSHOT, view)
    until(lambda: heard)
    settled(scene)
    return heard[-1]


@pytest.mark.slow
def test_heights_are_drawn_over_the_zero_that_was_chosen(scene: SceneView) -> None:
    by_stage = on_show(scene, View(step="surface"))
    levelled = on_show(scene, View(step="surface", levelling=BY_PLANE))
    assert by_stage.datum is None
    assert levelled.datum == PLANE
    assert (by_stage.scale.low, by_stage.scale.high) == pytest.approx((-15.0, 25.0), abs=1.0)
    assert (levelled.scale.low, levelled.scale.high) == pytest.approx((0.0, 12.0), abs=0.5)


@pytest.mark.slow
def test_colours_run_between_the_heights_that_are_in_view(browser: Browser, scene: SceneView) -> None:
    on_show(scene, View(step="surface", levelling=BY_PLANE))
    browser.camera.look_at = np.array([0.0, 0.0, 0.0])
    browser.camera.position = np.array([0.0, -0.001, 0.3])
    messages: list[tuple[float, float]] = []
    scene.range_in_view(messages.append)
    until(lambda: messages)
    assert messages[0] == pytest.approx((12.0, 12.0), abs=0.3)


@pytest.mark.slow
def test_the_camera_flies_to_a_rectangle_and_tells_what_it_sees(browser: Browser, scene: SceneView) -> None:
    assert scene.pose is None
    on_show(scene, View(step="surface"))
    scene.look_from("top")
    settled(scene)
    scene.fly_to((-50.0, 20.0, 50.0, 90.0))
    settled(scene)
    corners = np.array(scene.visible_um())
    assert corners.min(axis=0)[0] < -50 < 50 < corners.max(axis=0)[0]
    assert np.ptp(corners, axis=0).max() < 400
    pose = scene.pose
    assert pose is not None
    scene.look_from("all")
    settled(scene)
    scene.go_to(pose)
    settled(scene)
    assert np.allclose(browser.camera.position, pose.position)


@pytest.mark.slow
def test_the_wheel_nears_what_is_in_the_middle_and_does_not_go_through_it(browser: Browser, scene: SceneView) -> None:
    shown = on_show(scene, View(step="surface"))
    top_mm = shown.scene_z(5.0 + 12.0)  # of the square in the middle
    camera = browser.camera
    camera.look_at = np.array([0.0, 0.0, 0.0])
    camera.position = np.array([0.0, -0.3, 0.4])
    towards = camera.position / np.linalg.norm(camera.position)
    camera.moved[0](camera)
    until(lambda: abs(camera.look_at[2] - top_mm) < 0.1 * top_mm)
    assert np.allclose(camera.position, [0.0, -0.3, 0.4]), "what is seen stays the same"
    assert np.cross(camera.look_at - camera.position, towards) == pytest.approx(0.0, abs=1e-9)
    camera.position = camera.look_at + 1e-4 * towards  # as near as a wheel comes at once
    camera.moved[0](camera)
    settled(scene)
    assert camera.look_at[2] == pytest.approx(top_mm, rel=0.1)
    assert camera.position[2] > top_mm


@pytest.mark.slow
def test_a_print_gets_more_pixels_than_the_screen(browser: Browser, scene: SceneView) -> None:
    on_show(scene, View(step="surface"))
    before = {name.split("/")[2] for name in browser.scene.names("/surface/")}
    assert scene.settle(8 * browser.camera.image_width, 30.0)
    finest = min(int(level) for name in browser.scene.names("/surface/") if (level := name.split("/")[2]).lstrip("-"
                 ).isdigit())  # fmt: skip
    assert finest < min(int(level) for level in before if level.lstrip("-").isdigit())
    assert scene.settle(None, 30.0)


def text_of_read_out(view: View, clicked_with: View, **session: Any) -> str:
    """Text of the read-out after a click; what takes its time is over at once."""

    def ask(name: str, stamp: object, compute: Callable[[], Any], failed: str) -> Answer[Any]:
        return Answer(compute())

    page = SimpleNamespace(view=clicked_with, session=SimpleNamespace(snapshot=SNAPSHOT, **session), answers=ask)
    page.redraw = lambda: None
    here: Any = Here(page, Clicked())  # pyright: ignore[reportArgumentType]
    click_surface(here, 100.0, 30.0)
    here.view = view
    shown = read_out(here)
    return "" if shown is None else shown.elements[0].content


def test_the_read_out_is_over_the_chosen_zero_and_says_so() -> None:
    view = View(step="surface", levelling=BY_PLANE)
    read = {"read_out": lambda x, y, show: ReadOut(20.0, 0.9, Origin.MEASURED), "datum": lambda *_: PLANE}
    text = text_of_read_out(view, view, **read)
    assert "+10.00" in text
    assert "over its plane" in text
    assert text_of_read_out(dataclasses.replace(view, levelling=Levelling()), view, **read) == ""


def test_the_read_out_says_how_sure_the_height_is_where_that_is_known() -> None:
    known, unknown = ReadOut(20.0, 0.9, Origin.MEASURED, 0.125), ReadOut(20.0, 0.9, Origin.MEASURED)
    view = View(step="surface")
    shown = [text_of_read_out(view, view, read_out=lambda *_, read=read: read) for read in (known, unknown)]
    assert "+20.00 ± 0.25" in shown[0]
    assert "k = 2" in shown[0]
    assert "±" not in shown[1]


def test_a_deviation_from_the_form_leaves_what_is_no_bowl() -> None:
    x = np.linspace(-1, 1, SIDE)
    z = 30 * (x[None, :] ** 2 + 0.5 * x[:, None] ** 2) + 4 * x[None, :] * x[:, None]
    z[100:120, 100:120] += 6.0
    shelf, source = (
        MemoryShelf({0: height_map(z, PIXEL_UM, 1000.0, -500.0)}),
        SurfaceKey(SNAPSHOT.dataset.path, "", 0, 1),
    )
    facts = msgspec.msgpack.decode(paint(shelf, RenderRequest(source, "facts")), type=SurfaceStatistics)
    request = RenderRequest(source, "scale", look=DisplayStyle(colour_by="form"), light=facts.light)
    scale = msgspec.msgpack.decode(paint(shelf, request), type=ColourScale)
    assert max(abs(scale.own_low), scale.p1, -scale.p1, abs(scale.p99)) < 0.01
    flat = msgspec.msgpack.decode(
        paint(shelf, dataclasses.replace(request, look=DisplayStyle(colour_by="deviation"))), type=ColourScale
    )
    assert flat.p99 > 10
