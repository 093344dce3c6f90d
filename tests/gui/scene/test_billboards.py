"""Words in the scene: facing the camera, as large as they say, and before whatever would hide them."""

from __future__ import annotations

import numpy as np
import pytest
import viser.transforms as vtf

from tests.gui.tools.test_places import SIDE_PX, height_field_of, noise, xy
from tests.support.stage_props import RecordingScene
from wafer_viewer.draw.raster_text import tag
from wafer_viewer.gui.scene.billboards import Billboard, corner_on_screen
from wafer_viewer.gui.scene.camera_presets import FOV_RAD, CameraPose, direction_of
from wafer_viewer.gui.scene.heightfield import HeightField
from wafer_viewer.gui.scene.viewport import ViewAxes
from wafer_viewer.model.region import Region

HEIGHT_PX, WIDTH_PX, HIGH_PX = 850, 900, 26
VIEWS = ("top", "front", "iso")


def walled() -> HeightField:
    """A trench along x at y = 150 ± 30 between plateaus 60 um high."""
    return height_field_of(np.where(np.abs(xy()[1] - 150) < 30, 0.0, 60.0) + noise())


def view_axes_from(direction: np.ndarray, distance_mm: float = 1.0) -> ViewAxes:
    at = np.array([0.15, 0.15, 0.03])
    return ViewAxes.of(CameraPose(at + direction * distance_mm, at), 2 * distance_mm * np.tan(FOV_RAD / 2) / HEIGHT_PX)


def on_screen(view_axes: ViewAxes, places: np.ndarray) -> np.ndarray:
    """Pixels right of and above the middle of the screen, [n, 2]."""
    right, up, towards = view_axes.axes.T
    away = places - view_axes.eye
    focal_px = view_axes.distance_mm / view_axes.mm_per_pixel
    return focal_px * np.stack([away @ right, away @ up], axis=1) / -(away @ towards)[:, None]


@pytest.mark.parametrize("preset", VIEWS)
def test_the_turn_of_a_sign_lays_it_along_the_screen(preset) -> None:
    view_axes = view_axes_from(direction_of(preset))
    assert vtf.SO3(np.array(view_axes.wxyz)).as_matrix() == pytest.approx(view_axes.axes, abs=1e-9)


def stand(height_field: HeightField, view_axes: ViewAxes, by: np.ndarray, right_px: float) -> np.ndarray:
    """The corners of a sign that was placed: lower left, lower right, upper left, upper right, in scene mm."""
    scene = RecordingScene()
    sign = Billboard(scene, "sign", "Lower", (21, 32, 43), HIGH_PX)  # type: ignore[arg-type]
    sign.place(by, height_field, view_axes, right_px)
    (node,) = scene.nodes.values()
    wide_px = tag("Lower", (255, 255, 255), (21, 32, 43), 2 * HIGH_PX).shape[1] / 2
    flat = np.array([(x, y, 0) for y in (-HIGH_PX / 2, HIGH_PX / 2) for x in (-wide_px, 0)])
    return np.array(node.position) + flat * node.scale @ vtf.SO3(np.array(node.wxyz)).as_matrix().T


@pytest.mark.parametrize("right_px", [-12.0, 12.0])
@pytest.mark.parametrize("preset", VIEWS)
def test_a_sign_keeps_its_place_and_size_on_the_screen_though_it_comes_before_a_wall(preset, right_px) -> None:
    height_field, view_axes = walled(), view_axes_from(direction_of(preset))
    by = np.array([0.15, 0.15, 0.0])
    corners = stand(height_field, view_axes, by, right_px)
    shown, place = on_screen(view_axes, corners), on_screen(view_axes, by[None])[0]
    near, far = (shown[1], shown[0]) if right_px < 0 else (shown[0], shown[1])
    assert near[0] - place[0] == pytest.approx(right_px, abs=0.1)
    assert np.sign(far[0] - near[0]) == np.sign(right_px)
    assert shown[2, 1] - shown[0, 1] == pytest.approx(HIGH_PX, abs=0.1)


@pytest.mark.parametrize("preset", VIEWS)
def test_nothing_of_the_surface_stands_before_a_sign(preset) -> None:
    height_field, view_axes = walled(), view_axes_from(direction_of(preset))
    corners = stand(height_field, view_axes, np.array([0.15, 0.15, 0.0]), -12.0)
    ways = corners[:, None] + (view_axes.eye - corners[:, None]) * np.linspace(0, 1, 400)[:, None]
    assert (ways[..., 2] >= height_field.visible_z_mm(ways[..., 0], ways[..., 1])).all()


def test_a_sign_that_nothing_hides_stays_at_its_place() -> None:
    height_field, view_axes = (
        height_field_of(np.full((SIDE_PX, SIDE_PX), 5.0) + noise()),
        view_axes_from(direction_of("top")),
    )
    by = np.array([0.15, 0.15, 0.05])
    assert stand(height_field, view_axes, by, -12.0)[1, 2] == pytest.approx(0.05, abs=1e-4)


def test_the_edge_of_a_region_is_that_on_the_screen() -> None:
    height_field, region = walled(), Region.rectangle(100, 130, 200, 170)
    south, north = (view_axes_from(direction_of("front") * np.array([1, turned, 1])) for turned in (1, -1))
    for view_axes in (south, north):
        left, right = (corner_on_screen(region, height_field, view_axes, side, 0) for side in (-1, 1))
        assert on_screen(view_axes, left[None])[0, 0] < on_screen(view_axes, right[None])[0, 0]
        assert left[1] == pytest.approx(0.15, abs=1e-3)
    assert corner_on_screen(region, height_field, south, -1, 0)[0] == pytest.approx(0.1, abs=1e-3)
    assert corner_on_screen(region, height_field, north, -1, 0)[0] == pytest.approx(0.2, abs=1e-3)


def test_a_tag_has_an_edge_that_is_smooth_in_its_own_colour() -> None:
    picture = tag("S1", (255, 255, 255), (21, 32, 43), 52)
    assert picture.shape[0] == 52
    assert (picture[[0, -1], :, 3] < 40).all()
    assert len(np.unique(picture[..., 3])) > 10
    assert (picture[picture[..., 3] < 250][:, :3] == (21, 32, 43)).all()
