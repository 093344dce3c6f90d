"""Defects under review: how they are listed and gone through, and what is said where a list would mislead."""

from __future__ import annotations

import dataclasses

import pytest

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.inspected_session import PLANTED, found
from wafer_viewer.gui.page.preconditions import can_undo
from wafer_viewer.gui.page.work_steps import all_judged, possible
from wafer_viewer.gui.presenters.defects import (
    MOST_ROWS,
    chosen_defect,
    classes,
    cut_through,
    facts,
    nothing_found,
    number_of,
    per_mm2,
    rows,
    rows_of,
    summary,
)
from wafer_viewer.gui.presenters.review import chosen_item, neighbour, numbers, review_items
from wafer_viewer.gui.state.view_state import SORTS, DefectListing, View, listed
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.snapshot import Snapshot

INSPECTION = found(PLANTED)


def inspected(inspection=INSPECTION, **state: object) -> Snapshot:
    """A surface of which nothing else is under review."""
    return dataclasses.replace(fake.measured(), findings=(), inspection=InspectionState(inspection, **state))


def signs(now: Snapshot, only="all", **listing: object) -> list[str]:
    return [item.sign for item in review_items(now, only, DefectListing(**listing))]


def test_defects_are_items_with_their_numbers_place_and_reasons():
    item = chosen_item(inspected(), "defect 1")
    assert (item.sign, item.title, item.shape) == ("D1", "Particle", "disc")
    assert ("Height from its surroundings", "+14.00", "0.40", "µm") in item.rows
    assert item.below.startswith("Die -1,0 · x ")
    assert "6 um high" in item.reason
    assert "6 µm high" in numbers(item)


def test_what_is_too_small_to_be_sized_has_no_size():
    small = replace(INSPECTION.defects[0], size_resolved=False)
    item = chosen_item(inspected(replace(INSPECTION, defects=(small,))), "defect 1")
    assert [row[0] for row in item.rows] == ["Height from its surroundings"]
    assert "detected, size not resolved" in item.reason


@pytest.mark.parametrize(
    ("sort", "first", "second"),
    [("size", "D5", "D2"), ("height", "D1", "D6"), ("class", "D6", "D1"), ("die", "D1", "D5")],
)
def test_defects_are_sorted_and_areas_without_heights_come_last(sort, first, second):
    order = signs(inspected(), sort=sort)
    assert order[:2] == [first, second]
    assert order[-1] == "D8"


def test_every_way_of_sorting_keeps_every_defect():
    assert {len(listed(INSPECTION.defects, DefectListing(sort=sort))) for sort in SORTS} == {len(PLANTED)}


def test_a_class_a_die_or_what_was_judged_can_be_listed_alone():
    judged = replace(INSPECTION.defects[0], judgement="nuisance")
    now = inspected(replace(INSPECTION, defects=(judged, *INSPECTION.defects[1:])))
    assert signs(now, kind="particle") == ["D4", "D1"] or signs(now, kind="particle") == ["D1", "D4"]
    assert signs(now, die="0,0") == ["D5"]
    assert signs(now, "rejected") == ["D1"]
    assert "D1" not in signs(now, "open")


def test_the_class_that_a_person_gave_counts():
    text = replace(INSPECTION.defects[0], judged_kind="residue")
    now = inspected(replace(INSPECTION, defects=(text, *INSPECTION.defects[1:])))
    item = chosen_item(now, "defect 1")
    assert item.title == "Residue"
    assert "proposed: particle" in item.below
    assert signs(now, kind="residue") == ["D2", "D1"]


def test_one_goes_on_through_the_list_as_it_is_sorted_to_what_is_open():
    judged = replace(INSPECTION.defects[1], judgement="real")
    now = inspected(replace(INSPECTION, defects=(INSPECTION.defects[0], judged, *INSPECTION.defects[2:])))
    assert neighbour(now, "defect 5", 1).key != "defect 2"
    assert neighbour(now, neighbour(now, "defect 2", 1).key, -1).key == "defect 2"
    by_height = DefectListing(sort="height")
    assert neighbour(now, "defect 1", 1, "all", by_height).key == "defect 6"


def test_thousands_are_shown_a_page_at_a_time_with_the_one_under_review():
    many = tuple(replace(INSPECTION.defects[0], number=n) for n in range(1, 3001))
    items = review_items(inspected(replace(INSPECTION, defects=many)))
    shown = rows_of(items, items[1234])
    assert len(shown) == MOST_ROWS
    assert items[1234] in shown
    text = rows(items, shown, items[1234], [""] * len(shown))
    assert "before …" in text
    assert f"{3000 - items.index(shown[-1]) - 1} more …" in text


def test_a_die_that_was_not_inspected_never_looks_clean():
    text = summary(InspectionState(INSPECTION)) + facts(INSPECTION)
    assert "Not all of it was inspected" in text
    assert "1 die not scanned" in text
    assert "2 dies cut" in text
    assert "SIMULATED" in text
    assert "7 on 0.61 mm²" in text
    empty = replace(INSPECTION, defects=(), inspected_mm2=0.0)
    assert "does not mean that the wafer is clean" in nothing_found(empty)
    assert "No defect was found" in nothing_found(replace(empty, inspected_mm2=0.5))


def test_what_stands_against_the_list_is_said():
    assert "reconstructed since" in summary(InspectionState(INSPECTION, stale=True))
    assert "has no period" in summary(InspectionState(problem="The surface has no period: give the dies."))


def test_the_expected_false_count_is_shown_from_the_data():
    assert per_mm2(INSPECTION.expected_false_at(0.5)) == "0.040 per mm²"
    assert per_mm2(None) == "not known before an inspection"
    assert per_mm2(1e-6).startswith("under")


def test_classes_differ_by_shape_as_well_as_by_colour_and_have_keys():
    assert len({look.shape for look in DEFECT_CLASSES.values()}) == len(DEFECT_CLASSES)
    assert sorted(look.key for look in DEFECT_CLASSES.values()) == [str(n) for n in range(1, 10)]
    assert 'aria-pressed="true"' in classes(INSPECTION.defects[0])


def test_the_section_runs_through_the_defect_and_through_the_same_place_of_a_good_die():
    defect = INSPECTION.defects[0]
    cut = cut_through(defect, INSPECTION, 0.5)
    (a, b), (c, _) = (line.points for line in cut.lines)
    assert ((a.x_um + b.x_um) / 2, a.y_um) == pytest.approx((defect.center.x_um, defect.center.y_um))
    assert b.x_um - a.x_um >= 2 * defect.major.value_um
    assert cut.neighbour != defect.die
    grid = INSPECTION.grid
    assert (c.x_um - a.x_um) % grid.pitch_x_um == pytest.approx(0.0, abs=1e-6) or c.x_um != a.x_um
    alone = replace(INSPECTION, dies=(), grid=None)
    assert len(cut_through(defect, alone, 0.5).lines) == 1


def test_a_review_is_possible_with_a_surface_and_ends_when_every_defect_is_judged():
    now = inspected()
    assert possible("review", now)
    assert not all_judged(now)
    judged = replace(INSPECTION, defects=tuple(replace(d, judgement="real") for d in INSPECTION.defects))
    assert all_judged(inspected(judged))


def test_undo_is_that_of_what_is_under_review():
    now = inspected(can_undo=True)
    assert can_undo(now, View(step="review", review="defect 1"))
    assert not can_undo(now, View(step="review", review="result 1"))
    assert (number_of("defect 12"), number_of("result 12"), number_of("defect x")) == (12, None, None)
    assert chosen_defect(now, "defect 99") is None


def test_a_curve_has_room_below_the_scene_while_a_defect_is_under_review():
    assert View(step="review", review="defect 1").below == "defect"
    assert View(step="review", review="result 1").below == "none"
    assert View(step="surface", review="defect 1").below == "none"
