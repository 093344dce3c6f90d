"""The map of dies and the Pareto chart in Review: what is listed is on them, and what is chosen on them is listed."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace

import pytest

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.inspected_session import GRID, PLANTED, found
from tests.browser.sessions.inspected_states import wafer_of
from tests.support.datasets.inspections import inspection, lying
from wafer_viewer.draw.charts.die_map import die_frame
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.state.view_state import DefectListing, View, next_die, next_kind
from wafer_viewer.gui.steps.review import die_map as drawn_map
from wafer_viewer.gui.steps.review.defect_list import chart, pareto_html
from wafer_viewer.gui.steps.review.die_map import (
    MAP_PICKS,
    MOST_SIGNS,
    counts_of,
    die_at,
    die_map,
    fills_by_class,
    has_die_map,
    map_commands,
    map_html,
)
from wafer_viewer.gui.steps.review.judging import Review
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import InspectionState

INSPECTION = found(PLANTED)
ALL = DefectListing()


def judged(*numbers: int):
    """The defects, some of them judged."""
    return tuple(replace(d, judgement="real") if d.number in numbers else d for d in INSPECTION.defects)


class Reviewer:
    """A page with the map alone: what is chosen, and what is gone to."""

    def __init__(self, inspection=INSPECTION) -> None:
        self.view, self.gone_to, self.said = View(step="review"), [], []
        self.session, self.answers = SimpleNamespace(snapshot=None), None
        self.inspect(inspection)
        self.review = Review(self)
        self.here = Here(self, (self.review, lambda: None))

    def inspect(self, inspection, **state) -> None:
        state = InspectionState(inspection, **state)
        self.session.snapshot = dataclasses.replace(fake.measured(), findings=(), inspection=state)

    def entered(self) -> None:
        pass

    def redraw(self) -> None:
        pass

    def pick(self, what: str, key: str) -> None:
        MAP_PICKS[what](self.here, key)

    def change(self, **changes) -> None:
        if "review" in changes:
            self.gone_to.append(changes["review"])
        self.view = dataclasses.replace(self.view, **changes)

    def say(self, title, *_) -> None:
        self.said.append(title)

    def press(self, name: str) -> None:
        next(command for command in map_commands(self.review) if command.name == name).act()

    def show(self) -> str:
        self.here.snapshot, self.here.view = self.session.snapshot, self.view
        return str((die_map(self.here) or [None])[-1].content)


def test_keys_go_from_die_to_die_by_rows_from_the_top_to_those_with_open_defects():
    page = Reviewer()
    shown = []
    for _ in range(9):
        page.press("Next die with open defects")
        shown.append(page.view.defects.die)
    assert shown == ["-2,0", "-1,0", "0,0", "1,0", "-2,-1", "-1,-1", "0,-1", "1,-1", "-2,0"]
    page.press("Previous die with open defects")
    assert page.view.defects.die == "1,-1"
    assert page.gone_to[1] == "defect 1"
    page.inspect(replace(INSPECTION, defects=judged(*range(1, 9))))
    page.press("Next die with open defects")
    assert page.said == ["No die to go to"]


def test_a_die_whose_defects_are_judged_is_passed_over_and_left_in_its_place():
    assert next_die(judged(1), ALL, 1) == "-2,0"
    assert next_die(judged(1), DefectListing(die="-1,0"), 1) == "0,0"
    assert next_die(judged(1), DefectListing(die="-1,0"), -1) == "-2,0"
    assert next_die(judged(1), DefectListing(kind="particle"), 1) == "-2,-1"
    assert next_die(judged(*range(1, 9)), ALL, 1) is None


def test_a_key_lists_class_after_class_and_then_all():
    page = Reviewer()
    for kind in ["particle", "residue", "pit", "scratch", "edge chip", "pattern", "unmeasured", ""]:
        page.press("Show only the next class")
        assert page.view.defects.kind == kind
    assert next_kind(INSPECTION.defects, DefectListing(kind="tilted die")) == ""


def test_a_click_on_a_die_lists_it_alone_and_a_second_click_all():
    page = Reviewer()
    x, y = (float(um) for um in GRID.to_stage(1, 0, 50.0, 50.0))
    page.pick("defect-at", f"{x},{y}")
    assert (page.view.defects.die, page.gone_to) == ("1,0", ["defect 2"])
    assert "wv-die-on" in page.show()
    page.pick("defect-at", f"{x},{y}")
    assert page.view.defects.die == ""
    assert "wv-die-on" not in page.show()
    page.pick("defect-kind", "pit")
    assert page.view.lists_some
    page.pick("defect-all", "")
    assert not page.view.lists_some


def test_a_street_and_a_place_beside_the_dies_are_no_die():
    x, y = (float(um) for um in GRID.to_stage(1, 0, 50.0, 50.0))
    street_um = GRID.width_um + GRID.street_x_um / 2
    assert die_at(INSPECTION, x, y) == "1,0"
    assert die_at(INSPECTION, *(float(um) for um in GRID.to_stage(1, 0, street_um, 50.0))) == ""
    assert die_at(INSPECTION, x + 100 * GRID.pitch_x_um, y) == ""


def test_the_defect_under_review_stays_where_it_is_listed_still():
    page = Reviewer()
    page.change(review="defect 4")
    page.gone_to.clear()
    page.pick("defect-kind", "particle")
    assert page.gone_to == []
    page.pick("defect-kind", "pit")
    assert page.gone_to == ["defect 3"]


def test_the_map_is_drawn_again_only_when_something_of_it_changed(monkeypatch):
    drawn = []
    monkeypatch.setattr(drawn_map, "map_html", lambda *args: f"{len(drawn.append(1) or drawn)}")
    page = Reviewer()
    page.show()
    page.change(review="defect 3")
    page.show()
    page.change(defects=DefectListing(sort="height"))
    page.show()
    assert len(drawn) == 1
    page.change(defects=DefectListing(map_by="count"))
    page.show()
    page.inspect(replace(INSPECTION, defects=judged(1)))
    page.show()
    assert len(drawn) == 3


def test_there_is_no_map_of_dies_elsewhere_or_without_dies():
    page = Reviewer()
    assert has_die_map(page.session.snapshot, page.view)
    assert not has_die_map(page.session.snapshot, View(step="surface"))
    page.inspect(replace(INSPECTION, grid=None, dies=()))
    assert not has_die_map(page.session.snapshot, page.view)
    assert die_map(Here(page, page.here.own)) is None


def test_by_class_every_defect_has_its_sign_and_by_count_every_die_its_number():
    frame = die_frame(INSPECTION)
    by_class = map_html(frame, INSPECTION, judged(1), ALL)
    assert len(re.findall("data-d=", by_class)) == len(PLANTED)
    assert "D1 · Particle, real defect" in by_class
    by_count = map_html(frame, INSPECTION, INSPECTION.defects, DefectListing(map_by="count"))
    assert "data-d=" not in by_count
    assert by_count.count("</text>") == 7  # an area without heights is no defect
    assert "12 clean" in by_count
    assert "1 not scanned" in by_count


def test_by_tilt_every_measured_die_has_its_number_and_the_farthest_are_listed_with_u():
    found = inspection(measured={"0,1": lying(tilt_mrad=-4.0), "1,0": lying(tilt_mrad=2.0, bow_um=0.9)})
    frame = die_frame(found)
    by_tilt = map_html(frame, found, (), DefectListing(map_by="tilt"))
    assert sorted(float(text) for text in re.findall(r">([\d.]+)</text>", by_tilt)) == [2.0, 4.0]
    rows = re.findall(r"<tr.*?</tr>", by_tilt, re.DOTALL)
    assert ("0,1" in rows[1], "-4.00 ± 0.20" in rows[1], "+3.1" in rows[1]) == (True, True, True)
    assert "0.900 ± 0.040" in rows[2]
    assert "No die was measured" in map_html(frame, inspection(), (), DefectListing(map_by="bow"))


def test_what_is_not_listed_is_not_on_the_map():
    page = Reviewer()
    page.change(defects=DefectListing(kind="pit"))
    assert page.show().count("data-d=") == 1
    page.change(defects=DefectListing(die="0,0"))
    assert page.show().count("data-d=") == len(PLANTED)  # other dies are still to be seen and chosen


@pytest.mark.slow
def test_of_too_many_defects_each_die_has_the_colour_of_its_commonest_class():
    wafer = wafer_of(17, 640)
    assert len(wafer.defects) > MOST_SIGNS
    text = map_html(die_frame(wafer), wafer, wafer.defects, ALL)
    assert "data-d=" not in text
    assert "commonest class" in text
    fills = fills_by_class(INSPECTION.defects)
    assert fills["0,0"].colour == DEFECT_CLASSES["scratch"].colour


def test_an_area_without_heights_counts_as_no_defect_in_map_and_chart():
    assert counts_of(INSPECTION.defects)["-2,0"] == 0
    rows = re.findall(r"</svg> ([A-Z][a-z ]+)</span>.*?<b>(\d+)</b><small>(.*?)</small>", pareto())
    assert rows[0] == ("Particle", "2", "29 %")
    assert rows[-2][2] == "100 %"
    assert rows[-1] == ("Unmeasured", "1", "")


@pytest.mark.parametrize("kind", ["pit", "unmeasured"])
def test_the_class_that_is_listed_alone_is_pressed(kind):
    pressed = re.findall(r'aria-pressed="true" data-pick="defect-kind" data-k="([a-z ]+)"', pareto(kind))
    assert pressed == [kind]


def test_the_chart_goes_by_the_operators_word():
    text = (replace(INSPECTION.defects[0], judged_kind="residue"), *INSPECTION.defects[1:])
    assert re.search(r"Residue</span>.*?<b>2</b>", pareto_html(text, ""))
    assert pareto_html((), "") == ""


def test_the_chart_is_of_what_is_listed_of_every_class():
    state = InspectionState(replace(INSPECTION, defects=judged(1, 3)))
    real = chart(state, DefectListing(kind="pit"), "accepted")
    assert re.findall(r'data-k="([a-z ]+)"', real) == ["particle", "pit"]
    assert chart(state, DefectListing(die="0,0"), "accepted") == ""
    assert chart(state, DefectListing(sort="height"), "all") is chart(state, ALL, "all")


def pareto(kind: str = "") -> str:
    return pareto_html(INSPECTION.defects, kind)
