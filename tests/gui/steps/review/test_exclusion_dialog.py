"""The areas of every die that are left out: how they are listed and drawn, and what is proposed for a defect."""

from __future__ import annotations

from tests.browser.sessions.inspected_session import PLANTED, found
from wafer_viewer.draw.charts.defect_charts import die_stack_svg
from wafer_viewer.gui.steps.review.defect_form import DefectForm, form_of, recipe_of
from wafer_viewer.gui.steps.review.dialogs import area_of_defect, area_table
from wafer_viewer.gui.steps.review.inspection_form import advanced_settings_header, areas, exclusion_line_html
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

SQUARE, ROUND = Region.rectangle(10.0, 20.0, 30.0, 44.0), Region.circle(50.0, 60.0, 8.0)
CORNER = Region.polygon((0.0, 0.0), (20.0, 0.0), (0.0, 20.0))


def test_the_form_keeps_them_there_and_back():
    recipe = DefectRecipe(excluded=(SQUARE, ROUND))
    form = form_of(recipe, None)
    assert form.excluded == (SQUARE, ROUND)
    assert recipe_of(form, DefectRecipe()) == recipe


def test_how_many_there_are_is_said_in_the_form_folded_or_not():
    assert areas(DefectForm()) == "the whole die is searched"
    assert "excluded" not in advanced_settings_header(DefectForm(), False)
    two = DefectForm(excluded=(SQUARE, ROUND))
    assert "2 areas of every die excluded" in advanced_settings_header(two, False)
    assert "1 area of every die excluded" in exclusion_line_html(DefectForm(excluded=(SQUARE,)))


def test_each_is_listed_with_its_extent_and_a_way_to_search_there_again():
    assert "The whole die is searched." in area_table(())
    table = area_table((SQUARE, ROUND))
    assert "10.0 – 30.0" in table
    assert "52.0 – 68.0" in table
    assert table.count('data-pick="defect-area-away"') == 2
    assert table.count('data-pick="defect-area-change"') == 1


def test_the_place_of_a_defect_lies_round_it_counted_from_its_die():
    defect = next(d for d in found(PLANTED).found if d.in_die is not None)
    (area,) = area_of_defect(defect)
    x0, y0, x1, y1 = area.bounds_um
    xa, ya, xb, yb = defect.outline.bounds_um
    assert defect.in_die is not None
    assert x0 < defect.in_die.x_um < x1
    assert y0 < defect.in_die.y_um < y1
    assert (x1 - x0) > (xb - xa)
    assert (y1 - y0) > (yb - ya)
    assert area_of_defect(None) == area_of_defect(replace(defect, in_die=None)) == ()


def test_they_are_veiled_where_all_dies_lie_on_one():
    inspection = found(PLANTED)
    assert "Left out" not in die_stack_svg(inspection, ())
    drawn = die_stack_svg(replace(inspection, recipe=DefectRecipe(excluded=(SQUARE, ROUND, CORNER))), ())
    assert drawn.count("Left out: not searched") == 3
    assert drawn.count("<ellipse") == 1
