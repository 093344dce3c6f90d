"""The scene of a browser: what is drawn for a view, where the camera stands, what the handles do."""

from __future__ import annotations

import asyncio
import dataclasses
import io
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.page_stand_in import (
    COLS,
    PIXEL_UM,
    ROWS,
    MemoryShelf,
    StandIn,
    grid,
    height_map,
    job_and_plan,
    snapshot_of,
)
from tests.support.patience import until
from tests.support.stage_props import Browser, RecordingScene
from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.scene.camera_controller import CameraController
from wafer_viewer.gui.scene.camera_presets import FOV_RAD, CameraPose, Clear, direction_of, fit
from wafer_viewer.gui.scene.reconciler import SceneItem, SceneReconciler
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scene.surface_tiles import VERTICES, cut, display_style_of
from wafer_viewer.gui.scene.viewport import Viewport
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.scenes.surface_scene import block_items
from wafer_viewer.gui.state.view_state import View, changed
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.measurement.measurements import PointHeight
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    SurfaceKey,
    SurfaceStatistics,
)
from wafer_viewer.session.state.snapshot import Snapshot

GRID = grid(2, 2)
JOB, PLAN = job_and_plan(GRID)
STEP_UM = 20.0
PATIENCE_S = 20.0
FACE = Region.rectangle(60.0, -80.0, 120.0, -20.0)


def two_levels() -> HeightMap:
    """The left half STEP_UM over the right; a hole in the upper right corner."""
    rows, cols = round(GRID.height_um / PIXEL_UM / 4), round(GRID.width_um / PIXEL_UM / 4)
    z = np.zeros((rows, cols), np.float32)
    z[:, : cols // 2] = STEP_UM
    z += np.random.default_rng(1).normal(0, 0.1, z.shape).astype(np.float32)
    z[:30, -40:] = np.nan
    pixel = 4 * PIXEL_UM
    return height_map(z, pixel, -(cols - 1) / 2 * pixel, (rows - 1) / 2 * pixel)


@pytest.fixture
def session() -> Iterator[StandIn]:
    whole = two_levels()
    half = {1: whole.crop(slice(0, 140), slice(0, 190)), 2: whole.crop(slice(0, 140), slice(150, 340))}
    made = StandIn(MemoryShelf({0: whole, **half}))
    yield made
    made.close()


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """No browser has to unpack anything here: what is replaced may leave at once."""
    monkeypatch.setattr("wafer_viewer.gui.scene.reconciler._GRACE_S", 0.0)


@pytest.fixture
def browser() -> Browser:
    return Browser()


@pytest.fixture
def faults() -> list[Exception]:
    return []


@pytest.fixture
def scene(browser: Browser, session: StandIn, faults: list[Exception]) -> Iterator[SceneView]:
    made = SceneView(browser, session, faults.append)  # pyright: ignore[reportArgumentType]
    yield made
    made.close()
    assert faults == []


SNAPSHOT = snapshot_of(two_levels(), PLAN, JOB)


def settled(scene: SceneView) -> None:
    """Until a pass has drawn all it wants and what it replaced has left."""
    until(lambda: not scene.busy)


# ---------------------------------------------------------------- what is drawn


@pytest.mark.slow
def test_a_surface_stands_as_tiles_on_a_plinth_with_figures(browser: Browser, scene: SceneView) -> None:
    scene.draw(SNAPSHOT, View(step="surface", exaggeration=5.0))
    settled(scene)
    tiles = [browser.scene.nodes[name] for name in browser.scene.names("/surface/")]
    assert len(tiles) > 2
    assert {tile.scale for tile in tiles} == {(1.0, 1.0, 5.0)}
    assert all(browser.scene.names(part) for part in ("plinth", "shadow", "hatch", "scale", "/wall-"))


@pytest.mark.slow
def test_the_same_again_asks_for_nothing(browser: Browser, session: StandIn, scene: SceneView) -> None:
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    requested, nodes = len(session.asked), set(browser.scene.nodes)
    scene.draw(dataclasses.replace(SNAPSHOT, version=2), View(step="surface"))
    settled(scene)
    assert len(session.asked) == requested
    assert set(browser.scene.nodes) == nodes


def test_another_exaggeration_stretches_what_is_there(browser: Browser, session: StandIn, scene: SceneView) -> None:
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    tiles, requested = browser.scene.names("/surface/"), len(session.asked)
    scene.draw(SNAPSHOT, View(step="surface", exaggeration=8.0))
    settled(scene)
    assert len(session.asked) == requested
    assert browser.scene.names("/surface/") == tiles
    assert all(browser.scene.nodes[name].scale == (1.0, 1.0, 8.0) for name in tiles)


def test_other_colours_replace_the_tiles_and_none_leaves_before_its_successor(
    browser: Browser, scene: SceneView
) -> None:
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    before = set(browser.scene.names("/surface/"))
    walls = {name for name in before if "/wall-" in name}
    browser.scene.log.clear()
    scene.draw(SNAPSHOT, View(step="surface", colours="batlow"))
    settled(scene)
    for at, (verb, name) in enumerate(browser.scene.log):
        item = name.rsplit("/", 1)[0]
        assert verb == "add" or any(earlier.rsplit("/", 1)[0] == item for _, earlier in browser.scene.log[:at])
    after = set(browser.scene.names("/surface/"))
    assert after & before == walls
    assert len(after) == len(before)


@pytest.mark.slow
@pytest.mark.parametrize(("look", "kind"), [("points", "point_cloud"), ("plan", "glb")])
def test_points_and_plan_have_no_walls(browser: Browser, scene: SceneView, look: str, kind: str) -> None:
    scene.draw(SNAPSHOT, View(step="surface", look=look))  # pyright: ignore[reportArgumentType]
    settled(scene)
    assert {browser.scene.nodes[name].kind for name in browser.scene.names("/surface/")} == {kind}
    assert browser.scene.names("plinth") == []


def test_the_page_hears_what_the_colours_span(browser: Browser, scene: SceneView) -> None:
    heard: list[tuple[float, float]] = []
    scene.on_scale(lambda shown: heard.append((shown.scale.low, shown.scale.high)) if shown else None)
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    scene.draw(SNAPSHOT, View(step="surface", range_um=(2.0, 9.0)))
    settled(scene)
    assert heard[0] == pytest.approx((0.0, STEP_UM), abs=0.5)
    assert heard[-1] == (2.0, 9.0)


def test_while_scanning_finished_fields_stand_and_the_others_are_dashed(browser: Browser, scene: SceneView) -> None:
    scene.draw(snapshot_of(two_levels(), PLAN, JOB, done=(1, 2)), View(step="acquire"))
    settled(scene)
    assert browser.scene.names("/field/1/")
    assert browser.scene.names("/field/2/")
    assert {name.split("/")[2] for name in browser.scene.names("/flat/")} == {"3", "4"}


def test_the_plan_shows_its_fields_and_goes_when_it_is_given_up(browser: Browser, scene: SceneView) -> None:
    planned = dataclasses.replace(Snapshot(), draft=dataclasses.replace(Snapshot().draft, job=JOB, plan=PLAN))
    scene.draw(planned, View(step="plan"))
    settled(scene)
    assert browser.scene.names("/grid/lines")
    assert len({name.split("/")[4] for name in browser.scene.names("/grid/numbers")}) == 4
    scene.draw(Snapshot(), View(step="plan"))
    settled(scene)
    assert browser.scene.names("/grid/") == []
    assert browser.scene.names("/stage/")


@pytest.mark.slow
def test_what_cannot_be_drawn_is_told_once_and_the_rest_stands(browser: Browser, session: StandIn) -> None:
    messages: list[Exception] = []
    session.shelf.stacks = lambda source: (_ for _ in ()).throw(DatasetError("The frames are gone."))  # type: ignore
    scene = SceneView(browser, session, messages.append)  # pyright: ignore[reportArgumentType]
    scene.draw(SNAPSHOT, View(step="surface", show=1, frame_k=3))
    until(lambda: messages)
    until(lambda: not scene.busy)
    assert [str(fault) for fault in messages] == ["The frames are gone."]
    assert browser.scene.names("/surface/")
    scene.close()


def test_a_stage_draws_what_is_there_and_waits_for_nothing() -> None:
    late: Future[bytes] = Future()
    arrived: list[bool] = []
    stage = SceneReconciler(RecordingScene(), lambda request: late, lambda: arrived.append(True))  # type: ignore[arg-type]
    request = RenderRequest(SurfaceKey(None, "", 0, 1), "tile")  # type: ignore[arg-type]
    items = [
        SceneItem("a", 1, lambda s, n, d: s.add_glb(n, d)),
        SceneItem("b", 1, lambda s, n, d: s.add_glb(n, d), request),
    ]
    assert not stage.show(items, 1.0)
    assert stage.names == ("a",)
    late.set_result(b"glTF")
    assert arrived == [True]
    assert stage.show(items, 1.0)
    assert stage.names == ("a", "b")


def test_orders_no_one_waits_for_are_withdrawn() -> None:
    late: list[Future[bytes]] = []

    def paint(request: RenderRequest) -> Future[bytes]:
        late.append(Future())
        return late[-1]

    stage = SceneReconciler(RecordingScene(), paint, lambda: None)  # type: ignore[arg-type]
    source = SurfaceKey(None, "", 0, 1)  # type: ignore[arg-type]
    for colours in ("mako", "batlow"):
        request = RenderRequest(source, "tile", look=DisplayStyle(colours=colours))
        stage.show([SceneItem("t", request, lambda s, n, d: s.add_glb(n, d), request)], 1.0)
    assert [future.cancelled() for future in late] == [True, False]


# ---------------------------------------------------------------- tiles and camera


@given(st.integers(50, 20_000), st.integers(50, 20_000))
def test_a_cut_stays_within_its_budget_and_covers_all(rows: int, cols: int) -> None:
    facts = SurfaceStatistics(rows, cols, 0.5, 0.0, 0.0, 0, rows, 0, cols, 0.0, 1.0, 0.0, 1.0, 1.0, (0.0, 0.0, 0.0))
    part = cut(facts, 2_200_000)
    lattice = (-(-rows // 2**part.level), -(-cols // 2**part.level))
    assert (lattice[0] - 1) * (lattice[1] - 1) <= 2_200_000
    tiles = list(part.tiles())
    assert max(r[1] for r, _ in tiles) == lattice[0]
    assert max(c[1] for _, c in tiles) == lattice[1]
    vertices = sum(-(-(r[1] - r[0]) // part.step) * -(-(c[1] - c[0]) // part.step) for r, c in tiles)
    assert vertices <= 1.25 * VERTICES


@pytest.mark.parametrize("preset", ["top", "front", "iso"])
@given(st.floats(0.1, 30), st.floats(0.1, 30), st.floats(0, 3), st.integers(500, 1800), st.integers(400, 1200))
def test_everything_is_in_sight_and_clear_of_the_glass(
    preset: str, width: float, depth: float, height: float, width_px: int, height_px: int
) -> None:
    corners = np.array([(x, y, z) for x in (0, width) for y in (0, depth) for z in (0, height)], float) + np.array(
        [4, -2, 0]
    )
    clear, fov = Clear(), 0.5
    pose = fit(corners, direction_of(preset), fov, width_px, height_px, clear)
    away = pose.direction
    right = np.cross([0, 0, 1], away)
    right /= np.linalg.norm(right)
    seen = corners - pose.position
    focal = height_px / 2 / np.tan(fov / 2)
    x = width_px / 2 + focal * (seen @ right) / -(seen @ away)
    y = height_px / 2 - focal * (seen @ np.cross(away, right)) / -(seen @ away)
    slack = 0.03 * max(width_px, height_px)
    assert x.min() >= clear.left - slack
    assert x.max() <= width_px - clear.right + slack
    assert y.min() >= clear.top - slack
    assert y.max() <= height_px - clear.bottom + slack


def test_the_camera_follows_the_canvas_until_the_operator_moves_it(browser: Browser, scene: SceneView) -> None:
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    first = browser.camera.position.copy()
    browser.camera.image_width = 500
    browser.camera.moved[0](browser.camera)
    until(lambda: not np.allclose(browser.camera.position, first))
    mine = browser.camera.position = np.array([9.0, 9.0, 9.0])
    browser.camera.image_width = 800
    scene.draw(SNAPSHOT, View(step="surface", colours="grey"))
    settled(scene)
    assert np.allclose(browser.camera.position, mine)
    scene.look_from("top")
    until(lambda: not np.allclose(browser.camera.position, mine))
    assert browser.camera.position[2] > 3 * abs(browser.camera.position[1] - browser.camera.look_at[1])


SMALL_PX, LARGE_PX = (240, 700), (540, 700)
"""Sizes of the scene beside a left panel and without it, in a window 944 px wide."""


def test_the_camera_follows_a_size_that_is_reported_after_its_own_last_report(
    browser: Browser, session: StandIn
) -> None:
    viewport = Viewport(browser.camera)  # pyright: ignore[reportArgumentType]
    viewport.set_size(*SMALL_PX)
    scene = SceneView(browser, session, viewport=viewport)  # pyright: ignore[reportArgumentType]
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    far = np.linalg.norm(browser.camera.position - browser.camera.look_at)
    viewport.set_size(*LARGE_PX)
    until(lambda: np.linalg.norm(browser.camera.position - browser.camera.look_at) < 0.7 * far)
    scene.close()


def test_a_fit_to_an_older_size_of_the_canvas_does_not_replace_the_newer(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewport = Viewport(browser.camera)  # pyright: ignore[reportArgumentType]
    viewport.set_size(*SMALL_PX)
    eye = CameraController(browser, viewport)  # pyright: ignore[reportArgumentType]
    corners = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)])
    eye.frame(corners, "top", Clear())
    fitting, go_on = threading.Event(), threading.Event()

    def slow(*args: Any) -> CameraPose:
        first, pose = not fitting.is_set(), fit(*args)
        fitting.set()
        assert not first or go_on.wait(PATIENCE_S)
        return pose

    monkeypatch.setattr("wafer_viewer.gui.scene.camera_controller.fit", slow)
    with ThreadPoolExecutor(2) as threads:
        older = threads.submit(eye.frame, corners, "top", Clear())
        assert fitting.wait(PATIENCE_S)
        viewport.set_size(*LARGE_PX)
        newer = threads.submit(eye.refit)
        wait([newer], timeout=0.2)
        go_on.set()
        older.result(PATIENCE_S)
        newer.result(PATIENCE_S)
    eye.refit()
    assert eye.pose.is_near(fit(corners, direction_of("top"), FOV_RAD, *LARGE_PX, Clear()))
    eye.close()


# ---------------------------------------------------------------- tools


def drag(browser: Browser, part: str, x_um: float, y_um: float) -> None:
    """Take hold of a handle and move the pointer over a place of the lower level."""
    node = browser.scene.nodes[browser.scene.names(part)[0]]
    event = SimpleNamespace(end_position=(x_um * 1e-3, y_um * 1e-3, 0.0), phase="update")
    asyncio.run(node.dragged[0](event))


def test_a_profile_begins_on_the_surface_and_follows_its_handles(browser: Browser, scene: SceneView) -> None:
    lines: list[Region] = []
    scene.on_lines(lambda told, line: lines.append(told[line]))
    scene.draw(SNAPSHOT, View(step="measure", tool="profile", exaggeration=1.0))
    until(lambda: lines)
    settled(scene)
    x0, _, x1, _ = lines[0].bounds_um
    assert -GRID.width_um / 2 <= x0 < 0 < x1 <= GRID.width_um / 2
    scene.look_from("top")
    settled(scene)
    drag(browser, "profile/0/1/ball", 200.0, -100.0)
    until(lambda: len(lines) > 1)
    assert (lines[-1].points[1].x_um, lines[-1].points[1].y_um) == pytest.approx((200.0, -100.0), abs=3.0)
    assert lines[-1].points[0] == lines[0].points[0]


def test_every_corner_of_a_profile_has_a_handle(browser: Browser, scene: SceneView) -> None:
    lines: list[Region] = []
    scene.on_lines(lambda told, line: lines.append(told[line]))
    bent = Region.polyline((-200, 0), (0, 80), (200, 0))
    straight = View(step="measure", tool="profile", exaggeration=1.0, lines=(Region.line(-200, 0, 200, 0),))
    scene.draw(SNAPSHOT, straight)
    settled(scene)
    scene.draw(SNAPSHOT, changed(straight, lines=(bent,)))
    scene.look_from("top")
    settled(scene)
    drag(browser, "profile/0/1/ball", 50.0, -100.0)
    until(lambda: lines)
    assert lines[-1].kind == "polyline"
    assert [(p.x_um, p.y_um) for p in lines[-1].points[::2]] == [(-200, 0), (200, 0)]
    assert (lines[-1].points[1].x_um, lines[-1].points[1].y_um) == pytest.approx((50.0, -100.0), abs=3.0)


def test_regions_begin_on_two_plateaus(browser: Browser, scene: SceneView) -> None:
    messages: list[tuple[Region, ...]] = []
    scene.on_places(messages.append)
    scene.draw(SNAPSHOT, View(step="measure", tool="step"))
    until(lambda: messages)
    upper, lower = messages[0]
    assert upper.bounds_um[2] < 0 < lower.bounds_um[0]
    settled(scene)
    scene.draw(SNAPSHOT, View(step="measure", tool="none"))
    until(lambda: not browser.scene.names("/tools/"))


def test_a_region_moves_whole_by_its_middle_and_stays_on_the_surface(browser: Browser, scene: SceneView) -> None:
    messages: list[tuple[Region, ...]] = []
    scene.on_places(messages.append)
    scene.draw(SNAPSHOT, View(step="measure", tool="step", exaggeration=1.0))
    until(lambda: messages)
    settled(scene)
    before = messages[0][1].bounds_um
    drag(browser, "place/1/whole/ball", 9e5, 0.0)
    until(lambda: len(messages) > 1)
    after = messages[-1][1].bounds_um
    assert after[2] <= GRID.width_um / 2
    assert after[2] - after[0] == pytest.approx(before[2] - before[0])
    assert messages[-1][0] == messages[0][0]


def test_a_click_moves_the_point_of_its_tool_there(browser: Browser, scene: SceneView) -> None:
    messages: list[tuple[Region, ...]] = []
    scene.on_places(messages.append)
    scene.on_pick(lambda x_um, y_um: None)
    scene.draw(SNAPSHOT, View(step="measure", tool="point", exaggeration=1.0))
    until(lambda: messages)
    settled(scene)
    browser.scene.clicked[0](SimpleNamespace(ray_origin=(0.12, -0.06, 3.0), ray_direction=(0.0, 0.0, -1.0)))
    until(lambda: len(messages) > 1)
    at = messages[-1][0].points[0]
    assert (at.x_um, at.y_um) == pytest.approx((120.0, -60.0), abs=4.0)


def test_a_place_that_heights_are_levelled_at_is_told_when_it_is_let_go(
    browser: Browser, session: StandIn, scene: SceneView
) -> None:
    session.datum = lambda levelling, show=0: Datum()  # type: ignore[attr-defined]
    messages: list[Levelling] = []
    scene.on_levelling(messages.append)
    scene.draw(SNAPSHOT, View(step="measure", exaggeration=1.0))
    settled(scene)
    scene.draw(SNAPSHOT, View(step="measure", exaggeration=1.0, levelling=Levelling(by="region", places=(FACE,))))
    until(lambda: browser.scene.names("/tools/level/"))
    settled(scene)
    node = browser.scene.nodes[browser.scene.names("level/0/whole/ball")[0]]
    for phase in ("update", "end"):
        asyncio.run(node.dragged[0](SimpleNamespace(end_position=(0.15, -0.05, 0.0), phase=phase)))
    until(lambda: messages)
    settled(scene)
    assert len(messages) == 1
    assert messages[0].by == "region"
    assert messages[0].places != (FACE,)


def test_kept_results_stand_where_they_were_measured_but_not_on_another_surface(
    browser: Browser, scene: SceneView
) -> None:
    length = Length(value_um=3.0)
    here = PointHeight(number=1, place=Region.point(-100, 20), height=length, points=9)
    elsewhere = PointHeight(number=2, show=1, place=Region.point(100, 20), height=length, points=9)
    stored = dataclasses.replace(SNAPSHOT, findings=(here, elsewhere))
    scene.draw(stored, View(step="measure"))
    until(lambda: browser.scene.names("/tools/kept/"))
    settled(scene)
    assert len(browser.scene.names("/tools/kept/sign")) == 1
    scene.draw(stored, View(step="surface"))
    until(lambda: not browser.scene.names("/tools/kept/"))


def test_a_view_that_only_echoes_a_drag_does_not_move_the_handles_back(browser: Browser, scene: SceneView) -> None:
    lines: list[Region] = []
    scene.on_lines(lambda told, line: lines.append(told[line]))
    view = View(step="measure", tool="profile", exaggeration=1.0)
    scene.draw(SNAPSHOT, view)
    until(lambda: lines)
    settled(scene)
    drag(browser, "profile/0/0/ball", -150.0, 50.0)
    until(lambda: len(lines) > 1)
    scene.draw(SNAPSHOT, dataclasses.replace(view, lines=(lines[0],)))
    settled(scene)
    drag(browser, "profile/0/1/ball", 150.0, 50.0)
    until(lambda: len(lines) > 2)
    assert lines[-1].points[0] == lines[1].points[0]
    scene.draw(SNAPSHOT, dataclasses.replace(view, lines=(Region.line(-10, -20, 30, 40),)))
    settled(scene)
    drag(browser, "profile/0/1/ball", 100.0, 50.0)
    until(lambda: len(lines) > 3)
    assert (lines[-1].points[0].x_um, lines[-1].points[0].y_um) == (-10, -20)


def test_a_click_hits_the_surface_as_it_is_drawn(browser: Browser, scene: SceneView) -> None:
    picked: list[tuple[float, float]] = []
    scene.on_pick(lambda x_um, y_um: picked.append((x_um, y_um)))
    shown: list[DisplayedSurface] = []
    scene.on_scale(lambda on_show: shown.append(on_show) if on_show else None)
    scene.draw(SNAPSHOT, View(step="surface", exaggeration=10.0))
    settled(scene)
    target = np.array([-0.1, 0.05, shown[-1].scene_z(STEP_UM)])
    for away in ((0.3, -0.4, 2.0), (-1.0, 0.2, 0.5)):
        origin = target + np.array(away)
        n = len(picked)
        event = SimpleNamespace(ray_origin=tuple(origin), ray_direction=tuple(target - origin))
        browser.scene.clicked[0](event)
        until(lambda n=n: len(picked) > n)
        assert picked[-1] == pytest.approx((-100.0, 50.0), abs=4.0)


@pytest.mark.parametrize(("colour_by", "height_um"), [("height", None), ("origin", 0.0)])
def test_a_click_into_a_hole_means_what_is_seen_there(
    browser: Browser, scene: SceneView, colour_by: str, height_um: float | None
) -> None:
    picked: list[tuple[float, float]] = []
    scene.on_pick(lambda x_um, y_um: picked.append((x_um, y_um)))
    shown: list[DisplayedSurface] = []
    scene.on_scale(lambda on_show: shown.append(on_show) if on_show else None)
    scene.draw(SNAPSHOT, View(step="surface", exaggeration=20.0, colour_by=colour_by))  # pyright: ignore[reportArgumentType]
    settled(scene)
    z = 0.0 if height_um is None else shown[-1].scene_z(height_um)
    target = np.array([GRID.width_um / 2 - 30, GRID.height_um / 2 - 25, 0]) * 1e-3 + [0, 0, z]
    origin = target + np.array([0.0, -0.4, 1.0])
    browser.scene.clicked[0](SimpleNamespace(ray_origin=tuple(origin), ray_direction=tuple(target - origin)))
    until(lambda: picked)
    assert picked[0] == pytest.approx(tuple(1e3 * target[:2]), abs=4.0)


def test_a_click_beside_the_surface_is_none(browser: Browser, scene: SceneView) -> None:
    picked: list[tuple[float, float]] = []
    scene.on_pick(lambda x_um, y_um: picked.append((x_um, y_um)))
    scene.draw(SNAPSHOT, View(step="surface"))
    settled(scene)
    for ray_x in (5.0, 0.0):
        event = SimpleNamespace(ray_origin=(ray_x, 0.0, 3.0), ray_direction=(0.0, 0.0, -1.0))
        browser.scene.clicked[0](event)
    until(lambda: picked)
    assert len(picked) == 1
    assert picked[0] == pytest.approx((0.0, 0.0), abs=0.1)


def test_fields_are_as_large_as_their_frames() -> None:
    assert GRID.field_width_um == pytest.approx(COLS * PIXEL_UM)
    assert GRID.field_height_um == pytest.approx(ROWS * PIXEL_UM)


def test_the_place_that_is_explained_is_marked_on_the_surface(browser: Browser, scene: SceneView) -> None:
    scene.draw(SNAPSHOT, View(step="surface", why=(-100.0, 50.0), exaggeration=2.0))
    until(lambda: browser.scene.names("/tools/mark/"))
    settled(scene)
    x, y, z = browser.scene.nodes[browser.scene.names("mark/rim")[0]].position
    assert (x, y) == pytest.approx((-0.1, 0.05), abs=1e-6)
    assert z > 2.0 * STEP_UM * 1e-3 * 0.9
    scene.draw(SNAPSHOT, View(step="surface", why=(100.0, 50.0), exaggeration=2.0))
    settled(scene)
    assert browser.scene.nodes[browser.scene.names("mark/rim")[0]].position[0] == pytest.approx(0.1)
    scene.draw(SNAPSHOT, View(step="surface", exaggeration=2.0))
    until(lambda: not browser.scene.names("/tools/mark/"))


def test_origins_are_drawn_in_little_light_for_their_colours_are_looked_up():
    scale = ColourScale("origin", 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, ())
    shades = [display_style_of(View(colour_by=by, hillshade=0.8), scale).hillshade for by in ("height", "origin")]
    assert shades == pytest.approx([0.8, 0.2])


@pytest.mark.slow
@pytest.mark.parametrize("plinth", [True, False])
def test_the_shadow_lies_below_the_hatch_and_that_below_the_surface(plinth):
    import trimesh

    stage = RecordingScene()
    for item in block_items((0.0, 0.0, 2.0, 1.0), False, plinth=plinth):
        item.make(stage, item.name, b"" if item.bake is None else item.bake())
    shadow, hatch = (
        trimesh.load(io.BytesIO(stage.nodes[name].args[0]), file_type="glb").bounds[1, 2]
        for name in ("ground/shadow", "ground/hatch")
    )
    assert shadow < 2 * hatch + 1e-6 < 0


@pytest.mark.slow
def test_the_hatch_lies_under_points_only_where_nothing_was_measured():
    import trimesh

    measured = np.ones((10, 20), np.bool_)
    measured[:3, 15:] = False
    heights = CoarseHeightField(10, 20, 100.0, 50.0, 950.0, np.zeros((10, 20), "<f4").tobytes(), measured.tobytes())

    def picture(under: CoarseHeightField | None) -> np.ndarray:
        items = block_items((0.0, 0.0, 2.0, 1.0), False, plinth=False, under_points=under)
        (hatch,) = (item for item in items if item.name == "ground/hatch")
        scene = trimesh.load(io.BytesIO(hatch.bake()), file_type="glb")
        (part,) = scene.geometry.values()
        return np.asarray(part.visual.material.baseColorTexture.convert("RGBA"))

    assert (picture(None)[..., 3] == 255).all()
    drawn = picture(heights)[..., 3] > 127
    rows, cols = drawn.shape
    assert drawn[: rows // 4, cols * 4 // 5 :].all()
    assert not drawn[rows // 2 :].any()
    assert not drawn[:, : cols // 2].any()
