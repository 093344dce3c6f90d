"""Defects under review: how they are listed and gone through, and what is said where a list would mislead."""

from __future__ import annotations

import dataclasses

import pytest

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.inspected_session import PLANTED, found
from wafer_viewer.gui.page.preconditions import can_undo
from wafer_viewer.gui.page.work_steps import all_judged, possible
from wafer_viewer.gui.presenters.review import (
    alike,
    chosen_defect,
    first_changed,
    item_at,
    neighbour,
    number_of,
    review_items,
)
from wafer_viewer.gui.state.view_state import SORTS, DefectListing, View, listed
from wafer_viewer.gui.steps.review.defect_form import per_mm2, verdict
from wafer_viewer.gui.steps.review.defect_list import (
    MOST_ROWS,
    alone,
    facts,
    nothing_found,
    rows,
    rows_of,
    summary,
    unknown,
)
from wafer_viewer.gui.steps.review.review_step import classes, numbers_of
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.snapshot import Snapshot

INSPECTION = found(PLANTED)


def inspected(inspection=INSPECTION, **state: object) -> Snapshot:
    """A surface of which nothing else is under review."""
    return dataclasses.replace(fake.measured(), findings=(), inspection=InspectionState(inspection, **state))


def at(key: str | None, **listing: object) -> View:
    """A review of one item of a list."""
    return View(step="review", review=key, defects=DefectListing(**listing))


def signs(now: Snapshot, only="all", **listing: object) -> list[str]:
    return [item.sign for item in review_items(now, only, DefectListing(**listing))]


def test_defects_are_items_with_their_numbers_place_and_reasons():
    item = item_at(inspected(), "defect 1")
    assert (item.sign, item.title, item.shape) == ("D1", "Particle", "disc")
    assert ("Height from its surroundings", "+14.00", "0.40", "µm") in item.rows
    assert item.below.startswith("Die −1,0 · x ")
    assert "6 um high" in item.reason
    assert "6 µm high" in numbers_of(item)


def test_what_is_too_small_to_be_sized_has_no_size():
    small = replace(INSPECTION.defects[0], size_resolved=False)
    item = item_at(inspected(replace(INSPECTION, defects=(small,))), "defect 1")
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
    item = item_at(now, "defect 1")
    assert item.title == "Residue"
    assert "proposed: particle" in item.below
    assert signs(now, kind="residue") == ["D2", "D1"]


def test_one_goes_on_through_the_list_as_it_is_sorted_to_what_is_open():
    judged = replace(INSPECTION.defects[1], judgement="real")
    now = inspected(replace(INSPECTION, defects=(INSPECTION.defects[0], judged, *INSPECTION.defects[2:])))
    assert neighbour(now, at("defect 5"), 1).key != "defect 2"
    assert neighbour(now, at(neighbour(now, at("defect 2"), 1).key), -1).key == "defect 2"
    assert neighbour(now, at("defect 1", sort="height"), 1).key == "defect 6"


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
    assert "Parts were not inspected" in unknown(INSPECTION)
    assert "1 die not scanned" in unknown(INSPECTION)
    assert "2 dies cut" in unknown(INSPECTION)
    text = summary(InspectionState(INSPECTION)) + verdict(INSPECTION) + facts(INSPECTION)
    assert "No verdict: parts were not inspected" in text
    assert "Parts were not inspected" not in text, "it is said once"
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
    assert [look.key for look in DEFECT_CLASSES.values()] == [*(str(n) for n in range(1, 10)), "", "", "", ""]
    assert 'aria-pressed="true"' in classes(INSPECTION.defects[0])


def test_a_filter_by_size_height_or_confidence_lists_what_lies_within():
    assert signs(inspected(), least_size_um=60.0) == ["D5", "D2"]
    assert signs(inspected(), most_size_um=18.0) == ["D4"]
    assert signs(inspected(), most_height_um=-7.0) == ["D6", "D3"]
    assert signs(inspected(), least_height_um=8.0, kind="particle", die="-1,0") == ["D1"]
    unsure = replace(INSPECTION.defects[0], confidence=0.5)
    now = inspected(replace(INSPECTION, defects=(unsure, *INSPECTION.defects[1:])))
    assert "D1" not in signs(now, least_confidence=0.6)
    text = alone(DefectListing(least_size_um=60.0, die="0,0"), INSPECTION)
    assert "Die 0,0 (1 defect) · size ≥, µm 60 alone" in text
    assert alone(DefectListing(sort="die"), INSPECTION) == ""


def test_alike_are_the_selected_ones_else_open_ones_of_the_class_that_are_listed():
    now = inspected()
    assert alike(now, at("defect 1")) == (1, 4)
    assert alike(now, at("defect 1", die="-1,0")) == (1,)
    assert alike(now, dataclasses.replace(at("defect 1"), marked=(3, 6, 99))) == (3, 6)
    judged = replace(INSPECTION.defects[3], judgement="real")
    assert alike(inspected(replace(INSPECTION, defects=(*INSPECTION.defects[:3], judged))), at("defect 1")) == (1,)
    assert alike(now, at("result 1")) == ()


def test_what_a_change_was_of_is_found_again():
    before, judged = inspected(), replace(INSPECTION.defects[2], judgement="real")
    after = inspected(replace(INSPECTION, defects=(*INSPECTION.defects[:2], judged, *INSPECTION.defects[3:])))
    assert first_changed(before, after) == first_changed(after, before) == "defect 3"
    classed = replace(INSPECTION.defects[2], judged_kind="residue")
    after = inspected(replace(INSPECTION, defects=(*INSPECTION.defects[:2], classed, *INSPECTION.defects[3:])))
    assert first_changed(before, after) == "defect 3"
    assert first_changed(before, inspected()) is None


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
