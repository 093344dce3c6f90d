"""The run chart by hand: limits of moving ranges, rules that warn, drift and when it leaves the limit."""

from __future__ import annotations

import pytest

from tests.support.gauge_repeats import CALIBRATION, record
from wafer_viewer.measure.gauge.gauge_studies import ONE_SIDE, OUTSIDE, pooled_scatter, run_chart
from wafer_viewer.model.gauge import GaugeTerms
from wafer_viewer.model.spec import replace


def of_errors(*errors_um, **terms):
    """A check a day from June 1 on, each of one scan with the error given."""
    reported = GaugeTerms(**{"limit_um": 0.5, **terms})
    return [record(f"2026-06-{day:02d}", 400.0 + error, terms=reported) for day, error in enumerate(errors_um, 1)]


def test_control_limits_are_three_deviations_by_moving_ranges():
    chart = run_chart(of_errors(0.0, 0.1, 0.0, 0.1, 0.0))
    assert chart.mean_um == pytest.approx(0.04)
    assert chart.s_um == pytest.approx(0.1 / 1.128)
    assert chart.high_um == pytest.approx(0.04 + 0.3 / 1.128)
    assert chart.low_um == pytest.approx(0.04 - 0.3 / 1.128)
    assert chart.limit_um == 0.5
    assert chart.warnings == ()
    assert [point.verdict for point in chart.points] == ["pass"] * 5


def test_few_checks_have_no_limits_and_none_have_no_chart():
    assert run_chart([]) is None
    assert run_chart(of_errors(0.0, 0.1, 0.0, 0.1)).s_um is None


def test_a_point_outside_is_named_and_warned_of_while_it_is_the_last():
    errors = [0.0, 0.01, 0.0, 0.01, 0.0, 0.01, 0.0, 0.01, 0.0, 0.3]
    chart = run_chart(of_errors(*errors))
    assert chart.points[-1].breaks == (OUTSIDE,)
    assert any("outside" in warning for warning in chart.warnings)
    after = run_chart(of_errors(*errors, 0.0))
    assert OUTSIDE in after.points[-2].breaks
    assert not any("outside" in warning for warning in after.warnings)


def test_eight_on_one_side_are_more_than_chance():
    chart = run_chart(of_errors(*[-0.1] * 8, *[0.02, 0.01] * 4))
    assert ONE_SIDE not in chart.points[6].breaks
    assert ONE_SIDE in chart.points[7].breaks
    assert ONE_SIDE not in chart.points[14].breaks
    assert ONE_SIDE in chart.points[15].breaks
    assert any(ONE_SIDE in warning for warning in chart.warnings)


def test_drift_is_reported_with_its_uncertainty():
    """By hand: on days 0 to 3 a slope of 0.06, off which the errors lie by -0.01, 0.03, -0.03, 0.01."""
    drift = run_chart(of_errors(0.0, 0.1, 0.1, 0.2)).drift_um_per_day
    assert drift.value_um == pytest.approx(0.06)
    u_of_slope = ((2 * 0.01**2 + 2 * 0.03**2) / 2 / 5) ** 0.5
    assert drift.expanded_um == pytest.approx(4.527 * u_of_slope, rel=1e-3)  # t for two degrees of freedom


def test_two_days_tell_no_drift():
    assert run_chart(of_errors(0.0, 0.1)).drift_um_per_day is None


@pytest.mark.parametrize(
    ("interval", "message"), [(30, "leaves the limit of 0.5 um in 21 days"), (7, "stays within the limit")]
)
def test_a_drift_that_leaves_the_limit_before_the_next_check_is_warned_of(interval, message):
    errors = [0.0, 0.021, 0.04, 0.059, 0.08]
    (warning,) = run_chart(of_errors(*errors, interval_days=interval)).warnings
    assert "drifts by +0.02 um per day" in warning
    assert message in warning


def test_no_drift_is_warned_of_that_may_be_chance():
    assert run_chart(of_errors(0.0, 0.1, 0.05, 0.0, 0.1)).warnings == ()


def test_checks_of_another_z_scale_are_left_out_and_counted():
    before = of_errors(0.4, 0.4)
    corrected = replace(CALIBRATION, z_scale=0.999)
    after = [record(f"2026-07-0{n}", 400.0, calibration=corrected) for n in (1, 2)]
    chart = run_chart([*after, *before])
    assert [point.at[:10] for point in chart.points] == ["2026-07-01", "2026-07-02"]
    assert chart.notes == ("Made with another z scale and not in the chart: 2.",)
    assert (chart.warnings, chart.due) == ((), "2026-08-01")


def test_the_scatter_of_single_scans_is_pooled_within_checks():
    records = [record("2026-06-01", 400.0, 400.2, 400.1), record("2026-06-02", 399.0, 399.4, 399.2)]
    valid = pooled_scatter(records)
    assert valid.freedom == 4
    assert valid.s_um == pytest.approx(((2 * 0.01 + 2 * 0.04) / 4) ** 0.5)
    assert pooled_scatter(records[:1]) is None
