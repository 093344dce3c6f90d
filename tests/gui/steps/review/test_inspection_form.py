"""The form of an inspection: there and back, what it says of false defects, recipes, golden dies and limits."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from html import unescape
from types import SimpleNamespace
from typing import Any

import pytest

from tests.browser.sessions.fake_defect_files import a_shelf
from tests.browser.sessions.inspected_session import GRID, PLANTED, found, inspected_session
from tests.gui.steps.test_steps import flat
from wafer_viewer.gui.elements.elements import Button, Html, Input
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.review.defect_form import (
    FORM,
    FOUND,
    GIVEN,
    GOLDEN,
    DefectForm,
    against_of,
    dies_of,
    form_of,
    limits_of,
    recipe_of,
    text_of,
    verdict,
)
from wafer_viewer.gui.steps.review.inspection_form import (
    PICKS,
    InspectionDraft,
    advanced_settings_header,
    expectation,
    golden_table,
    inspection_form,
    recipe_origin_text,
    unreadable,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.inspection.defect_classes import ClassRules
from wafer_viewer.model.inspection.die_grid import ProductDies
from wafer_viewer.model.spec import replace

INSPECTION = found(PLANTED)
KEPT = DefectRecipe(
    name="keen",
    product="LX-7",
    sensitivity=0.7,
    scales_px=(0.0, 2.5),
    evidence="picture",
    golden="lx7.2",
    min_area_px=9,
    rules=ClassRules(scratch_ratio=6.0),
    limits=DefectLimits(max_per_die=3, max_per_mm2=0.1),
)


def test_a_recipe_is_the_same_after_the_form():
    form = form_of(KEPT, None)
    assert (form.compare, form.golden, form.scales_px) == (GOLDEN, "lx7.2", "0, 2.5")
    assert recipe_of(form, KEPT) == KEPT
    assert recipe_of(form_of(DefectRecipe(), None), DefectRecipe()) == DefectRecipe()


def test_the_dies_of_an_inspection_stand_there_to_be_given_again():
    form = replace(form_of(DefectRecipe(), INSPECTION), dies=GIVEN)
    grid = dies_of(form)
    assert (grid.pitch_x_um, grid.width_um, grid.x0_um) == (GRID.pitch_x_um, GRID.width_um, GRID.x0_um)
    assert dies_of(replace(form, dies=FOUND)) == "found"
    assert dies_of(DefectForm()) is None
    assert (against_of(form), against_of(replace(form, compare=FORM))) == ("dies", "form")


def test_dies_without_a_size_are_as_large_as_their_pitch():
    grid = dies_of(DefectForm(dies=GIVEN, pitch_um="300 × 200", corner_um="0, 0", angle_deg=90.0))
    assert (grid.width_um, grid.height_um) == (300.0, 200.0)
    assert grid.angle_rad == pytest.approx(1.5708, abs=1e-4)


@pytest.mark.parametrize(
    ("form", "says"),
    [
        (DefectForm(dies=GIVEN), "The pitch of the dies is not given: type it"),
        (DefectForm(dies=GIVEN, pitch_um="0 × 9"), "Pitch, µm is 0: it must be over 0"),
        (DefectForm(dies=GIVEN, corner_um="0, 0"), "The pitch of the dies is not given"),
        (
            DefectForm(dies=GIVEN, pitch_um="9 × 9", corner_um="0, 0", size_um="10 × 9"),
            "a die is at most as large as the pitch",
        ),
    ],
)
def test_dies_that_are_none_are_told_in_a_sentence(form: DefectForm, says: str):
    with pytest.raises(MeasureError, match=says):
        dies_of(form)


@pytest.mark.parametrize(
    ("form", "says"),
    [
        (DefectForm(compare=GOLDEN), "No golden die is chosen"),
        (DefectForm(scales_px="0, wide"), "The scales '0, wide' are not numbers"),
        (DefectForm(scales_px="0, 41"), "at least one scale, each at most 40 px"),
        (DefectForm(scales_px="0", max_per_die="few"), "'few' is not a number of defects per die"),
        (DefectForm(scales_px="0", max_per_die="1.5"), "give a whole number"),
        (DefectForm(scales_px="0", max_per_mm2="-1"), "it must be at least 0"),
        (DefectForm(scales_px="0", max_per_mm2="nan"), "it must be at least 0"),
    ],
)
def test_a_form_that_makes_no_recipe_is_told_in_a_sentence(form: DefectForm, says: str):
    with pytest.raises(MeasureError, match=says):
        recipe_of(form, DefectRecipe())


def test_turning_the_dial_says_what_it_costs_here_and_on_a_whole_wafer():
    text = expectation(0.5, INSPECTION)
    assert "0.040 per mm², under 0.1 here, 2\u202f800 on a wafer of 300 mm" in text
    assert "2\u202f800" not in expectation(0.8, INSPECTION)
    assert "after the first inspection" in expectation(0.5, None)


def test_the_form_says_which_recipe_it_stands_for():
    shelf = a_shelf()
    standard = shelf.recipe_of("LX-7")
    assert standard is not None
    assert standard.name == "standard"
    assert recipe_origin_text(standard, standard, shelf, True) == "Recipe “standard” of LX-7, as saved."
    assert "Applied automatically" in recipe_origin_text(standard, standard, shelf, False)
    turned = replace(standard, sensitivity=0.9)
    assert "changed, not saved" in recipe_origin_text(standard, turned, shelf, False)
    assert "Matches no saved recipe of LX-7" in recipe_origin_text(
        DefectRecipe(), replace(turned, name=""), shelf, False
    )
    assert "As the surface was inspected" in recipe_origin_text(turned, turned, shelf, True)
    other = DefectRecipe(product="LX-9")
    assert "No recipe is saved for LX-9" in recipe_origin_text(other, other, shelf, False)
    assert "Without a product" in recipe_origin_text(other, DefectRecipe(), shelf, False)
    assert shelf.recipe_of("") is None
    assert unreadable(shelf) == ""
    assert unreadable(dataclasses.replace(shelf, problems=("torn",))).startswith("1 recipe file cannot be read")


def test_golden_dies_of_the_product_are_listed_and_the_newest_follows_its_name():
    table = golden_table(a_shelf(), "LX-7", "lx7")
    assert table.count("<tr class=") == 3
    assert 'data-k="lx7"' in table
    assert 'data-k="lx7.2"' in table
    assert "version 3, the newest" in table
    assert "1 of other products are not listed" in table
    assert "No golden die is saved" in golden_table(a_shelf(), "LX-9", "")


def test_what_is_folded_away_is_told_in_a_line():
    assert "no limits" in advanced_settings_header(form_of(DefectRecipe(), None), False)
    line = advanced_settings_header(form_of(KEPT, None), False)
    assert "Picture; filters 0, 2.5 px; dies: the job's, or found; at most 3 defects per die and 0.1" in unescape(line)
    assert "filters" not in advanced_settings_header(form_of(KEPT, None), True)


def test_limits_are_typed_and_lead_to_a_verdict():
    limits = limits_of(DefectForm(max_per_die="3", max_per_mm2=" 0.5 "))
    assert limits == DefectLimits(max_per_die=3, max_per_mm2=0.5)
    none = {"max_tilt_mrad": "", "max_offset_um": "", "max_bow_um": ""}
    assert text_of(limits) == {"max_per_die": "3", "max_per_mm2": "0.5", **none}
    assert limits_of(DefectForm(max_per_mm2=" ")) == DefectLimits()
    assert limits_of(DefectForm(max_tilt_mrad="4")) == DefectLimits(max_tilt_mrad=4)
    assert "98.4 % of 0.62 mm² inspected, compared with the median of the dies" in verdict(INSPECTION)
    assert "wv-note attention" in verdict(INSPECTION), "dies are not inspected, and no limits are set"
    beyond = verdict(replace(INSPECTION, recipe=DefectRecipe(limits=limits)))
    assert "Not within the limits" in beyond
    assert "so not clean" in beyond
    assert "per mm²," in beyond
    without_dies = replace(INSPECTION, grid=None, dies=(), recipe=DefectRecipe(limits=DefectLimits(max_per_die=9)))
    assert "No verdict: parts were not inspected" in verdict(without_dies)
    assert "give the pitch and a corner of the dies" in verdict(without_dies)
    scanned = tuple(replace(die, state="whole", defects=die.defects or 0) for die in INSPECTION.dies)
    loose = DefectLimits(max_per_die=9)
    assert "Within the limits" in verdict(replace(INSPECTION, dies=scanned, recipe=DefectRecipe(limits=loose)))


def here_of(**state: Any) -> Here[InspectionDraft]:
    session = inspected_session()
    snapshot = dataclasses.replace(
        session.snapshot, inspection=dataclasses.replace(session.snapshot.inspection, **state)
    )
    asked: list[Any] = []
    defects = SimpleNamespace(
        inspect=lambda *what: asked.append(("inspect", *what)) or Future(),
        limit=lambda limits: asked.append(("limit", limits)) or Future(),
    )
    page: Any = SimpleNamespace(session=SimpleNamespace(snapshot=snapshot, defects=defects), view=View(step="review"))
    page.answers, page.asked, page.redraw, page.ask = None, asked, lambda: None, lambda *_: None
    return Here(page, InspectionDraft(unfolded=True, shows_more=True))


def inputs(here: Here[InspectionDraft]) -> dict[str, Any]:
    return {one.label: one for one in flat(inspection_form(here)) if isinstance(one, Input | Button)}


@pytest.mark.campaign
def test_form_stands_there_until_the_surface_is_inspected_and_when_it_is_unfolded():
    assert "Inspect" in inputs(here_of())
    here = here_of()
    here.keep(unfolded=False)
    assert inspection_form(here) is None
    assert inspection_form(here_of(work="1")) is None
    first = here_of(inspection=None)
    first.keep(unfolded=False, shows_more=False)
    assert list(inputs(first)) == [
        *("Sensitivity", "Compare", "Inspect", "Kept as", "Product", "Save recipe…", "Recipes…")
    ]


@pytest.mark.slow
def test_form_is_filled_in_once_and_again_for_another_recipe():
    here = here_of()
    inputs(here)["Sensitivity"].put(0.9)
    assert inputs(here)["Sensitivity"].value == 0.9
    snapshot = here.snapshot
    recipe = replace(snapshot.inspection.inspection.recipe, sensitivity=0.2)
    again = replace(snapshot.inspection.inspection, recipe=recipe)
    here.snapshot = dataclasses.replace(snapshot, inspection=dataclasses.replace(snapshot.inspection, inspection=again))
    assert inputs(here)["Sensitivity"].value == 0.2


@pytest.mark.slow
def test_what_is_set_is_what_is_inspected():
    here = here_of()
    for label, value in (("Look at", "Picture"), ("Filters, px", "0, 3"), ("Compare", FORM), ("Sensitivity", 0.7)):
        inputs(here)[label].put(value)
    inputs(here)["Inspect"].act()
    ((verb, recipe, dies, against),) = here.page.asked
    assert (verb, recipe.evidence, recipe.scales_px, recipe.sensitivity) == ("inspect", "picture", (0.0, 3.0), 0.7)
    assert (dies, against) == (None, "form")


@pytest.mark.slow
def test_a_rectangle_between_equal_corners_of_two_dies_gives_the_pitch_to_search_by():
    here, told = here_of(), []
    assert inputs(here)["Dies"].value != GIVEN
    here.page.say = lambda *words: told.append(words)
    PICKS["defect-pitch"](here, "")
    assert told[0][1].startswith("Select a rectangle on the surface first, from a corner of a die to the same corner")
    here.page.view = replace(here.page.view, selection=(120.0, 80.5, 420.25, 280.5))
    PICKS["defect-pitch"](here, "")
    inputs(here)["Die, µm"].put("280 × 180")
    inputs(here)["Inspect"].act()
    assert here.page.asked[0][2] == ProductDies(pitch_x_um=300.25, pitch_y_um=200.0, width_um=280.0, height_um=180.0)


@pytest.mark.slow
def test_limits_are_sent_to_the_inspection_that_is_there_only():
    here = here_of()
    inputs(here)["Max. per die"].put("3")
    assert here.page.asked == [("limit", DefectLimits(max_per_die=3))]
    with pytest.raises(MeasureError, match="not a number of defects"):
        inputs(here)["Max. per mm²"].put("few")
    first = here_of(inspection=None)
    inputs(first)["Max. per die"].put("3")
    assert first.page.asked == []


@pytest.mark.slow
def test_given_dies_are_asked_for_and_what_makes_no_recipe_says_why():
    here = here_of()
    assert "Pitch, µm" not in inputs(here)
    inputs(here)["Dies"].put(GIVEN)
    assert {"Pitch, µm", "Corner, µm", "Die, µm", "Angle, °"} <= inputs(here).keys()
    inputs(here)["Filters, px"].put("wide")
    assert inputs(here)["Kept as"].value == "not kept"
    assert "are not numbers" in "".join(
        str(one.content) for one in flat(inspection_form(here)) if isinstance(one, Html)
    )
