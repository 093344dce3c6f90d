"""A coarse look at a virtual rig, the windows that follow it, and their price."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.focused_plane import Quiet, focused_rig
from wafer_viewer.acquire.focus.coarse_look import LookForFocus, more_places, sharpness, tile_peaks, touched_ends
from wafer_viewer.acquire.focus.windows import LEAST_FRAMES, fields_in_focus, plan_following, widened, windowed
from wafer_viewer.model.acquisition.plan import (
    FOLLOW_FOCUS,
    CoarseLook,
    Field,
    FieldGrid,
    FocusCell,
    FocusPlace,
    FocusSweep,
    FollowFocus,
)
from wafer_viewer.model.errors import MotionStopped, PlanError, RigError
from wafer_viewer.rigs.virtual.rig import virtual_limits

SWEEP, EXPOSURES_US = FocusSweep(z_step_um=3.0, n_frames=100), (100.0,)
WHOLE = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=-150.0)
GRID = FieldGrid(rows=6, cols=8, field_width_um=67.0, field_height_um=45.0)
FIELDS = GRID.centred_on(0.0, 0.0).fields(-150.0)


def tilted(x_um, y_um):
    return 0.2 * x_um - 0.1 * y_um


def test_a_tile_is_in_focus_where_its_slope_is_greatest_and_not_without_texture():
    rng, z_um = np.random.default_rng(0), np.arange(0.0, 60.0, 5.0)
    texture = rng.normal(0, 20, (48, 96))
    texture[:, 48:] = 0
    curves = [
        sharpness((100 + texture * np.exp(-(((z - 22) / 8) ** 2)) + rng.normal(0, 2, (48, 96))).astype(np.uint8))
        for z in z_um
    ]
    found = tile_peaks(z_um[::-1], np.stack(curves[::-1]))
    assert found.z_um[0, 0] == pytest.approx(22, abs=1.0)
    assert np.isnan(found.z_um[:, -1]).all()


def test_the_brightness_of_a_tile_without_texture_is_no_focus():
    rng, z_um = np.random.default_rng(0), np.arange(12.0)
    curves = [sharpness(rng.poisson(20 + 15 * z, (96, 96)).astype(np.uint8)) for z in z_um]
    assert tile_peaks(z_um, np.stack(curves)).n_in_focus == 0


def test_a_wall_that_is_never_sharp_is_no_focus():
    z_um = np.arange(0.0, 400.0, 10.0)
    wall = 1 + 5 * np.exp(-(((z_um - 250) / 150) ** 2))
    surface = 1 + 5 * np.exp(-(((z_um - 120) / 10) ** 2)) + np.exp(-(((z_um - 150) / 10) ** 2))
    at_end = 1 + 5 * np.exp(-((z_um / 10) ** 2))
    curves = np.stack([wall, surface, at_end], axis=1)[:, None]
    assert np.isfinite(tile_peaks(z_um, curves).z_um).all()
    found = tile_peaks(z_um, curves, fall_um=30.0)
    assert np.isnan(found.z_um[0, 0])
    assert found.z_um[0, 1:] == pytest.approx([120.0, 0.0], abs=2.0)


def test_an_end_is_touched_only_where_a_few_tiles_are_sharpest_there():
    z_um, levels = np.arange(12.0), np.ones((12, 8, 8))
    levels[5] = 9.0
    levels[0, 0, :3], levels[0, 0, 3:] = 20.0, 1.0
    assert touched_ends(tile_peaks(z_um, levels)) == (False, False)
    levels[11, 4:6] = 20.0
    assert touched_ends(tile_peaks(z_um, levels)) == (False, True)


@pytest.mark.parametrize(
    ("low_um", "high_um", "start_um", "n_frames"),
    [
        (-10.0, 50.0, -12.0, 22),
        (0.0, 3.0, -15.0, LEAST_FRAMES),
        (-400.0, -130.0, -150.0, LEAST_FRAMES),
        (130.0, 400.0, 114.0, LEAST_FRAMES),
        (-400.0, 400.0, -150.0, None),
    ],
)
def test_a_window_lies_on_the_frames_of_the_whole_sweep(low_um, high_um, start_um, n_frames):
    field = windowed(WHOLE, SWEEP, low_um, high_um)
    assert (field.z_start_um, field.n_frames) == (start_um, n_frames)
    assert (field.z_start_um - WHOLE.z_start_um) % SWEEP.z_step_um == 0


def test_a_window_that_is_touched_grows_by_its_length_until_it_is_the_whole_sweep():
    field = windowed(WHOLE, SWEEP, 0.0, 60.0)
    wider = widened(field, WHOLE, SWEEP, (True, False))
    assert (wider.z_start_um, SWEEP.top_um(wider)) == (-60.0, 60.0)
    whole = widened(widened(wider, WHOLE, SWEEP, (True, True)), WHOLE, SWEEP, (True, True))
    assert whole == WHOLE
    assert widened(whole, WHOLE, SWEEP, (True, True)) == whole


def test_a_look_finds_the_tilt_from_a_few_places_and_says_where_there_is_no_focus():
    rig = focused_rig(tilted, blank=lambda x, y: x < -200 and y > 80)
    look = LookForFocus(FIELDS, SWEEP, 100.0).run(rig, Quiet())
    rig.close()
    assert 9 <= len(look.places) <= 0.4 * len(FIELDS)
    assert {place.field for place in look.places} - {place.field for place in look.found} == {1}
    for place in look.found:
        assert place.low_um - 3 < tilted(place.x_um, place.y_um) < place.high_um + 3
    windows = fields_in_focus(FIELDS, SWEEP, rig.limits, FollowFocus(below_um=5, above_um=9), look)
    assert windows[0] == FIELDS[0], "without focus the whole sweep is taken"
    for field in windows[1:]:
        form_um = tilted(field.x_um, field.y_um)
        assert field.z_start_um <= form_um - 5
        assert SWEEP.top_um(field) >= form_um + 9
        assert field.n_frames < 40


def test_a_look_that_is_stopped_or_finds_nothing_gives_no_result():
    rig = focused_rig(tilted, blank=lambda x, y: True)
    with pytest.raises(MotionStopped):
        LookForFocus(FIELDS, SWEEP, 100.0).run(rig, Quiet(stop_after=4))
    with pytest.raises(RigError, match="None of the 8 places"):
        LookForFocus(FIELDS[:30], SWEEP, 100.0).run(rig, Quiet())
    rig.close()


def look_of(form_um=tilted) -> CoarseLook:
    rig = focused_rig(form_um)
    look = LookForFocus(FIELDS, SWEEP, 100.0).run(rig, Quiet())
    rig.close()
    return look


def test_following_is_priced_with_its_look_beside_the_other_strategies():
    limits, look = virtual_limits(96, 144), look_of()
    plan = plan_following(FIELDS, SWEEP, EXPOSURES_US, limits, "auto", FollowFocus(), look)
    follow, *others = plan.prices
    assert plan.strategy == follow.strategy == FOLLOW_FOCUS
    assert follow.predicted_s == plan.predicted_s < min(p.predicted_s for p in others if p.predicted_s)
    assert follow.look_s == look.duration_s
    assert follow.n_frames == plan.n_frames == sum(field.n_frames for field in plan.fields)
    assert {p.n_frames for p in others if p.predicted_s} == {len(FIELDS) * SWEEP.n_frames}
    assert [leg.train.n_frames for leg in plan.legs] == [plan.field(leg.shots[0].field).n_frames for leg in plan.legs]


def test_before_the_look_the_price_is_an_estimate_and_another_strategy_takes_the_whole_sweep():
    limits = virtual_limits(96, 144)
    before = plan_following(FIELDS, SWEEP, EXPOSURES_US, limits, "auto", FollowFocus())
    assert before.prices[0].estimated
    assert before.coarse_look is None
    whole = plan_following(FIELDS, SWEEP, EXPOSURES_US, limits, "z_up", FollowFocus())
    assert whole.fields == FIELDS
    assert [price.strategy for price in whole.prices] == [price.strategy for price in before.prices]
    with pytest.raises(PlanError, match="no strategy 'zigzag'"):
        plan_following(FIELDS, SWEEP, EXPOSURES_US, limits, "zigzag", FollowFocus())


def test_few_places_with_steps_give_windows_of_what_was_found_and_bounded_ones_elsewhere():
    """Dies 30 um over streets: five places tell little about the others, but all about themselves."""
    relief_um = {1: (0.0, 30.0), 8: (0.0, 32.0), 20: (30.0, 44.0), 41: (1.0, 31.0), 48: (0.0, 33.0)}
    places = tuple(
        FocusPlace(field=f.number, x_um=f.x_um, y_um=f.y_um, cells=(FocusCell(f.x_um, f.y_um, *relief_um[f.number]),))
        for f in FIELDS
        if f.number in relief_um
    )
    limits, follow = virtual_limits(135, 180), FollowFocus(below_um=0.0, above_um=0.0)
    fields = fields_in_focus(FIELDS, SWEEP, limits, follow, CoarseLook(places=places, duration_s=1.0))
    lengths_um = {f.number: (SWEEP.frames_of(f) - 1) * SWEEP.z_step_um for f in fields}
    margins_um = 5 * limits.depth_of_field_um + 2 * SWEEP.z_step_um
    for number, (low_um, high_um) in relief_um.items():
        assert lengths_um[number] <= high_um - low_um + margins_um
    assert max(lengths_um.values()) <= 3 * 44.0 + margins_um
    assert max(lengths_um.values()) > 44.0 + margins_um, "the others are less certain"


def test_more_places_are_where_the_prediction_is_least_certain_and_are_added_to_the_look():
    rig = focused_rig(tilted)
    corner = [field.number for field in FIELDS if field.col < 2 and field.row < 2]
    first = LookForFocus(FIELDS, SWEEP, EXPOSURES_US[0], tuple(corner)).run(rig, Quiet())
    numbers = more_places(FIELDS, first, SWEEP, rig.limits)
    look = LookForFocus(FIELDS, SWEEP, EXPOSURES_US[0], numbers, first).run(rig, Quiet())
    rig.close()
    assert len(numbers) == 2
    assert all(FIELDS[n - 1].row >= 4 or FIELDS[n - 1].col >= 4 for n in numbers)
    assert [place.field for place in look.places] == [*(place.field for place in first.places), *numbers]
    assert look.duration_s > first.duration_s
    assert more_places(FIELDS[:2], first, SWEEP, rig.limits) == ()
