"""A wafer is within its limits only where it was looked at."""

from __future__ import annotations

from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.inspection.defect_verdict import verdict_of


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
