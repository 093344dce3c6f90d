"""The z scale by a check: certified over measured, sure as the comparison is, and refused where it cannot be told."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.gauge_repeats import CALIBRATION, certificate, repeats, signed
from wafer_viewer.calibrate.topography import scale_correction
from wafer_viewer.measure.gauge.gauge_check import gauge_check, refusal
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeTerms
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace

TODAY = "2026-06-01"
SCANS = (400.79, 400.8, 400.81)


def test_the_mean_would_then_be_what_is_certified():
    used = replace(CALIBRATION, z_scale=1.01)
    check = signed("2026-06-01", *SCANS, calibration=used)
    in_force = replace(used, u_pixel_um=1e-4)
    found = scale_correction(check, in_force, TODAY)
    assert found.factor == pytest.approx(400.0 / 400.8)
    assert found.calibration.z_scale == pytest.approx(1.01 * 400.0 / 400.8)
    assert found.calibration.u_z_scale == pytest.approx(check.deviation.expanded_um / 2 / 400.0)
    assert found.changes_um == pytest.approx(-0.8)
    assert "more than its U" in found.advice
    assert (found.calibration.made, found.calibration.due) == (TODAY, "2026-07-01")
    assert found.calibration.u_pixel_um == 1e-4
    assert found.calibration.z_against == ("A1", "A2")
    assert refusal(certificate(), found.calibration, None, TODAY) is not None


def test_it_is_due_no_later_than_what_it_takes_the_place_of():
    check = signed("2026-06-01", *SCANS)
    assert scale_correction(check, replace(CALIBRATION, due="2026-06-15"), TODAY).calibration.due == "2026-06-15"


def test_an_error_within_its_u_may_make_the_scale_surer():
    used = replace(CALIBRATION, u_z_scale=5e-4)
    check = signed("2026-06-01", 400.0, 400.01, 400.02, calibration=used)
    assert "may be right as it is" in scale_correction(check, used, TODAY).advice


def test_a_scale_that_is_surer_than_the_check_is_left_alone():
    used = replace(CALIBRATION, u_z_scale=1e-5)
    check = signed("2026-06-01", 400.0, 400.01, 400.02, calibration=used)
    with pytest.raises(MeasureError, match="nothing to correct"):
        scale_correction(check, used, TODAY)


@pytest.mark.parametrize(
    ("values", "changes", "message"),
    [
        (SCANS[:2], {}, "has 2 repeats"),
        (SCANS, {"height": Length(value_um=400.8)}, "no uncertainty"),
        (SCANS, {"calibration": replace(CALIBRATION, setup=OpticalSetup(objective="5x"))}, "is of 5x"),
    ],
)
def test_what_sets_no_scale_is_refused(values, changes, message):
    check = gauge_check(repeats(*values, **changes), certificate(), GaugeTerms())
    with pytest.raises(MeasureError, match=message):
        scale_correction(check, CALIBRATION, TODAY)


@pytest.mark.slow
def test_a_hidden_error_of_a_hundredth_of_a_percent_is_found_within_u():
    hidden, covered, shares = 1e-4, [], []
    used = replace(CALIBRATION, u_z_scale=5e-4)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        true_um = 1_000.0 + rng.normal(0, 0.015)
        measured_um = true_um / (1 + hidden) + rng.normal(0, 0.02, 6)
        steps = repeats(*measured_um.tolist(), noise_um=0.02, calibration=used)
        sure = certificate(nominal_um=1_000.0, value_um=1_000.0, expanded_um=0.03, variation_um=0.02)
        check = gauge_check(steps, sure, GaugeTerms(limit_um=0.5, temperature_c=20.0))
        found = scale_correction(check, used, TODAY).calibration
        covered.append(abs(found.z_scale - (1 + hidden)) <= 2 * found.u_z_scale)
        shares.append(2 * found.u_z_scale)
    assert np.mean(covered) >= 0.9
    assert max(shares) < hidden, "the checks are good enough to see it"
