"""Plans as an operator lays them: prices against the paper's jobs, every frame once, and what cannot be."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.acquire.planner import STRATEGIES, plan_scan, price_all
from wafer_viewer.model.acquisition.plan import Field, FieldGrid, FocusSweep, Shot
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import virtual_limits

LIMITS = virtual_limits(1080, 1440)
SWEEP = FocusSweep(z_step_um=4.0, n_frames=126)


def grid(rows, cols, width_um, height_um, limits=LIMITS):
    """Fields whose frames just cover a rectangle, as the paper's do."""
    pitch_x_um = (width_um - limits.field_width_um) / max(1, cols - 1)
    pitch_y_um = (height_um - limits.field_height_um) / max(1, rows - 1)
    return FieldGrid(
        rows=rows,
        cols=cols,
        field_width_um=limits.field_width_um,
        field_height_um=limits.field_height_um,
        overlap_x_fraction=1 - pitch_x_um / limits.field_width_um,
        overlap_y_fraction=1 - pitch_y_um / limits.field_height_um,
    ).fields(0.0)


GAUGE_BLOCKS = grid(9, 7, 3000.0, 3200.0)
WAFER = grid(16, 13, 6000.0, 6000.0)


def price(strategy, fields=GAUGE_BLOCKS, sweep=SWEEP, exposures_us=(100.0,), limits=LIMITS):
    return next(p for p in price_all(fields, sweep, exposures_us, limits) if p.strategy == strategy)


@settings(max_examples=examples(40))
@given(
    strategy=st.sampled_from(list(STRATEGIES)),
    rows=st.integers(1, 4),
    cols=st.integers(1, 4),
    n_frames=st.integers(3, 9),
    exposures_us=st.lists(st.sampled_from([20.0, 100.0, 900.0]), min_size=1, max_size=3, unique=True),
)
def test_every_strategy_takes_every_frame_exactly_once(strategy, rows, cols, n_frames, exposures_us):
    assume(len(exposures_us) >= STRATEGIES[strategy].min_exposures)
    fields = FieldGrid(rows=rows, cols=cols, field_width_um=600.0, field_height_um=500.0).fields(3.0)
    plan = plan_scan(fields, FocusSweep(z_step_um=2.04, n_frames=n_frames), tuple(exposures_us), LIMITS, strategy)
    shots = [shot for leg in plan.legs for shot in leg.shots]
    wanted = {Shot(f.number, k, e) for f in fields for k in range(n_frames) for e in range(len(exposures_us))}
    assert len(shots) == len(wanted)
    assert set(shots) == wanted
    assert plan.n_frames == len(shots)


@pytest.mark.parametrize("strategy", [name for name in STRATEGIES if name != "z_alternating"])
def test_every_pulse_falls_where_its_frame_belongs(strategy, limits):
    plan = plan_scan(GAUGE_BLOCKS[:21], FocusSweep(z_step_um=4.0, n_frames=5), (100.0, 200.0), limits, strategy)
    for leg in plan.legs:
        axis = limits.axis(leg.train.axis)
        for i, shot in enumerate(leg.shots):
            count = leg.train.first_count + leg.train.direction * leg.train.counts_per_frame * i
            at_um = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um, leg.train.axis: axis.position_um(count)}
            field = plan.field(shot.field)
            assert at_um["x"] == pytest.approx(field.x_um, abs=limits.pixel_um)
            assert at_um["y"] == pytest.approx(field.y_um, abs=limits.pixel_um)
            assert at_um["z"] == pytest.approx(plan.sweep.z_um(field, shot.k), abs=0.006)


@pytest.mark.parametrize(
    ("strategy", "low_s", "high_s"),
    [("z_snake", 136, 146), ("z_up", 140, 155), ("stop_and_shoot", 450, 650), ("x_lines", 571, 1400)],
)
def test_the_gauge_block_job_costs_what_it_should(strategy, low_s, high_s):
    assert low_s < price(strategy).predicted_s < high_s


def test_the_wafer_job_costs_what_it_should():
    sweep = FocusSweep(z_step_um=4.0, n_frames=101)
    assert 364 < price("z_snake", WAFER, sweep).predicted_s < 395


def test_no_strategy_beats_the_camera():
    floor_s = len(GAUGE_BLOCKS) * SWEEP.n_frames / LIMITS.camera.frame_rate_hz
    assert all(p.predicted_s > floor_s for p in price_all(GAUGE_BLOCKS, SWEEP, (100.0,), LIMITS))


def test_auto_takes_the_fastest():
    plan = plan_scan(GAUGE_BLOCKS, SWEEP, (100.0,), LIMITS)
    assert plan.strategy == "z_snake"
    assert plan.predicted_s == min(p.predicted_s for p in plan.prices)


def test_a_strobe_and_few_levels_make_line_passes_win():
    strobed, few = replace(LIMITS, strobe_us=18.0), FocusSweep(z_step_um=4.0, n_frames=3)
    assert plan_scan(WAFER, few, (100.0,), strobed).strategy == "y_lines"
    assert plan_scan(WAFER, few, (100.0,), LIMITS).strategy == "z_snake"
    assert plan_scan(WAFER, SWEEP, (100.0,), strobed).strategy == "z_snake"


def test_motions_are_passes_and_returns_or_every_step():
    fields, sweep = GAUGE_BLOCKS[:12], FocusSweep(z_step_um=4.0, n_frames=181)
    motions = {p.strategy: p.motions for p in price_all(fields, sweep, (100.0,), LIMITS)}
    assert motions["z_snake"] == 12
    assert motions["z_up"] == 23
    assert motions["x_lines"] == 2 * 181
    assert motions["stop_and_shoot"] == 12 * 181


def test_the_operator_may_choose_a_slower_one():
    assert plan_scan(GAUGE_BLOCKS[:7], SWEEP, (100.0,), LIMITS, "z_up").strategy == "z_up"


@pytest.mark.parametrize("exposure_us", [20.0, 100.0, 5_000.0, 60_000.0])
@pytest.mark.parametrize("strategy", ["z_snake", "x_lines", "y_lines"])
def test_motion_during_the_exposure_stays_below_its_limit(strategy, exposure_us):
    sweep = FocusSweep(z_step_um=4.0, n_frames=3)
    for leg in plan_scan(GAUGE_BLOCKS, sweep, (exposure_us,), LIMITS, strategy).legs:
        moved_um = leg.speed_um_s * exposure_us * 1e-6
        assert moved_um <= (0.1 * 4.0 if leg.train.axis == "z" else 0.5 * LIMITS.pixel_um) + 1e-9


@pytest.mark.parametrize("exposure_us", [100.0, 30_000.0])
def test_pulses_keep_the_cameras_period(exposure_us):
    for strategy in ("z_snake", "x_lines"):
        leg = plan_scan(GAUGE_BLOCKS, SWEEP, (exposure_us,), LIMITS, strategy).legs[0]
        pitch_um = LIMITS.axis(leg.train.axis).position_um(leg.train.counts_per_frame)
        assert pitch_um / leg.speed_um_s >= LIMITS.camera.period_s(exposure_us)


def test_a_step_is_rounded_to_whole_counts_and_kept_to():
    plan = plan_scan(GAUGE_BLOCKS[:2], FocusSweep(z_step_um=1.996, n_frames=50), (100.0,), LIMITS)
    assert plan.sweep.z_step_um == 2.0
    assert plan.legs[0].train.counts_per_frame == 200


def test_a_long_line_may_drift_a_pixel_by_whole_counts():
    fields = tuple(Field(number=i + 1, row=0, col=i, x_um=495.57 * i, y_um=0.0, z_start_um=0.0) for i in range(40))
    assert "field 25 would be taken" in price("x_lines", fields).ruled_out


def test_an_uneven_row_rules_line_passes_out_and_says_which_field():
    moved = (*GAUGE_BLOCKS[:2], replace(GAUGE_BLOCKS[2], x_um=GAUGE_BLOCKS[2].x_um + 30), *GAUGE_BLOCKS[3:])
    ruled_out = price("x_lines", moved).ruled_out
    assert "field 3 would be taken 30.00 um off" in ruled_out
    assert price("z_snake", moved).ruled_out is None
    with pytest.raises(PlanError, match="X passes, one z each"):
        plan_scan(moved, SWEEP, (100.0,), LIMITS, "x_lines")


def test_a_tilted_sample_rules_line_passes_out():
    tilted = tuple(replace(f, z_start_um=0.01 * f.x_um) for f in GAUGE_BLOCKS)
    assert "z_start" in price("x_lines", tilted).ruled_out
    assert "may differ" in price("x_lines", tilted).ruled_out
    assert price("y_lines", tilted).ruled_out is None


def test_a_run_up_out_of_range_is_named_with_value_and_limit():
    edge = tuple(replace(f, x_um=f.x_um + LIMITS.x.low_um) for f in GAUGE_BLOCKS)
    ruled_out = price("x_lines", edge).ruled_out
    assert "-155000" in ruled_out
    assert "run-up" in ruled_out


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"fields": ()}, "0 fields"),
        ({"fields": (GAUGE_BLOCKS[0], GAUGE_BLOCKS[0])}, "Field number 1 is there 2 times"),
        ({"fields": (replace(GAUGE_BLOCKS[4], x_um=160_000.0),)}, r"Field 5 lies at x 160000.0 um.*155000"),
        ({"fields": (replace(GAUGE_BLOCKS[4], y_um=-160_000.0),)}, r"Field 5 lies at y -160000.0 um.*155000"),
        ({"fields": (replace(GAUGE_BLOCKS[4], z_start_um=9_800.0),)}, r"Field 5 sweeps z 9800.0 to 10300.0.*10000"),
        (
            {"sweep": FocusSweep(z_step_um=60.0, n_frames=120)},
            r"Field 1 begins 7140.0 um under.*6000 um.*shorter sweep",
        ),
        ({"sweep": FocusSweep(z_step_um=0.015, n_frames=100)}, r"0.015 um is 1.50 counts.*choose 0.01 um or 0.02 um"),
        ({"sweep": FocusSweep(z_step_um=0.001, n_frames=100)}, r"choose 0.01 um\."),
        ({"exposures_us": ()}, "0 exposures"),
        ({"exposures_us": (100.0, 2e6)}, r"2e\+06 us.*10 to 100000 us"),
        ({"strategy": "zigzag"}, r"'zigzag'.*z_snake"),
    ],
)
def test_invalid_input_is_refused_in_one_sentence(change, says):
    wanted = {"fields": GAUGE_BLOCKS, "sweep": SWEEP, "exposures_us": (100.0,), "limits": LIMITS, **change}
    with pytest.raises(PlanError, match=says) as error:
        plan_scan(**wanted)
    assert str(error.value).endswith(".")


def test_a_round_wafers_unequal_rows_can_be_lined():
    disc = [f for f in WAFER if (f.row - 7.5) ** 2 + (f.col - 6) ** 2 < 40]
    plan = plan_scan(tuple(disc), FocusSweep(z_step_um=4.0, n_frames=3), (20.0,), LIMITS, "x_lines")
    assert sum(len(leg.shots) for leg in plan.legs) == 3 * len(disc)


def test_a_list_of_single_fields_needs_no_grid():
    fields = tuple(Field(number=i, row=i, col=0, x_um=97.0 * i**2, y_um=-13.0 * i, z_start_um=i) for i in range(1, 6))
    assert plan_scan(fields, SWEEP, (100.0,), LIMITS).strategy == "z_snake"
