"""A wafer is within its limits only where it was looked at."""

from __future__ import annotations

from tests.support.datasets.inspections import GRID, defect, inspection, lying
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe, verdict_of
from wafer_viewer.model.spec import replace


def test_dies_with_too_many_are_named():
    found = inspection(*(defect(n, "0,1" if n < 4 else "2,0", 10.0 * n, 5.0) for n in range(1, 6)))
    verdict = verdict_of(found, DefectLimits(max_per_die=2))
    assert (verdict.within, verdict.failing, verdict.counted) == (False, ("0,1",), 5)
    assert verdict.why == ("More than 2 defects on 1 die: 0,1.",)
    assert verdict_of(found, DefectLimits(max_per_die=3)).within


def test_the_density_is_of_what_was_inspected():
    found = inspection(defect(1, "0,0", 5.0, 5.0), defect(2, "0,0", 50.0, 5.0), inspected_mm2=4.0)
    assert verdict_of(found, DefectLimits(max_per_mm2=0.5)).within
    verdict = verdict_of(found, DefectLimits(max_per_mm2=0.4))
    assert verdict.why == ("0.5 defects per mm2, and 0.4 are allowed.",)


def test_a_nuisance_and_an_unmeasured_area_do_not_count():
    found = inspection(defect(1, "0,0", 5.0, 5.0, judgement="nuisance"), defect(2, "0,0", 50.0, 5.0, kind="unmeasured"))
    assert verdict_of(found, DefectLimits(max_per_die=0)).within


def test_a_die_that_was_not_scanned_is_not_within():
    verdict = verdict_of(inspection(states={"1,1": "not scanned", "0,1": "partly scanned"}))
    assert not verdict.within
    assert verdict.not_inspected == ("0,1", "1,1")
    assert verdict.why == ("Not or only partly scanned, so not clean: 0,1; 1,1.",)


def test_a_wafer_of_which_nothing_was_inspected_is_not_within():
    assert verdict_of(inspection(inspected_mm2=0.0)).why == ("Nothing was inspected.",)


def test_the_limits_of_the_recipe_hold_where_no_others_are_given():
    found = inspection(*(defect(n, "0,1", 10.0 * n, 5.0) for n in range(1, 4)))
    strict = DefectLimits(max_per_die=2)
    assert verdict_of(found).within
    of_recipe = inspection(*found.defects, recipe=DefectRecipe(limits=strict))
    assert verdict_of(of_recipe).failing == ("0,1",)
    assert DefectLimits(max_per_mm2=1.0).over(strict) == DefectLimits(max_per_die=2, max_per_mm2=1.0)
    assert (strict.are_set, DefectLimits().are_set) == (True, False)


def test_dies_that_lie_farther_off_than_allowed_are_named_with_their_numbers():
    found = inspection(measured={"0,1": lying(tilt_mrad=-4.0, bow_um=0.2), "1,0": lying(tilt_mrad=2.0, bow_um=-0.9)})
    assert verdict_of(found, DefectLimits(max_tilt_mrad=5.0, max_bow_um=1.0, max_offset_um=1.0)).within
    verdict = verdict_of(found, DefectLimits(max_tilt_mrad=3.0, max_bow_um=0.5))
    assert (verdict.word, verdict.failing) == ("fail", ("0,1", "1,0"))
    assert verdict.why == ("Tilt over 3 mrad: 0,1 (4).", "Bow over 0.5 um: 1,0 (0.9).")
    twice = inspection(measured={"0,1": lying(tilt_mrad=-4.0, bow_um=0.9)})
    assert len(verdict_of(twice, DefectLimits(max_tilt_mrad=3.0, max_bow_um=0.5)).why) == 2
    assert DefectLimits(max_tilt_mrad=1.0).over(DefectLimits(max_bow_um=2.0)).of_dies == {"tilt": 1.0, "bow": 2.0}


def test_defects_per_die_have_no_verdict_where_no_die_is_known():
    off_dies = replace(defect(1, "0,0", 5.0, 5.0), die="", in_die=None)
    loose = inspection(grid=None, dies=(), defects=(off_dies,), reference="form")
    verdict = verdict_of(loose, DefectLimits(max_per_die=0))
    assert (verdict.word, verdict.within) == ("no verdict", False)
    assert verdict.why == (
        "No die is known, so nothing per die can be judged: give the pitch and a corner of the dies, or limit the "
        "defects per mm2 instead.",
    )
    assert verdict_of(loose, DefectLimits(max_per_mm2=9.0)).word == "pass"
    assert verdict_of(loose, DefectLimits(max_per_die=0, max_per_mm2=0.1)).word == "fail"


def test_density_is_not_judged_where_no_area_was_inspected():
    verdict = verdict_of(inspection(inspected_mm2=0.0), DefectLimits(max_per_mm2=9.0))
    assert (verdict.word, verdict.why) == ("no verdict", ("Nothing was inspected.",))


def test_named_die_of_which_a_part_lies_beyond_the_scan_is_not_within():
    found = inspection(states={"2,1": "cut"})
    half = tuple(replace(die, measured_fraction=0.6) if die.name == "2,1" else die for die in found.dies)
    verdict = verdict_of(replace(found, dies=half), DefectLimits(max_per_die=3))
    assert (verdict.word, verdict.not_inspected) == ("no verdict", ("2,1",))
    at_a_rim = replace(found, dies=half, grid=replace(GRID, named=False))
    assert verdict_of(at_a_rim, DefectLimits(max_per_die=3)).word == "pass"
    assert verdict_of(found, DefectLimits(max_per_die=3)).word == "pass"


def test_too_many_defects_fail_even_where_other_dies_were_not_scanned():
    found = inspection(defect(1, "0,0", 5.0, 5.0), states={"1,1": "not scanned"})
    assert verdict_of(found, DefectLimits(max_per_die=0)).word == "fail"
    assert verdict_of(found, DefectLimits(max_per_die=1)).word == "no verdict"
