"""A stitched surface that grows while it is looked at, and what stitching found drawn over it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from tests.browser.sessions.stitched_session import GrowingSession, StitchedSession
from tests.gui.scenes.test_scene_view import settled, until
from tests.support.stage_props import Browser
from wafer_viewer.gui.scene.quadtree import Node
from wafer_viewer.gui.scene.surface_tiles import MOST_TILES
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.errors import DatasetError

VIEW = View(step="surface")


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """No grace, and small tiles of a small surface, as many as are wanted."""
    monkeypatch.setattr("wafer_viewer.gui.scene.reconciler._GRACE_S", 0.0)
    monkeypatch.setattr("wafer_viewer.gui.scene.quadtree.TILE_PX", 64)
    monkeypatch.setitem(MOST_TILES, "surface", 200)


@pytest.fixture
def browser() -> Browser:
    return Browser()


@pytest.fixture(scope="module")
def whole() -> Iterator[StitchedSession]:
    made = StitchedSession(4, 8, coarse=8)
    yield made
    made.close()


@pytest.fixture
def growing() -> Iterator[GrowingSession]:
    made = GrowingSession(4, 8, coarse=8)
    yield made
    made.close()


@pytest.fixture
def scene(browser: Browser, growing: GrowingSession) -> Iterator[SceneView]:
    faults: list[Exception] = []
    made = SceneView(browser, growing, faults.append)  # pyright: ignore[reportArgumentType]
    yield made
    made.close()
    assert faults == []


def tiles(session: StitchedSession) -> int:
    return sum(request.what == "tile" for request in session.painted)


def tiles_on(browser: Browser) -> set[str]:
    return {name for name in browser.scene.names("/surface/") if "wall" not in name}


@pytest.mark.slow
def test_only_what_changed_is_painted_again(browser: Browser, growing: GrowingSession, scene: SceneView) -> None:
    growing.grow(30)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    first, before = tiles(growing), tiles_on(browser)
    growing.grow(1)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    again = tiles(growing) - first
    assert 0 < again <= len(before) / 4
    assert len(before & tiles_on(browser)) >= len(before) - again


@pytest.mark.slow
def test_where_it_is_not_told_what_changed_all_is_painted_again(
    browser: Browser, growing: GrowingSession, scene: SceneView
) -> None:
    growing.grow(30)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    first = tiles(growing)
    drawn = len(tiles_on(browser))
    growing.grow(1, told=False)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    assert tiles(growing) >= first + drawn


@pytest.mark.slow
def test_the_camera_the_ground_and_the_range_stay_while_it_grows(
    browser: Browser, growing: GrowingSession, scene: SceneView
) -> None:
    ranges: list[tuple[float, float]] = []
    scene.on_scale(lambda shown: ranges.append((shown.scale.low, shown.scale.high)) if shown else None)
    growing.grow(24)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    where, ground = browser.camera.position.copy(), browser.scene.names("/ground/")
    for _ in range(3):
        growing.grow(2)
        scene.draw(growing.snapshot, VIEW)
        settled(scene)
    assert np.allclose(browser.camera.position, where)
    assert browser.scene.names("/ground/") == ground
    assert len(set(ranges)) == 1


@pytest.mark.slow
def test_a_surface_that_grows_faster_than_it_is_painted_is_seen_all_the_same(
    browser: Browser, growing: GrowingSession, scene: SceneView
) -> None:
    """What was begun is drawn to its end before the newest is begun."""
    growing.grow(8)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    begun = len(growing.painted)
    for _ in range(12):
        growing.grow(2)
        scene.draw(growing.snapshot, VIEW)
        asked = len(growing.painted)
        until(lambda asked=asked: len(growing.painted) > asked or not scene.busy)
    settled(scene)
    stamps = [request.source.stamp for request in growing.painted[begun:] if request.what == "scale"]
    assert stamps == sorted(stamps)
    assert stamps[-1] == growing.snapshot.surface.stamp
    assert {r.source.stamp for r in growing.painted[begun:] if r.what == "tile"} <= set(range(1, stamps[-1] + 1))


@pytest.mark.slow
def test_fields_and_overlaps_are_drawn_over_the_surface_and_follow_it(
    browser: Browser, growing: GrowingSession, scene: SceneView
) -> None:
    growing.grow(20)
    scene.draw(growing.snapshot, View(step="surface", fields=True))
    until(lambda: browser.scene.names("/poses/"))
    settled(scene)
    kinds = {name.split("/")[3] for name in browser.scene.names("/poses/")}
    assert kinds >= {"fields", "stitches", "arrows", "doubted", "numbers"}
    log = len(browser.scene.log)
    growing.grow(2)
    scene.draw(growing.snapshot, View(step="surface", fields=True))
    settled(scene)
    overlay = [(verb, name) for verb, name in browser.scene.log[log:] if name.startswith("/poses/")]
    verbs = [verb for verb, _ in overlay]
    assert verbs == sorted(verbs)  # all of the new one is there before the old one leaves
    scene.draw(growing.snapshot, View(step="surface", fields=False))
    settled(scene)
    assert browser.scene.names("/poses/") == []


@pytest.mark.slow
def test_the_overlay_keeps_its_distances_on_the_screen_and_small_words_are_not_drawn(
    browser: Browser, whole: StitchedSession
) -> None:
    scene = SceneView(browser, whole)  # pyright: ignore[reportArgumentType]
    scene.draw(whole.snapshot, View(step="surface", fields=True))
    until(lambda: browser.scene.names("/poses/"))
    settled(scene)
    line, numbers = (browser.scene.nodes[browser.scene.names(part)[0]] for part in ("fields/line", "/numbers"))
    up = line.position[2]
    seen = numbers.visible
    for k in range(3):
        browser.camera.position = browser.camera.look_at + (browser.camera.position - browser.camera.look_at) * 6
        browser.camera.moved[0](browser.camera)
        until(lambda k=k: line.position[2] == pytest.approx(up * 6 ** (k + 1), rel=0.1))
    assert seen
    assert not numbers.visible
    scene.close()


@pytest.mark.slow
def test_overlays_are_of_the_stitched_surface_alone(browser: Browser, whole: StitchedSession) -> None:
    whole.shelf.surfaces[1] = whole.shelf.surfaces[0]
    scene = SceneView(browser, whole)  # pyright: ignore[reportArgumentType]
    scene.draw(whole.snapshot, View(step="surface", fields=True, show=1))
    until(lambda: browser.scene.names("/surface/"))
    settled(scene)
    scene.draw(whole.snapshot, View(step="measure", fields=True))
    settled(scene)
    assert browser.scene.names("/poses/") == []
    scene.close()


@pytest.mark.slow
def test_poses_that_cannot_be_read_are_told_once_and_the_surface_stands(
    browser: Browser, whole: StitchedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise DatasetError("poses.npz is torn")

    monkeypatch.setattr(whole, "poses", fail)
    messages: list[Exception] = []
    scene = SceneView(browser, whole, messages.append)  # pyright: ignore[reportArgumentType]
    scene.draw(whole.snapshot, View(step="surface", fields=True))
    until(lambda: messages)
    settled(scene)
    assert [str(fault) for fault in messages] == ["poses.npz is torn"]
    assert browser.scene.names("/surface/")
    scene.close()


@pytest.mark.slow
def test_a_surface_without_overlaps_is_coloured_by_height_instead(browser: Browser, growing: GrowingSession) -> None:
    shown: list[str] = []
    scene = SceneView(browser, growing)  # pyright: ignore[reportArgumentType]
    scene.on_scale(lambda on_show: shown.append(on_show.scale.quantity) if on_show else None)
    growing.grow(1)
    scene.draw(growing.snapshot, View(step="surface", colour_by="overlap"))
    until(lambda: shown)
    settled(scene)
    growing.shelf.surfaces[0] = dataclasses.replace(growing.shelf.surfaces[0], overlap_um=None)
    surface = dataclasses.replace(growing.snapshot.surface, stamp=99, changed=())
    scene.draw(dataclasses.replace(growing.snapshot, surface=surface), View(step="surface", colour_by="overlap"))
    until(lambda: shown[-1] == "height")
    settled(scene)
    assert shown[0] == "overlap"
    scene.close()


@pytest.mark.slow
def test_after_every_move_of_the_camera_tiles_cover_the_surface_once(
    browser: Browser, growing: GrowingSession, scene: SceneView
) -> None:
    growing.grow(32)
    scene.draw(growing.snapshot, VIEW)
    settled(scene)
    seen: list[int] = []
    for x, y, away in ((0.0, 0.0, 0.3), (0.2, 0.1, 0.08), (-0.5, 0.2, 0.1), (0.0, 0.0, 3.0), (0.4, -0.2, 0.02)):
        browser.camera.look_at = np.array([x, y, 0.05])
        browser.camera.position = browser.camera.look_at + away * np.array([0.0, -0.6, 0.8])
        browser.camera.moved[0](browser.camera)
        until(lambda x=x: scene.pose is not None and scene.pose.look_at[0] == x and not scene.busy)
        settled(scene)
        spans = [_node(name).spans for name in browser.scene.names("/surface/") if "wall" not in name]
        rows, cols = growing.shelf.surfaces[0].shape
        covered = np.zeros((rows, cols), int)
        for (r0, r1), (c0, c1) in spans:
            covered[r0:r1, c0:c1] += 1
        assert covered.max() <= 1
        seen.append(len(spans))
    assert max(seen) > seen[0] or max(seen) > 6


def _node(name: str) -> Node:
    """The node that a tile's name tells of: /surface/LEVEL/ROW_COL/SERIAL."""
    _, _, level, place, _ = name.split("/")
    row, col = place.split("_")
    return Node(int(level), int(row), int(col))
