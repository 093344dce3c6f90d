"""Verdicts at their limits: guard band, simple acceptance, what there is no verdict on, and what to do next."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support.bumped_surface import HEIGHT_UM, bumped
from tests.support.surfaces import STEP_UM, gauge_blocks
from wafer_viewer.measure.base.measurement_context import LESS_WITH_REPEATS
from wafer_viewer.measure.verdict import (
    judge,
    judge_dies,
    judge_features,
    next_action,
    not_judged,
    on_stage,
    overall,
    scans_needed,
)
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import WaferVerdict
from wafer_viewer.model.measurement.feature import Die, Dies, Feature
from wafer_viewer.model.quantity import Contribution, Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

DIE = Feature(name="die", nominal=30.0, lower_limit=29.0, upper_limit=31.0)
SIMPLE = replace(DIE, decision_rule="simple_acceptance")


def height(value_um, expanded_um=0.25):
    return Quantity(value=value_um, unit="um", expanded=expanded_um, status="evaluated")


@pytest.mark.parametrize(
    ("value_um", "word"),
    [
        (30.0, "pass"),
        (29.25, "pass"),
        (29.2499, "inconclusive"),
        (29.0, "inconclusive"),
        (28.75, "inconclusive"),
        (28.7499, "fail"),
        (30.75, "pass"),
        (30.7501, "inconclusive"),
        (31.25, "inconclusive"),
        (31.2501, "fail"),
    ],
)
def test_the_guard_band_lies_within_and_beyond_each_limit(value_um, word):
    assert judge(DIE, height(value_um)).word == word


@pytest.mark.parametrize(("value_um", "word"), [(29.0, "pass"), (28.9999, "fail"), (31.0, "pass"), (31.0001, "fail")])
def test_simple_acceptance_looks_at_the_value_alone(value_um, word):
    assert judge(SIMPLE, height(value_um)).word == word


@pytest.mark.parametrize("feature", [DIE, SIMPLE])
def test_without_an_uncertainty_there_is_no_verdict_and_it_says_why(feature):
    bare = judge(feature, Quantity(value=30.0, unit="um", status="uncalibrated"))
    assert bare.word == "no verdict"
    assert "calibrat" in bare.why
    assert "larger regions" in judge(feature, Quantity(value=30.0, unit="um")).why


def test_a_band_wider_than_the_tolerance_never_passes():
    assert judge(DIE, height(30.0, 1.2)).word == "inconclusive"


def test_the_gravest_word_is_that_of_the_wafer():
    good, bad, open_ = (judge(DIE, height(z)) for z in (30.0, 40.0, 29.0))
    none = judge(DIE, Quantity(value=30.0, unit="um"))
    assert overall([good, good]) == "pass"
    assert overall([good, open_]) == "inconclusive"
    assert overall([open_, none, good]) == "no verdict"
    assert overall([none, open_, bad]) == "fail"
    assert overall([]) == "no verdict"
    assert next_action([good]) == "Take the next wafer."
    assert "ask the engineer" in next_action([])


def with_budget(value_um, scale_um, noise_um):
    parts = (
        Contribution(name="z scale", u_um=scale_um),
        Contribution(name="noise and form of the faces", u_um=noise_um),
    )
    return judge(DIE, Length.evaluated(value_um, parts).quantity)


def test_what_noise_leaves_open_is_scanned_as_often_as_decides_it():
    item = with_budget(29.1, scale_um=0.01, noise_um=0.08)
    assert item.word == "inconclusive"
    n = scans_needed(item)
    assert 2 * math.hypot(0.01, 0.08 / math.sqrt(n)) <= 0.1 < 2 * math.hypot(0.01, 0.08 / math.sqrt(n - 1))
    assert f"{n - 1} times more: the mean of {n} scans" in next_action([item])
    assert "once more" in next_action([with_budget(29.1, 0.01, 0.06)])


def test_what_the_scale_leaves_open_no_repeat_decides():
    item = with_budget(29.1, scale_um=0.08, noise_um=0.05)
    assert scans_needed(item) is None
    assert "calibrate the z scale" in next_action([item, with_budget(29.1, 0.01, 0.06)])
    assert scans_needed(with_budget(29.0005, scale_um=0.0, noise_um=0.05)) is None


def test_a_region_of_the_wafer_is_found_on_the_stage():
    turned = Alignment(rotation_rad=math.pi / 2, shift_x_um=5.0)
    region = on_stage(Region.rectangle(10, 0, 30, 10), turned)
    x, y = turned.to_stage(20.0, 5.0)
    assert region.contains(np.array([x]), np.array([y])).all()
    x, y = turned.to_stage(31.0, 5.0)
    assert not region.contains(np.array([x]), np.array([y])).any()
    assert on_stage(region, None) is region
    assert on_stage(Region.circle(1, 2, 3), turned).radius_um == 3


BLOCKS = Feature(
    name="blocks",
    nominal=STEP_UM,
    lower_limit=STEP_UM - 2,
    upper_limit=STEP_UM + 2,
    places=(Region.rectangle(-150, -50, -40, 50), Region.rectangle(40, -50, 150, 50)),
)


def test_features_are_measured_where_the_wafer_lies():
    surface = gauge_blocks(1)
    straight = judge_features(surface, [BLOCKS, DIE], None, calibration_valid=True)
    assert [(item.feature.name, item.word) for item in straight] == [("blocks", "pass")]
    assert straight[0].measured.value == pytest.approx(STEP_UM, abs=0.3)
    upside_down = Alignment(rotation_rad=math.pi)
    (turned,) = judge_features(surface, [BLOCKS], upside_down, calibration_valid=True)
    assert turned.word == "fail"
    assert turned.measured.value == pytest.approx(-STEP_UM, abs=0.3)


def test_an_unmeasurable_feature_has_no_verdict_but_a_reason():
    nowhere = replace(BLOCKS, places=(Region.rectangle(9000, 0, 9100, 100), BLOCKS.places[1]))
    (item,) = judge_features(gauge_blocks(1), [nowhere], None, calibration_valid=True)
    assert (item.word, item.measured) == ("no verdict", None)
    assert "'blocks' was not measured" in item.why
    (uncalibrated,) = judge_features(gauge_blocks(1), [BLOCKS], None, calibration_valid=False)
    assert uncalibrated.word == "no verdict"
    assert "calibrate" in next_action([uncalibrated])


def test_what_repeats_make_smaller_are_lines_of_a_steps_budget():
    (item,) = judge_features(gauge_blocks(1), [BLOCKS], None, calibration_valid=True)
    assert len(set(LESS_WITH_REPEATS) & {line.name for line in item.measured.budget}) >= 2


TWO_DIES = Dies(
    width_um=150.0, height_um=50.0, listed=(Die(name="low", x_um=-75, y_um=-55), Die(name="high", x_um=-75, y_um=5))
)
ON_A_DIE = replace(
    BLOCKS, per_die=True, places=(Region.rectangle(5, 5, 65, 45), Region.rectangle(85, 5, 145, 45)), name="pair"
)


def test_a_feature_of_a_die_is_measured_on_every_die_and_each_die_has_its_word():
    items = judge_features(gauge_blocks(1), [ON_A_DIE], None, calibration_valid=True, dies=TWO_DIES)
    assert [(item.name, item.word) for item in items] == [("pair, die low", "pass"), ("pair, die high", "pass")]
    assert items[0].measured != items[1].measured
    worse = (items[0], replace(items[1], word="fail"))
    assert [(die.name, die.x_um, die.word) for die in judge_dies(worse, TWO_DIES)] == [
        ("low", -75, "pass"),
        ("high", -75, "fail"),
    ]
    verdict = WaferVerdict(word=overall(worse), next="", items=worse, dies=judge_dies(worse, TWO_DIES))
    assert (verdict.word, verdict.die_counts) == ("fail", {"fail": 1, "pass": 1})


def test_dies_lie_on_a_lattice_or_where_they_are_listed():
    lattice = Dies(width_um=1.0, height_um=1.0, rows=2, cols=2, pitch_x_um=3.0, pitch_y_um=4.0, left_out=("1,0",))
    assert [(die.name, die.x_um, die.y_um) for die in lattice.all()] == [
        ("0,0", 0.0, 0.0),
        ("0,1", 0.0, 4.0),
        ("1,1", 3.0, 4.0),
    ]
    with pytest.raises(PlanError, match="not both"):
        replace(lattice, listed=(Die(name="a", x_um=0.0, y_um=0.0),))
    with pytest.raises(PlanError, match="no two alike"):
        replace(TWO_DIES, listed=TWO_DIES.listed * 2)


FLAT = Feature(name="face", tool="flatness", quantity="flt_q", upper_limit=3.0, places=(BLOCKS.places[0],))
WAY = (Region.point(-100, 0), Region.point(100, 0))
FALL = Feature(name="fall", tool="distance", quantity="dz", unit="um", upper_limit=-390.0, places=WAY)

OVER_ALL_BUMPS = Dies(width_um=420.0, height_um=420.0, listed=(Die(name="A1", x_um=-210.0, y_um=-210.0),))


@pytest.fixture(scope="module")
def bumps():
    return bumped()


def test_any_quantity_of_any_tool_is_judged_against_a_limit_that_may_be_open():
    (item,) = judge_features(gauge_blocks(1), [FALL], None, calibration_valid=True)
    assert item.word == "pass"
    assert item.measured.value == pytest.approx(-STEP_UM, abs=8)
    (beyond,) = judge_features(gauge_blocks(1), [replace(FALL, upper_limit=-500.0)], None, calibration_valid=True)
    assert (beyond.word, beyond.why) == ("fail", "Over the upper limit.")


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("quantity", "limits", "word"),
    [
        ("mean_height", {"lower_limit": HEIGHT_UM - 0.5, "upper_limit": HEIGHT_UM + 0.5}, "pass"),
        ("mean_height", {"lower_limit": HEIGHT_UM + 0.5}, "fail"),
        ("", {"upper_limit": 2.0}, "fail"),
        ("", {"upper_limit": 5.0}, "pass"),
        ("height_range", {"upper_limit": 2.0}, "fail"),
        ("height_range", {"upper_limit": 5.0}, "pass"),
    ],
)
def test_heights_of_bumps_and_their_coplanarity_are_judged_on_a_die(bumps, quantity, limits, word):
    """One of 100 bumps is 3 um too high."""
    whole = (Region.rectangle(10, 10, 410, 410),)
    feature = Feature(name="bumps", tool="coplanarity", quantity=quantity, per_die=True, places=whole, **limits)
    (item,) = judge_features(bumps.surface, [feature], None, calibration_valid=True, dies=OVER_ALL_BUMPS)
    assert (item.name, item.word) == ("bumps, die A1", word)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"quantity": "sa"}, "no quantity 'sa': choose one of flt_t, flt_q"),
        ({"unit": "deg"}, "in um and the limits of 'face' are in deg"),
    ],
)
def test_a_quantity_that_is_not_there_or_in_another_unit_has_no_verdict(change, words):
    (item,) = judge_features(gauge_blocks(1), [replace(FLAT, **change)], None, calibration_valid=True)
    assert item.word == "no verdict"
    assert words in item.why


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"upper_limit": None}, "or else lower_limit"),
        ({"lower_limit": 4.0}, "over the lower limit 4 um"),
        ({"places": BLOCKS.places}, r"measured at face \(rectangle\); rectangle, rectangle are given"),
        ({"tool": "point"}, "tool 'point' is measured at point"),
    ],
)
def test_a_feature_that_nothing_can_be_measured_by_is_refused(change, words):
    with pytest.raises(PlanError, match=words):
        replace(FLAT, **change)


def test_feature_without_a_place_or_a_die_has_no_verdict():
    nowhere, without_dies = not_judged([DIE, BLOCKS, ON_A_DIE], None)
    assert (nowhere.word, nowhere.why) == ("no verdict", "'die' has no place to be measured at: give it one.")
    assert (without_dies.word, without_dies.feature) == ("no verdict", ON_A_DIE)
    assert without_dies.why == "'pair' is measured on every die, and the job has none: name its dies."
    assert not_judged([BLOCKS, ON_A_DIE], TWO_DIES) == ()
