"""The class of a defect follows from its shape, says why, and how sure it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from wafer_viewer.measure.defects.defect_builder import classify
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect_classes import RULES, ClassRules, DefectShape

PARTICLE = DefectShape(
    height_um=6.0, score=12.0, area_um2=80.0, major_um=10.0, minor_um=10.0, roughness_ratio=1.2, steepness=4.0
)
SHAPES: dict[str, dict[str, Any]] = {
    "particle": {},
    "pit": {"height_um": -4.0},
    "scratch": {"height_um": -1.3, "major_um": 90.0, "minor_um": 3.0},
    "residue": {"height_um": 16.0, "major_um": 140.0, "minor_um": 130.0, "steepness": 1.1},
    "edge chip": {"height_um": -15.0, "on_edge_fraction": 0.4},
    "missing die": {"height_um": -40.0, "mean_height_um": -30.0, "die_fraction": 0.97},
    "tilted die": {"height_um": 5.0, "die_fraction": 0.9, "die_tilt_mrad": 6.0},
    "bowed die": {"height_um": -1.8, "die_fraction": 1.0, "die_bow_um": -1.8},
    "discoloured die": {"die_fraction": 1.0, "die_brightness": -0.2},
    "unmeasured": {"unmeasured_fraction": 0.9},
    "pattern": {"evidence": "picture"},
}


@pytest.mark.parametrize("kind", SHAPES)
def test_each_class_has_its_shape_and_says_why(kind: str):
    found = classify(replace(PARTICLE, **SHAPES[kind]))
    assert found.kind == kind
    assert all(found.reasons)
    assert found.confidence > 0.8
    assert kind == "particle" or kind in RULES


def test_a_place_without_a_die_is_missing_whatever_its_tilt():
    empty = replace(PARTICLE, die_fraction=1.0, die_presence=0.0, die_tilt_mrad=9.0)
    assert classify(empty).kind == "missing die"
    assert "no die is seen there" in classify(empty).reasons


def test_a_gel_with_a_steep_rim_or_rough_or_sharp_in_the_picture_is_a_particle():
    gel = replace(PARTICLE, **SHAPES["residue"])
    assert classify(replace(gel, steepness=5.0)).kind == "particle"
    assert classify(replace(gel, roughness_ratio=6.0)).kind == "particle"
    assert classify(replace(gel, height_score=8.0, detail_score=9.0)).kind == "particle"


def test_what_the_heights_show_a_little_has_a_shape():
    faint = replace(PARTICLE, evidence="picture", height_um=-0.3, height_score=3.0, picture_score=6.0)
    assert classify(faint).kind == "pit"
    assert classify(replace(faint, height_score=1.5)).kind == "pattern"
    assert classify(replace(faint, height_score=1.5, major_um=60.0, minor_um=3.0)).kind == "scratch"


def test_without_heights_it_is_a_chip_on_an_edge_only():
    dark = replace(PARTICLE, evidence="picture", height_um=0.0, height_score=1.5, picture_score=7.0)
    assert classify(replace(dark, on_edge_fraction=0.3)).kind == "edge chip"
    assert classify(dark).kind == "pattern"
    assert classify(replace(dark, height_um=0.4, on_edge_fraction=0.3)).kind == "pattern"


def test_the_picture_tells_a_short_scratch_that_the_heights_show_blurred():
    short = replace(PARTICLE, height_um=-0.5, height_score=4.0, picture_score=7.0, picture_ratio=5.0)
    assert classify(short).kind == "scratch"
    assert classify(replace(short, height_score=9.0)).kind == "pit"


def test_a_raised_scratch_is_one_too():
    assert classify(replace(PARTICLE, major_um=90.0, minor_um=3.0)).kind == "scratch"


def test_the_reasons_bear_the_numbers():
    assert classify(replace(PARTICLE, **SHAPES["scratch"])).reasons == ("30.0 times as long as wide", "90 um long")


def test_a_shape_on_a_limit_is_unsure():
    on_limit = classify(replace(PARTICLE, major_um=18.8, minor_um=7.5))
    assert on_limit.kind == "scratch"
    assert on_limit.confidence == pytest.approx(0.5, abs=0.02)


def test_few_pixels_make_it_less_sure():
    small = replace(PARTICLE, pixel_um=4.0)
    assert classify(small).confidence < classify(PARTICLE).confidence


def test_a_recipe_may_move_the_limits():
    rules = ClassRules(scratch_ratio=50.0)
    assert classify(replace(PARTICLE, **SHAPES["scratch"]), rules).kind == "pit"


def test_limits_are_checked():
    with pytest.raises(MeasureError, match=r"ClassRules\.scratch_ratio is 0\.5: it must be at least 1"):
        ClassRules(scratch_ratio=0.5)
