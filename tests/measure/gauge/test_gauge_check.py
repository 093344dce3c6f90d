"""Checks against gauge blocks: En, the guard band and the budget by hand, what is refused, how often U covers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support.gauge_repeats import CALIBRATION, LOWER, UPPER, certificate, repeat, repeats
from tests.support.surfaces import gauge_blocks, surface_of
from wafer_viewer.measure.gauge.gauge_check import (
    KnownTerms,
    contradiction,
    en,
    gauge_check,
    gauge_repeat,
    judge_error,
    refusal,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeTerms
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace

DAY = "2026-06-01"


def length(value_um, expanded_um):
    return Length(value_um=value_um, expanded_um=expanded_um, status="evaluated")


def repeatability(check):
    """Standard uncertainty and degrees of freedom of a line that is evaluated by scatter."""
    (line,) = (line for line in check.budget if line.name == "repeatability")
    assert line.evaluation == "A"
    return line.u_um, line.freedom


def u_of(check, name):
    return next(line.u_um for line in check.budget if line.name == name)


@pytest.mark.parametrize(
    ("x", "u_x", "ref", "u_ref", "expected"),
    [(100.5, 0.3, 100.0, 0.4, 1.0), (99.7, 0.5, 100.0, 0.0, -0.6), (10.0, 1.2, 10.65, 0.5, -0.5)],
)
def test_en_by_hand(x, u_x, ref, u_ref, expected):
    assert en(length(x, u_x), length(ref, u_ref)) == pytest.approx(expected)


def test_no_en_without_both_uncertainties():
    assert en(Length(value_um=1.0), length(1.0, 0.1)) is None
    assert en(length(1.0, 0.0), length(1.0, 0.0)) is None


@pytest.mark.parametrize(
    ("error", "u", "word"),
    [
        (0.3, 0.2, "pass"),  # up to the limit itself
        (-0.3, 0.2, "pass"),
        (0.31, 0.2, "inconclusive"),
        (-0.7, 0.2, "inconclusive"),
        (0.71, 0.2, "fail"),
        (-0.71, 0.2, "fail"),
        (0.0, 0.51, "inconclusive"),
    ],
)
def test_the_guard_band_by_hand(error, u, word):
    assert judge_error(length(error, u), 0.5)[0] == word


def test_neither_without_a_limit_nor_without_an_uncertainty_is_there_a_verdict():
    assert judge_error(length(0.0, 0.1), None)[0] == "no verdict"
    assert judge_error(Length(value_um=0.0), 0.5)[0] == "no verdict"


def test_a_pass_of_one_scan_says_that_repeatability_is_not_known():
    (one, two) = (
        gauge_check(repeats(*at), certificate(), GaugeTerms(limit_um=1.0)) for at in ((400.0,), (400.0, 400.01))
    )
    assert (one.verdict, two.verdict) == ("pass", "pass")
    assert one.why.endswith("Repeatability is not known: it takes two scans.")
    assert "Repeatability" not in two.why


def test_a_coverage_factor_that_was_changed_contradicts_the_budget():
    check = gauge_check(repeats(399.9, 400.0, 400.1), certificate())
    assert contradiction(check) is None
    forged = replace(check, height=replace(check.height, k=2.0))
    assert "the height is said to be" in contradiction(forged)
    assert forged.height.quantity.contradiction.startswith("k is said to be 2, and is 2.1")


def test_fewer_scans_than_asked_for_get_no_verdict():
    terms = GaugeTerms(limit_um=1.0, least_repeats=3)
    short, enough = (
        gauge_check(repeats(400.0), certificate(), terms),
        gauge_check(repeats(400.0, 400.0, 400.01), certificate(), terms),
    )
    assert (short.verdict, enough.verdict) == ("no verdict", "pass")
    assert short.why == "A verdict takes 3 scans: add 2 more scans of the blocks."
    assert contradiction(short) is None


def test_the_error_leaves_the_z_scale_out_and_u_of_x_the_certificate():
    found = gauge_check(
        repeats(400.1), certificate(grade="0"), GaugeTerms(limit_um=0.5, temperature_c=20.0, u_temperature_c=1.0)
    )
    variation, temperature = 0.1 / math.sqrt(3), 400 * 11.5e-6
    assert u_of(found, "variation in length of both blocks") == pytest.approx(variation)
    assert u_of(found, "temperature of the blocks") == pytest.approx(temperature)
    assert found.height.expanded_um == pytest.approx(2 * math.hypot(0.04, 0.08))
    assert found.reference.expanded_um == pytest.approx(2 * math.hypot(0.03, variation, temperature))
    assert found.deviation.value_um == pytest.approx(0.1)
    assert found.deviation.expanded_um == pytest.approx(2 * math.hypot(0.04, 0.03, variation, temperature))
    assert found.en == pytest.approx(0.1 / (2 * math.hypot(0.04, 0.08, 0.03, variation, temperature)))
    assert found.verdict == "pass"
    assert found.s_um is None
    assert any(what.startswith("repeatability") for what in found.not_evaluated)


def test_the_repeats_bring_their_scatter_with_students_factor():
    found = gauge_check(repeats(399.9, 400.0, 400.1), certificate())
    assert (found.n, found.s_um, found.range_um) == (3, pytest.approx(0.1), pytest.approx(0.2))
    assert found.height.value_um == pytest.approx(400.0)
    assert repeatability(found) == (pytest.approx(0.1 / math.sqrt(3)), 2)
    u_um = math.hypot(0.04, 0.08, 0.1 / math.sqrt(3))
    freedom = u_um**4 / ((0.1 / math.sqrt(3)) ** 4 / 2)  # Welch-Satterthwaite: 23.1, for which t is 2.11
    assert found.height.freedom == pytest.approx(freedom)
    assert found.height.k == pytest.approx(2.11, abs=0.01)
    assert found.height.expanded_um == pytest.approx(found.height.k * u_um)
    assert all(not what.startswith("repeatability") for what in found.not_evaluated)


def test_a_scatter_known_from_before_is_pooled_unless_todays_is_much_larger():
    alone = gauge_check(repeats(400.0), certificate(), known=KnownTerms(0.1, 30))
    assert repeatability(alone) == (pytest.approx(0.1), 30)
    pooled = gauge_check(repeats(399.95, 400.05), certificate(), known=KnownTerms(0.1, 30))
    s_um = math.sqrt((30 * 0.01 + 0.005) / 31)
    assert repeatability(pooled) == (pytest.approx(s_um / math.sqrt(2)), 31)
    odd = gauge_check(repeats(399.0, 400.0, 401.0), certificate(), known=KnownTerms(0.01, 30))
    assert repeatability(odd) == (pytest.approx(1 / math.sqrt(3)), 2)


def test_the_reference_is_as_long_as_the_blocks_are_warm():
    found = gauge_check(repeats(400.0), certificate(), GaugeTerms(temperature_c=30.0))
    assert found.reference.value_um == pytest.approx(400 * (1 + 11.5e-6 * 10))
    assert any("temperature" in what for what in gauge_check(repeats(400.0), certificate()).not_evaluated)


def test_two_blocks_make_a_step_of_their_difference():
    blocks = (
        {"serial_number": "B", "nominal_um": 1400.0, "value_um": 1399.9, "expanded_um": 0.03},
        {"serial_number": "A", "nominal_um": 1000.0, "value_um": 1000.02, "expanded_um": 0.04},
    )
    from wafer_viewer.model.gauge import GaugeBlock

    of_blocks = certificate(
        blocks=tuple(GaugeBlock(**block) for block in blocks),
        nominal_um=None,
        value_um=None,
        expanded_um=None,
        serial_numbers=(),
    )
    assert of_blocks.step.value_um == pytest.approx(399.88)
    assert of_blocks.step.expanded_um == pytest.approx(0.05)
    assert of_blocks.step_nominal_um == 400
    assert of_blocks.serials == ("A", "B")


@pytest.mark.parametrize(
    ("certified", "calibration", "problem", "day", "message"),
    [
        (certificate(), CALIBRATION, "the calibration was due on 2026-05-01", DAY, "the calibration was due"),
        (certificate(), None, None, DAY, "without a calibration"),
        (certificate(), CALIBRATION, None, "2027-01-01", "expired on 2026-12-31"),
        (certificate(), replace(CALIBRATION, against="blocks A2, B7"), None, DAY, "Block A2 set the z scale"),
        (certificate(), replace(CALIBRATION, z_against=("a1",)), None, DAY, "Block A1 set the z scale"),
    ],
)
def test_an_invalid_check_is_refused_in_one_sentence(certified, calibration, problem, day, message):
    reported = refusal(certified, calibration, problem, day)
    assert reported is not None
    assert message in reported
    assert reported.count(". ") == 0
    assert reported.endswith(".")


def test_a_valid_certificate_of_other_blocks_is_not_refused():
    other = replace(CALIBRATION, against="blocks A10 and A22")
    assert refusal(certificate(), other, None, "2026-12-31") is None


@pytest.mark.parametrize(
    ("items", "message"),
    [
        ((), "no repeat yet"),
        ((repeat(400.0, 1), repeat(400.0, 1)), "is in the check already"),
        ((repeat(400.0, 1), repeat(400.0, 2, surface="mark-1")), "is in the check already"),
        ((repeat(400.0, 1), repeat(400.0, 2, calibration=None)), "calibrated otherwise"),
        ((repeat(350.0),), "these are other blocks"),
    ],
)
def test_what_makes_no_check_is_refused(items, message):
    with pytest.raises(MeasureError, match=message):
        gauge_check(items, certificate())


@pytest.mark.slow
def test_a_step_is_measured_as_a_repeat_and_not_upside_down():
    surface = gauge_blocks(1, correlation_px=2.0, simulated=True)
    found = gauge_repeat(surface, UPPER, LOWER, dataset="scan")
    assert found.height.value_um == pytest.approx(399.88, abs=0.2)
    assert found.simulated
    assert gauge_check([found], certificate()).simulated
    with pytest.raises(MeasureError, match="the other way round"):
        gauge_repeat(surface, LOWER, UPPER, dataset="scan")


def test_an_uncalibrated_surface_has_no_uncertainty_and_no_verdict():
    surface = gauge_blocks(1, correlation_px=2.0)
    bare = surface_of(surface.z_um, calibration=None, z_step_um=4.0)
    found = gauge_check([gauge_repeat(bare, UPPER, LOWER, dataset="s")], certificate(), GaugeTerms(limit_um=9.0))
    assert found.deviation.expanded_um is None
    assert (found.en, found.verdict, found.budget) == (None, "no verdict", ())


def test_u_covers_the_error_of_certificate_scale_and_scans():
    """1000 checks of five scans: certificate, block faces, z scale and scans each err as the budget says."""
    rng, covered, within = np.random.default_rng(7), 0, 0
    for _ in range(1000):
        certified = certificate(grade="1", expanded_um=0.1)
        true_um = 400.0 - rng.normal(0, 0.05) + rng.triangular(-0.16, 0, 0.16) - rng.triangular(-0.16, 0, 0.16)
        scaled_um = true_um * (1 + rng.normal(0, CALIBRATION.u_z_scale))
        in_each_um = rng.normal(0, 0.02)
        scans = scaled_um + in_each_um + rng.normal(0, 0.02, 5)
        found = gauge_check(repeats(*scans.tolist(), noise_um=0.02), certified)
        covered += abs(found.deviation.value_um - (scaled_um - true_um)) <= found.deviation.expanded_um
        within += abs(found.en) <= 1
    assert 930 <= covered <= 970
    assert 930 <= within <= 975
