"""What lies over the scene in a review: a defect compared, and all dies overlaid."""

from __future__ import annotations

import pytest

from tests.browser.sessions.inspected_session import PLANTED, found, repeating_session
from wafer_viewer.draw.charts.defect_charts import MOST_MARKS, die_stack_svg, shown
from wafer_viewer.gui.defects import die_views as stacked
from wafer_viewer.gui.defects import reference_view as beside
from wafer_viewer.gui.overlays.hud import SheetRoom
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.measure.defects.defect_builder import repeated_places
from wafer_viewer.model.spec import replace
from wafer_viewer.session.rendering.render_request import ComparisonView, ComparisonViews, DiePicture

INSPECTION = found(PLANTED)
DEFECT = INSPECTION.defects[0]
SMALL, LARGE = SheetRoom(626, 390), SheetRoom(862, 620)


@pytest.fixture(scope="module")
def repeating():
    session = repeating_session()
    session.close()
    return session.snapshot.inspection.inspection


def answer(*seen: ComparisonView) -> ComparisonViews:
    x0, y0, x1, y1 = DEFECT.outline.bounds_um
    return ComparisonViews(-2.0, 14.0, 1.0, (x0 - 20, y0 - 20, x1 + 20, y1 + 20), 0.5, seen)


@pytest.mark.parametrize("room", [SMALL, LARGE])
def test_three_pairs_and_their_bar_fit_the_scene(room: SheetRoom):
    sizes = beside.Sizes.within(room)
    assert 3 * sizes.width_px + beside.BAR_PX + 3 * beside.GAP_PX + 2 * beside.PAD_PX <= room.width_px
    assert sizes.panel_px <= room.height_px
    assert sizes.width_px / sizes.height_px == pytest.approx(4 / 3, rel=0.02)


def test_every_pair_says_what_it_is_and_has_the_outline_and_the_same_scale_bar():
    text = beside.comparison_html(
        DEFECT,
        answer(
            ComparisonView("here", b"h", b"p"),
            ComparisonView("dies", b"h", b"p", dies=9),
            ComparisonView("before", b"h", b"p", name="coupon-06", moved_um=(3.0, -1.5)),
        ),
        beside.Sizes.within(SMALL),
    )
    assert text.count("<img") == 6
    assert text.count("<polygon") == 12
    assert text.count("20\u202fµm</text>") == 6
    for words in ("Die -1,0", "median of 9", "coupon-06 · found 3.4\u202fµm off", "+10", "D1 · Particle"):
        assert words in text


def test_words_stand_where_there_is_nothing_to_compare_with():
    why = "No earlier scan of wafer <W> with a surface lies in the data folder."
    text = beside.comparison_html(
        DEFECT, answer(ComparisonView("here", b"h"), ComparisonView("before", why_not=why)), beside.Sizes.within(SMALL)
    )
    assert "wafer &lt;W&gt;" in text
    assert "Not measured here." in text
    assert "Heights over the middle of the place." in text


def test_all_dies_are_drawn_on_one_with_rings_where_a_place_repeats(repeating):
    places = repeated_places(repeating)
    assert [len(place.dies) for place in places] == [17, 4, 3]
    svg = die_stack_svg(repeating, places, "data:image/jpeg;base64,", chosen=1, place=0)
    assert svg.count("<title>Place ") == 3
    assert svg.count("<title>D") == len(repeating.found)
    assert 'aria-label="Place 1, in 17 of 20 whole dies"' in svg
    assert "<image" in svg
    assert die_stack_svg(replace(repeating, grid=None), places) == ""


def test_of_thousands_those_of_repeated_places_are_drawn_first(repeating):
    places = repeated_places(repeating)
    many = tuple(replace(DEFECT, number=1000 + k, score=900.0) for k in range(2000))
    crowded = replace(repeating, defects=(*repeating.defects, *many))
    drawn = shown(crowded, places)
    assert len(drawn) == MOST_MARKS
    assert {n for place in places for n in place.numbers} <= {defect.number for defect in drawn}
    assert f"{len(crowded.found) - MOST_MARKS} weaker ones are not drawn" in stacked.die_stack_html(
        crowded, places, None, (300, 300), None, None
    )


def test_the_list_names_places_dies_and_the_one_that_is_chosen(repeating):
    places = repeated_places(repeating)
    text = stacked.die_stack_html(repeating, places, DiePicture(b"p", 9), stacked.drawing_px(repeating, SMALL), None, 1)
    assert "Pattern<small>x 9" in text
    assert "<b>17</b><small>of 20 dies</small>" in text
    assert "Picture: median of 9 dies" in text
    assert text.count('class="go sel"') == 1
    assert stacked.place_of(places[1].numbers, places) == 1
    assert stacked.place_of((*places[2].numbers, 999), places) == 2
    assert stacked.place_of((), places) is None


def test_words_stand_where_nothing_repeats_or_there_are_no_dies(repeating):
    nothing = stacked.die_stack_html(
        INSPECTION, (), DiePicture(why_not="No die was scanned completely."), (300, 300), None, None
    )
    assert "No 3 dies have a defect at the same place." in nothing
    assert "No die was scanned completely." in nothing
    assert stacked.NO_DIES in stacked.die_stack_html(replace(INSPECTION, grid=None), (), None, (300, 300), None, None)
    width, height = stacked.drawing_px(repeating, SMALL)
    assert width + stacked.LIST_PX + 3 * stacked.PAD_PX <= SMALL.width_px
    assert height < SMALL.height_px


def test_a_sheet_lies_over_the_scene_in_a_review_alone():
    assert View(step="review", sheet="beside").sheet_over == "beside"
    assert View(step="measure", sheet="beside").sheet_over == "none"
    assert View(step="review", sheet="stack", why=(1.0, 2.0)).sheet_over == "none"
