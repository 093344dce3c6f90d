"""The overlay of fields and overlaps, before and after it is laid on a surface."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.made_up_poses import made_up_poses
from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, grid
from wafer_viewer.gui.scene.primitives import DrapedLines
from wafer_viewer.gui.scenes.pose_overlay import Fields, in_dashes, round_below, sides
from wafer_viewer.model.surface.field_poses import RejectionReason
from wafer_viewer.session.rendering.render_request import CoarseHeightField

WIDTH_UM, HEIGHT_UM = COLS * PIXEL_UM, ROWS * PIXEL_UM
FIELDS = grid(3, 4).fields(0.0)
POSES = made_up_poses(
    FIELDS,
    WIDTH_UM,
    HEIGHT_UM,
    {(1, 2): RejectionReason.AMBIGUOUS, (6, 7): RejectionReason.BLANK, (3, 7): RejectionReason.UNLIKE},
    left_out=(12,),
)
KEPT = ~POSES.left_out


def drawn(poses=POSES, most=4000) -> Fields:
    return Fields(poses, WIDTH_UM, HEIGHT_UM, most)


def test_arrows_lead_from_the_stages_place_so_many_times_too_far():
    fields = drawn()
    shafts = fields.arrows()[:, 0]
    off = np.stack([POSES.x_um - POSES.stage_x_um, POSES.y_um - POSES.stage_y_um], axis=1)[KEPT]
    assert np.allclose(shafts[:, 1] - shafts[:, 0], fields.times * off)
    assert np.allclose(shafts[:, 0], np.stack([POSES.stage_x_um, POSES.stage_y_um], axis=1)[KEPT])
    longest = np.hypot(*(fields.times * off).T)
    assert np.percentile(longest, 90) <= 0.55 * HEIGHT_UM < np.percentile(longest, 90) * 2.6


def test_the_circle_of_an_uncertain_place_is_drawn_to_the_scale_of_the_arrows():
    unsure = dataclasses.replace(POSES, u_x_um=np.where(np.arange(12) == 4, 1.5, 1e-4), u_y_um=np.full(12, 1e-4))
    fields = drawn(unsure)
    rim = fields.circles()
    assert len(rim) == 1
    assert np.ptp(rim[0, ..., 0]) == pytest.approx(2 * 2 * 1.5 * fields.times, rel=1e-3)
    assert rim[0, :-1, 0].mean(axis=0) == pytest.approx(fields.arrows()[4, 0, 1], abs=30)


def test_where_places_are_less_sure_than_the_stage_is_wrong_the_circles_have_room():
    sure_stage = dataclasses.replace(
        POSES, x_um=POSES.stage_x_um + 0.1, y_um=POSES.stage_y_um, u_x_um=np.full(12, 0.55), u_y_um=np.full(12, 0.55)
    )
    fields = drawn(sure_stage)
    radius_um = np.ptp(fields.circles()[0, ..., 0]) / 2
    assert radius_um == pytest.approx(2 * 0.55 * fields.times)
    assert radius_um <= 0.25 * HEIGHT_UM < 2.6 * radius_um


def test_what_joins_fields_and_what_does_not():
    fields, shifts = drawn(), POSES.shifts
    at_left_out = POSES.left_out[shifts.first] | POSES.left_out[shifts.second]
    assert len(fields.stitches()) == (shifts.believed & ~at_left_out).sum()
    assert len(fields.doubted(blank=True)) == 1
    frames = fields.doubted(blank=False)
    assert len(frames) == 2
    a, b = fields.boxes[0], fields.boxes[1]
    shared = (max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3]))
    assert (frames[0][:2] > shared[:2]).all()
    assert (frames[0][2:] < shared[2:]).all()


def test_what_is_left_out_is_crossed_and_has_no_arrow():
    fields = drawn()
    assert len(fields.left_out()) == 2
    assert len(fields.left_out_frames()) == 4
    assert len(fields.outlines()) == 4 * 11
    assert len(fields.arrows()) == 11


def test_of_very_many_fields_each_so_manieth_is_drawn_and_all_that_are_left_out():
    fields = drawn(most=4)
    assert fields.every == 3
    assert len(fields.outlines()) == 4 * 4
    assert len(fields.left_out()) == 2


def test_a_surface_whose_fields_lie_where_the_stage_says_has_no_arrows():
    fields = drawn(dataclasses.replace(POSES, x_um=POSES.stage_x_um, y_um=POSES.stage_y_um))
    assert fields.times == 1
    assert len(fields.arrows()) == 0


@given(st.floats(1, 1e6))
def test_a_round_number_below(value: float):
    below = round_below(value)
    assert below <= value * (1 + 1e-9) < 2.6 * below
    assert f"{below:.0f}".rstrip("0") in ("1", "2", "5")


def test_dashes_cover_their_share_and_begin_at_corners():
    square = sides(np.array([[0.0, 0.0, 100.0, 40.0]]))
    dashes = in_dashes(square, 10.0, 0.5)
    long = np.hypot(*(dashes[:, 1] - dashes[:, 0]).T)
    assert long.sum() == pytest.approx(140.0)
    assert {tuple(begin) for begin in dashes[:, 0].round(6)} >= {(0, 0), (100, 0), (100, 40), (0, 40)}


def relief(z: np.ndarray, pixel_um: float = 2.0) -> CoarseHeightField:
    data = (z.astype("<f4").tobytes(), np.ones(z.shape, bool).tobytes())
    return CoarseHeightField(*z.shape, pixel_um, 0.0, (z.shape[0] - 1) * pixel_um, *data)


@given(st.integers(0, 2**31), st.floats(3, 60))
def test_lines_lie_over_the_surface_at_every_place_between_their_corners(seed: int, span_um: float):
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 3, (60, 80)).cumsum(axis=1)
    drape = DrapedLines(
        msgspec.msgpack.decode(msgspec.msgpack.encode(relief(z)), type=CoarseHeightField), -5.0, span_um
    )
    pieces = rng.uniform(0, 110, (6, 2, 2))
    segments = drape.segments(pieces).astype(float)
    share = np.linspace(0, 1, 5)[:, None]  # the places that were looked at
    places = segments[:, None, 0] + (segments[:, 1] - segments[:, 0])[:, None] * share
    assert (places[..., 2] >= drape.z_mm(places[..., 0] * 1e3, places[..., 1] * 1e3) - 1e-4).mean() > 0.97
    assert segments[..., 2].max() <= (z.max() + 5.0) * 1e-3 + 1e-6


def test_on_a_flat_picture_everything_lies_flat():
    drape = DrapedLines(None, 3.0, 10.0)
    assert (drape.segments(drawn().outlines())[..., 2] == 0).all()
    assert (drape.level(drawn().arrows())[..., 2] == 0).all()


def test_an_arrow_is_straight_over_a_street():
    z = np.zeros((60, 80))
    z[:, 30:50] = 9.0
    figures = np.array([[[[10.0, 50.0], [150.0, 50.0]]]])
    level = DrapedLines(relief(z), 0.0, 5.0).level(figures)
    assert level[..., 2] == pytest.approx(9e-3)
