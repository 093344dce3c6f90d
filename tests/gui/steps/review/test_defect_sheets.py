"""What lies over the scene in a review: a defect compared, and all dies overlaid."""

from __future__ import annotations

import dataclasses
import re
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from tests.browser.sessions.inspected_session import PLANTED, found, inspected_session, repeating_session
from tests.browser.sessions.inspected_states import whole_wafer
from tests.gui.steps.test_steps import Page
from tests.support.patience import until
from wafer_viewer.draw.charts.defect_charts import MOST_MARKS, die_stack_svg, shown
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.overlays.hud import SheetRoom
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.review import die_stack as stacked
from wafer_viewer.gui.steps.review import panes
from wafer_viewer.gui.steps.review.gallery import (
    defects_on_show,
    gallery_sheet,
    mark_all,
    marked_by_click,
    page_of,
    tile_clicked,
    tiles_in,
)
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
    x, y = DEFECT.center.x_um, DEFECT.center.y_um
    box, section = (x - 40, y - 40, x + 40, y + 40), (x - 30, y, x + 30, y)
    return ComparisonViews(-2.0, 14.0, 1.0, box, 0.5, seen, 12.0, 80.0, section)


def here_of(seen: ComparisonViews | None, **chosen: object) -> Here[None]:
    """A review of the first defect, with what the painter made of it."""
    session = inspected_session()
    session.close()
    made = SimpleNamespace(beside=lambda _: SimpleNamespace(result=lambda: seen))
    page: Any = Page(View(step="review", review="defect 1", **chosen))
    page.session = SimpleNamespace(snapshot=session.snapshot, defects=SimpleNamespace(views=made))
    here = Here(page, None)
    panes.compared(here)
    until(lambda: not panes.compared(here).computing)
    return here


HERE = ComparisonView("here", b"h", b"p", section=(1.0, 1.0, 15.0, 15.0, 1.0, 1.0), section_grey=(9.0,) * 6)
DIES = ComparisonView("dies", b"h", b"p", b"d", b"e", (1.0,) * 6, (99.0,) * 6, dies=9)
BEFORE = ComparisonView(
    "before", b"k", b"q", b"x", b"y", (2.0,) * 6, (9.0,) * 6, name="coupon-06", moved_um=(3.0, -1.5)
)


@pytest.mark.parametrize("room", [SMALL, LARGE, SheetRoom(360, 260)])
def test_place_reference_difference_and_their_bars_fit_the_scene(room: SheetRoom):
    sizes = panes.Sizes.within(room)
    assert sizes.large_px + sizes.small_px + panes.BAR_PX + 2 * panes.GAP_PX + 2 * panes.PAD_PX <= room.width_px + 1
    assert sizes.sheet_px <= room.height_px
    assert sizes.large_px == 2 * sizes.small_px + panes.GAP_PX


@pytest.mark.slow
def test_the_pictures_stand_at_one_scale_with_outline_section_and_length():
    text, height = panes.panes_sheet(here_of(answer(HERE, DIES)), LARGE)
    assert height <= LARGE.height_px
    assert text.count("<img") == 3
    assert text.count("data:image/jpeg;base64,aA==") == 2
    assert text.count("data:image/jpeg;base64,ZA==") == 1
    assert text.count("<polygon") == 6
    assert text.count("20\u202fµm</text>") == 3
    for words in ("die −1,0", "median of 9", "+10", "4 of 8"):
        assert words in text


@pytest.mark.campaign
def test_another_look_shows_greys_and_another_reference_the_last_scan():
    by_grey, _ = panes.panes_sheet(here_of(answer(HERE, DIES), pane="picture"), LARGE)
    assert by_grey.count("data:image/jpeg;base64,cA==") == 2
    assert by_grey.count("data:image/jpeg;base64,ZQ==") == 1
    both = answer(HERE, DIES, BEFORE)
    assert (
        "Last scan: coupon-06 · found 3.4\u202fµm off" in panes.panes_sheet(here_of(both, compared="before"), LARGE)[0]
    )
    assert "Other dies: median of 9" in panes.panes_sheet(here_of(both), LARGE)[0]
    assert panes.shows_grey(View(), replace(DEFECT, evidence="picture"))
    assert not panes.shows_grey(View(pane="height"), replace(DEFECT, evidence="picture"))


@pytest.mark.campaign
def test_words_stand_where_there_is_nothing_to_compare_with():
    why = "No earlier scan of wafer <W> with a surface lies in the data folder."
    text, _ = panes.panes_sheet(here_of(answer(HERE, ComparisonView("before", why_not=why))), SMALL)
    assert "wafer &lt;W&gt;" in text
    assert "Heights above the median of this place." in text
    text, _ = panes.panes_sheet(here_of(None), SMALL)
    assert "This place was not scanned." in text


@pytest.mark.slow
def test_the_section_is_levelled_to_the_reference_and_fills_the_plot():
    (dock,) = panes.section_dock(here_of(answer(HERE, DIES)))
    text = str(dock.content)
    assert text.count("wv-curve") == 2
    heights = [float(y) for path in re.findall(r'wv-curve" d="([^"]*)"', text) for y in re.findall(r" ([\d.]+)", path)]
    assert min(heights) < 100
    assert max(heights) > 900
    assert ">0</i>" in text  # the reference lies at zero
    assert "<rect" in text


@pytest.mark.slow
def test_a_click_selects_one_more_or_all_up_to_there_and_a_page_holds_the_one_under_review():
    here = here_of(answer(HERE))
    items, view = defects_on_show(here.snapshot, here.view), here.view
    keys = [item.key for item in items]
    assert marked_by_click(view, items, keys[0]) == ()
    assert marked_by_click(view, items, f"and {keys[0]}") == (1, items[0].defect)
    marked = dataclasses.replace(view, marked=(1, 2))
    assert marked_by_click(marked, items, "and defect 2") == (1,)
    assert set(marked_by_click(view, items, f"to {keys[0]}")) == {
        item.defect for item in items[: keys.index(view.review) + 1]
    }
    assert tile_clicked(here.page, f"and {keys[0]}") is None
    assert here.page.view.marked == (1, items[0].defect)
    assert tile_clicked(here.page, keys[2]) == keys[2]
    assert here.page.view.marked == ()
    mark_all(here.page)
    assert len(here.page.view.marked) == len(PLANTED)
    assert [item.key for item in page_of(items, keys[5], 4)] == keys[4:8]


@pytest.mark.campaign
def test_a_gallery_asks_for_pictures_of_the_tiles_that_are_seen_alone():
    here, asked = here_of(answer(HERE)), []
    session = whole_wafer(33, 1000)
    session.close()
    here.snapshot = here.page.session.snapshot = session.snapshot
    here.page.session.paint = lambda request: asked.append(request) or Future()
    here.view = dataclasses.replace(here.view, review=None)
    thumbnails = Thumbnails(here.page)
    text, height = gallery_sheet(here, thumbnails, SMALL)
    cols, rows = tiles_in(SMALL)
    assert text.count('data-pick="tile"') == cols * rows == len(asked)
    assert f"1 – {cols * rows} of {len(session.snapshot.inspection.defects)}" in text
    assert height <= SMALL.height_px
    last = defects_on_show(here.snapshot, here.view)[-1]
    here.view = dataclasses.replace(here.view, review=last.key)
    pending = list(thumbnails._requested.values())
    gallery_sheet(here, thumbnails, SMALL)
    assert all(future.cancelled() for future in pending)


@pytest.mark.slow
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


def test_a_review_opens_on_the_pictures_and_a_result_on_the_scene():
    assert View(step="review", review="defect 1").sheet_over == "beside"
    assert View(step="review", review="result 1").sheet_over == "none"
    assert View(step="measure", review="defect 1").sheet_over == "none"
    assert View(step="review", review="result 1", sheet="gallery").sheet_over == "gallery"
    assert View(step="review", sheet="stack", why=(1.0, 2.0)).sheet_over == "none"
