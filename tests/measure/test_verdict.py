"""Verdicts at their limits: guard band, simple acceptance, what there is no verdict on, and what to do next."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.measure.surfaces import STEP_UM, gauge_blocks
from wafer_viewer.measure.verdict import (
    LESS_WITH_REPEATS,
    judge,
    judge_features,
    on_stage,
    overall,
    scans_needed,
    what_next,
)
from wafer_viewer.model.alignment import Alignment
from wafer_viewer.model.quantities import Contribution, Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.sample import Feature
from wafer_viewer.model.spec import replace

DIE = Feature(name="die", nominal_um=30.0, lower_limit_um=29.0, upper_limit_um=31.0)
SIMPLE = replace(DIE, decision_rule="simple_acceptance")


def height(value_um, expanded_um=0.25):
    return Length(value_um=value_um, expanded_um=expanded_um, status="evaluated")


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
    bare = judge(feature, Length(value_um=30.0, status="uncalibrated"))
    assert bare.word == "no verdict"
    assert "calibrat" in bare.why
    assert "larger regions" in judge(feature, Length(value_um=30.0)).why


def test_a_band_wider_than_the_tolerance_never_passes():
    assert judge(DIE, height(30.0, 1.2)).word == "inconclusive"


def test_the_gravest_word_is_that_of_the_wafer():
    good, bad, open_ = (judge(DIE, height(z)) for z in (30.0, 40.0, 29.0))
    none = judge(DIE, Length(value_um=30.0))
    assert overall([good, good]) == "pass"
    assert overall([good, open_]) == "inconclusive"
    assert overall([open_, none, good]) == "no verdict"
    assert overall([none, open_, bad]) == "fail"
    assert overall([]) == "no verdict"
    assert what_next([good]) == "Take the next wafer."
    assert "ask the engineer" in what_next([])


def with_budget(value_um, scale_um, noise_um):
    parts = (
        Contribution(name="z scale", u_um=scale_um),
        Contribution(name="noise and form of the faces", u_um=noise_um),
    )
    return judge(DIE, Length.evaluated(value_um, parts))


def test_what_noise_leaves_open_is_scanned_as_often_as_decides_it():
    item = with_budget(29.1, scale_um=0.01, noise_um=0.08)
    assert item.word == "inconclusive"
    n = scans_needed(item)
    assert 2 * math.hypot(0.01, 0.08 / math.sqrt(n)) <= 0.1 < 2 * math.hypot(0.01, 0.08 / math.sqrt(n - 1))
    assert f"{n - 1} times more: the mean of {n} scans" in what_next([item])
    assert "once more" in what_next([with_budget(29.1, 0.01, 0.06)])


def test_what_the_scale_leaves_open_no_repeat_decides():
    item = with_budget(29.1, scale_um=0.08, noise_um=0.05)
    assert scans_needed(item) is None
    assert "calibrate the z scale" in what_next([item, with_budget(29.1, 0.01, 0.06)])
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
    nominal_um=STEP_UM,
    lower_limit_um=STEP_UM - 2,
    upper_limit_um=STEP_UM + 2,
    upper=Region.rectangle(-150, -50, -40, 50),
    lower=Region.rectangle(40, -50, 150, 50),
)


def test_features_are_measured_where_the_wafer_lies():
    surface = gauge_blocks(1)
    straight = judge_features(surface, [BLOCKS, DIE], None, calibration_valid=True)
    assert [(item.feature.name, item.word) for item in straight] == [("blocks", "pass")]
    assert straight[0].height.value_um == pytest.approx(STEP_UM, abs=0.3)
    upside_down = Alignment(rotation_rad=math.pi)
    (turned,) = judge_features(surface, [BLOCKS], upside_down, calibration_valid=True)
    assert turned.word == "fail"
    assert turned.height.value_um == pytest.approx(-STEP_UM, abs=0.3)


def test_what_cannot_be_measured_has_no_verdict_and_says_why():
    nowhere = replace(BLOCKS, upper=Region.rectangle(9000, 0, 9100, 100))
    (item,) = judge_features(gauge_blocks(1), [nowhere], None, calibration_valid=True)
    assert (item.word, item.height) == ("no verdict", None)
    assert "'blocks' was not measured" in item.why
    (uncalibrated,) = judge_features(gauge_blocks(1), [BLOCKS], None, calibration_valid=False)
    assert uncalibrated.word == "no verdict"
    assert "calibrate" in what_next([uncalibrated])


def test_what_repeats_make_smaller_are_lines_of_a_steps_budget():
    (item,) = judge_features(gauge_blocks(1), [BLOCKS], None, calibration_valid=True)
    assert set(LESS_WITH_REPEATS) < {line.name for line in item.height.budget}
