"""Beside a jump of the surface that no silhouette explains, heights are left out and say why."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.truth.layouts import Layout, Taken, take
from tests.truth.views import Optics
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Outliers, Recipe
from wafer_viewer.reconstruct.cleaning.clean import Cleaned, clean, height_range_um, settle_cleaning
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus_evidence import focus_curve

Z_UM = np.linspace(120.0, 280.0, 41)
STAIR = Layout("two treads", Optics(0.28, views=80), 3, scene="stair", settings={"treads": 2})


@pytest.fixture(scope="module")
def stair() -> Taken:
    """Two treads 40 um apart, equally bright."""
    return take(STAIR, (96, 160), Z_UM)


def test_heights_apart_are_seen_from_half_a_window_away() -> None:
    z_um = np.zeros((30, 40), np.float32)
    z_um[:, 20:] = 40.0
    z_um[5, :] = np.nan
    away = np.abs(np.arange(40) - 19.5)
    found = height_range_um(z_um, 9)
    assert (found[:, away < 4] == 40).all()
    assert (found[:, away > 6] == 0).all()
    assert (height_range_um(np.full((6, 7), np.nan, np.float32), 9) < 0).all()


def test_a_slope_is_as_steep_at_the_border_as_inside() -> None:
    z_um = np.broadcast_to(np.arange(40, dtype=np.float32), (30, 40))
    for slope in (z_um, z_um.T):
        found = height_range_um(slope, 9)
        assert np.ptp(found) == 0
        assert found[0, 0] == 9


def cleaned_of(z_um: NDArray[np.float32], bled_um: NDArray[np.float32] | None = None) -> Cleaned:
    """A map whose resolution is 4 um, under a cone of light as steep as 3.9, where no silhouette tells sides apart."""
    recipe = changed(Recipe(window=9, focus_width_um=10.0), outliers=Outliers(mode="none"))
    recipe = settle_cleaning([z_um], recipe, 4.0)
    return clean(z_um, 0.5, recipe, 4.0, np.zeros(z_um.shape, np.bool_), bled_um)


def test_no_sliver_of_a_steep_slope_is_left() -> None:
    z_um = np.zeros((60, 80), np.float32)
    z_um[:, 20:] = 1.6 * np.arange(60)
    z_um[:, 60:] = np.nan
    z_um[30:33, 60:70] = 50.0
    z_um[10, 50:] = np.nan
    found = cleaned_of(z_um)
    assert np.isfinite(found.raw_um[:, :14]).all()
    assert np.isnan(found.raw_um[:, 22:]).all()
    assert found.step_edge[20, 30]
    assert found.outlier[31, 68]


@pytest.mark.parametrize(("slope", "kept"), [(0.5, True), (0.8, False)])
def test_one_surface_is_less_steep_than_the_cone_of_light(slope: float, kept: bool) -> None:
    cone_um_per_px = 3.9 * 0.5
    found = cleaned_of(slope * cone_um_per_px * np.arange(80, dtype=np.float32) * np.ones((60, 1), np.float32))
    assert np.isfinite(found.raw_um).all() == kept
    assert found.step_edge.all() != kept


@pytest.mark.parametrize(("angle_deg", "slope"), [(45, 0.55), (20, 0.6)])
def test_a_plane_may_be_as_steep_along_a_diagonal(angle_deg: float, slope: float) -> None:
    down, right = np.indices((60, 80))
    along = np.cos(np.radians(angle_deg)) * right + np.sin(np.radians(angle_deg)) * down
    rng = np.random.default_rng(2)
    found = cleaned_of((slope * 3.9 * 0.5 * along + rng.normal(0, 0.2, along.shape)).astype(np.float32))
    assert np.isfinite(found.raw_um).all()


@pytest.mark.slow
@pytest.mark.parametrize("jump_um", [7.0, 10.0])
def test_a_jump_on_a_slope_is_still_an_edge(jump_um: float) -> None:
    right = np.arange(80, dtype=np.float32) * np.ones((60, 1), np.float32)
    found = cleaned_of(0.5 * right + jump_um * (right >= 40))
    assert found.step_edge[:, 38:42].all()
    assert not found.step_edge[:, :30].any()


def test_heights_continuing_from_bleeding_are_rejected() -> None:
    everything = 1.6 * np.arange(80, dtype=np.float32) * np.ones((60, 1), np.float32)
    beyond = np.arange(80) >= 76
    z_um, bled_um = (np.where(where, everything, np.float32(np.nan)) for where in (beyond, ~beyond))
    alone, neighbour = cleaned_of(z_um), cleaned_of(z_um, bled_um)
    assert np.isfinite(alone.raw_um[:, 76:]).all()
    assert neighbour.step_edge[:, 76:].all()


def islands(rise_um: float) -> NDArray[np.float32]:
    """A large surface and a small island, both with ripples so high, over two windows long."""
    z_um = (rise_um / 2 * np.sin(np.arange(200) * np.pi / 9)).astype(np.float32) * np.ones((160, 1), np.float32)
    island = np.zeros(z_um.shape, np.bool_)
    island[20:44, 160:184] = True
    return np.where(island | (np.arange(200) < 140), z_um, np.float32(np.nan))


def test_uneven_heights_count_where_many_others_support_them() -> None:
    recipe = changed(Recipe(window=9, focus_width_um=10.0))
    found = {}
    for rise_um in (0.4, 6.0):
        z_um = islands(rise_um)
        settled = settle_cleaning([z_um], recipe, 4.0)
        found[rise_um] = clean(z_um, 0.5, settled, 4.0, np.zeros(z_um.shape, np.bool_))
    assert np.isfinite(found[0.4].raw_um[20:44, 160:184]).all()
    assert found[6.0].outlier[24:40, 164:180].all()
    assert np.isfinite(found[6.0].raw_um[10:150, 10:130]).all()


def test_of_an_island_without_support_no_crumb_is_left() -> None:
    z_um = islands(6.0)
    z_um[26:38, 166:178] = 0.0
    settled = settle_cleaning([z_um], Recipe(window=9, focus_width_um=10.0), 4.0)
    found = clean(z_um, 0.5, settled, 4.0, np.zeros(z_um.shape, np.bool_))
    assert np.isnan(found.raw_um[20:44, 160:184]).all()


@pytest.mark.parametrize("joined", [True, False])
def test_beside_a_wall_uneven_heights_count_where_the_focus_along_it_gave_them_and_joins_others(joined: bool) -> None:
    z_um = islands(6.0)
    if joined:
        z_um[20:140, 184:] = z_um[20, 183]
    settled = settle_cleaning([z_um], Recipe(window=9, focus_width_um=10.0), 4.0)
    side_is_known, found_along = np.ones(z_um.shape, np.bool_), np.zeros(z_um.shape, np.bool_)
    found_along[:, 172:184] = True
    found = clean(z_um, 0.5, settled, 4.0, side_is_known, found_along=found_along)
    assert found.outlier[24:40, 164:172].all()
    assert (np.isfinite(found.raw_um[20:44, 172:184]) == joined).all()
    assert np.isfinite(found.raw_um[10:150, 10:130]).all()


def test_heights_next_to_a_step_belong_to_their_side(stair: Taken) -> None:
    guarded, open_ = (reconstruct(stair.stack, Recipe(window=9, edges=edges)) for edges in ("rims", "none"))
    wrong = [int((np.abs(h.z_raw_um - stair.scene.truth_um) > 4).sum()) for h in (guarded, open_)]
    assert wrong[1] > 20
    assert wrong[0] < 0.1 * wrong[1]
    left_out = guarded.origin == Origin.STEP_EDGE
    assert left_out.any()
    assert not left_out[stair.scene.edge_distance_px > 10].any()


def test_the_pixel_gives_the_reason(stair: Taken) -> None:
    height = reconstruct(stair.stack, Recipe(window=9))
    row, col = np.argwhere(height.origin == Origin.STEP_EDGE)[40]
    found = focus_curve(stair.stack, float(height.x_um[col]), float(height.y_um[row]), height.provenance.recipe)
    assert found.origin == "at the edge of a step"
    assert found.verdicts[-1].question == "Are the heights around it of one surface?"
    assert not found.verdicts[-1].passed
