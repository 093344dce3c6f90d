"""The virtual samples have the shapes they say, and neighbouring windows agree about them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES, SceneWindow, scene
from wafer_viewer.rigs.virtual.scenes.drawing import grain
from wafer_viewer.rigs.virtual.scenes.tour_wafer import planted

FAR = st.floats(-3000, 3000)


def test_a_scene_that_is_not_there_is_refused_with_the_choices():
    with pytest.raises(RigError, match=r"'moon'.*wafer, gauge_blocks, stair, cone, plane"):
        scene("moon")


def test_the_gauge_blocks_differ_by_their_step_on_both_sides_of_the_joint():
    blocks = scene("gauge_blocks")
    tilt = 3e-4 * 300 + 1.2e-4 * 40
    assert blocks.truth(-300, 40) - blocks.truth(300, 40) == pytest.approx(399.88 - tilt, abs=1e-3)


def test_the_joint_of_the_gauge_blocks_is_a_deep_gap_at_x_0():
    assert scene("gauge_blocks").truth(1, 0) < -50


@given(tread=st.integers(-5, 4), y=FAR)
def test_every_tread_of_the_stair_rises_by_20_um(tread, y):
    heights = scene("stair").truth([tread * 180 + 90, tread * 180 + 270], y)
    assert np.diff(heights) == pytest.approx([20])


@given(angle=st.floats(0, 6.28), out=st.floats(0, 390))
def test_the_cone_falls_by_its_slope_in_every_direction(angle, out):
    height = scene("cone").truth(out * np.cos(angle), out * np.sin(angle))
    assert height == pytest.approx(120 - 0.3 * out, abs=1e-3)


@given(x=FAR, y=FAR)
def test_the_plane_is_a_plane(x, y):
    assert scene("plane").truth(x, y) == pytest.approx(4e-3 * x + 1.5e-3 * y, abs=1e-3)


def test_a_die_stands_30_um_over_the_trench_and_the_gel_drop_16_um_over_the_die():
    wafer = scene("wafer")
    x, y = 520 + 32 + 318, 400 + 32 + 196
    gel, die = wafer.truth(x, y), wafer.truth(x + 520, y)
    trench = wafer.truth(x, 400)
    assert gel - die == pytest.approx(16, abs=1)
    assert die - trench == pytest.approx(30, abs=1)


def test_the_die_layout_says_where_the_dies_are():
    wafer = scene("wafer")
    assert wafer.dies is not None
    boxes = np.array([wafer.dies.rectangle_um(*cell) for cell in wafer.dies.cells])
    middle_x, middle_y = (boxes[:, 0] + boxes[:, 2]) / 2, (boxes[:, 1] + boxes[:, 3]) / 2
    beside_x, beside_y = boxes[:, 0] - 32, boxes[:, 1] - 32
    assert np.all(wafer.truth(middle_x, middle_y) - wafer.truth(beside_x, beside_y) > 25)


@pytest.mark.slow
def test_nine_dies_of_the_tour_lie_whole_on_its_fields_and_carry_what_is_planted():
    tour = scene("tour_wafer")
    assert tour.dies is not None
    assert tour.tour_area_um is not None
    half_x, half_y = (um / 2 for um in tour.tour_area_um)
    boxes = [tour.dies.rectangle_um(*cell) for cell in tour.dies.cells]
    inside = [box for box in boxes if -half_x < box[0] and box[2] < half_x and -half_y < box[1] and box[3] < half_y]
    assert len(inside) == 9
    on_dies = [one for one in planted() if any(a < one.x_um < c and b < one.y_um < d for a, b, c, d in inside)]
    assert len(on_dies) >= len(planted()) - 2, "one particle lies in a street, and the middle of the scratch"
    for one in planted():
        if one.kind != "scratch":
            rise = tour.truth(one.x_um, one.y_um) - tour.truth(one.x_um + 0.8 * one.length_um, one.y_um)
            assert rise == pytest.approx(one.height_um, abs=1.2)


@pytest.mark.parametrize("name", ["wafer", "tour_wafer"])
def test_no_die_lies_on_the_edge_of_the_wafer(name):
    wafer = scene(name)
    assert wafer.dies is not None
    for cell in wafer.dies.cells:
        left, lower, right, upper = wafer.dies.rectangle_um(*cell)
        corners = [(left, lower), (right, lower), (right, upper), (left, upper)]
        assert all(left_of_every_edge(corner, wafer.outline_um) for corner in corners)


def left_of_every_edge(point, outline):
    """Whether a point is inside a convex anticlockwise outline."""
    corners = np.array(outline)
    along = np.roll(corners, -1, axis=0) - corners
    away = np.array(point) - corners
    return bool(np.all(along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0] > 0))


@pytest.mark.parametrize("name", SCENES)
def test_an_outline_is_anticlockwise_round_the_middle_and_within_the_nominal_size(name):
    sample = scene(name)
    assert left_of_every_edge((0, 0), sample.outline_um)
    x, y = np.abs(sample.outline_um).T
    assert x.max() == pytest.approx(sample.width_um / 2, rel=1e-3)
    assert y.max() == pytest.approx(sample.height_um / 2, rel=1e-3)


@pytest.mark.parametrize("name", SCENES)
def test_the_tour_takes_in_every_height_it_passes_with_room_on_both_sides(name):
    sample = scene(name)
    x, y = sample.tour_center_um
    heights = sample.truth(x + np.linspace(-470, 470, 200), y + np.linspace(-350, 350, 200)[:, None])
    seen = heights[heights > sample.z_min_um - 1]  # not the bottom of the gauge blocks' gap: no light comes from it
    end = sample.tour_z_start_um + sample.tour_z_step_um * (sample.tour_frames - 1)
    assert sample.tour_z_start_um + 3 * sample.tour_z_step_um < seen.min()
    assert seen.max() < end - 3 * sample.tour_z_step_um


@pytest.mark.parametrize("name", SCENES)
def test_two_windows_agree_where_they_overlap(name):
    sample = scene(name)
    x, y = sample.tour_center_um
    one = sample.raster(SceneWindow(x - 40, y + 40, 0.5, 120, 160))
    other = sample.raster(SceneWindow(x - 40 + 20, y + 40 - 10, 0.5, 120, 160))
    for here, there in zip(one, other, strict=True):
        np.testing.assert_array_equal(here[20:, 40:], there[:-20, :-40])


@settings(max_examples=examples(20))
@given(x=FAR, y=FAR, salt=st.integers(0, 99))
def test_grain_has_no_seams(x, y, salt):
    assert grain(x, y, salt) == pytest.approx(grain(x + 1e-6, y - 1e-6, salt), abs=1e-4)


def test_grain_has_mean_0_and_about_unit_deviation_and_no_likeness_between_salts():
    rng = np.random.default_rng(1)
    points = rng.uniform(-500, 500, (4000, 2))
    one = np.array([grain(x, y, 1) for x, y in points])
    other = np.array([grain(x, y, 2) for x, y in points])
    assert abs(one.mean()) < 0.06
    assert one.std() == pytest.approx(1, abs=0.1)
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.05
