"""Live at the bench: words of the script, steps, picture, focus bar, curve and places."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.browser.sessions.fake_session import LIMITS, planned
from tests.browser.sessions.live_session import HERE, POSITIONERS, a_frame, live_session
from tests.gui.steps.test_steps import flat
from wafer_viewer.gui.elements.elements import Button, Dropdown, Html, Input, NumberOrEmpty
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.live.focus_curve import FIRST_ENDS_UM, axis_ends_um, curve_html, grips_html, live_dock
from wafer_viewer.gui.steps.live.live_picture import PictureSize, display_picture, offset_um, words_over
from wafer_viewer.gui.steps.live.live_step import (
    ELSEWHERE,
    JogWord,
    distances_um,
    live_step,
    next_step_um,
    pad_html,
    parse_step,
    parse_word,
    positioner,
    words,
)
from wafer_viewer.gui.steps.live.places import all_places, live_places, places_table, side_view
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.session.acquisition.live_controller import known_top, with_score
from wafer_viewer.session.state.instrument_state import FocusTrace, LiveState

SIZE = PictureSize(14, 14, 600, 450)


def test_a_word_of_the_script_is_a_direction_and_shift_makes_it_ten_times_as_long():
    assert parse_word("7,0,-1,1,0") == JogWord(7, 0, -1, 1, fast=False)
    assert distances_um(parse_step("1,0,-1,1"), 50.0) == (500.0, 0.0, -10.0)


def test_steps_follow_a_ladder_and_end_at_its_ends():
    assert [next_step_um(um, 1) for um in (50.0, 200.0, 1000.0)] == [100.0, 500.0, 1000.0]
    assert [next_step_um(um, -1) for um in (50.0, 5.0)] == [20.0, 5.0]


def test_the_pad_shows_the_digits_as_on_a_keypad():
    pad = pad_html()
    assert [pad.index(f'data-n="{n}"') for n in (7, 8, 9, 4, 5, 6, 1, 2, 3)] == sorted(
        pad.index(f'data-n="{n}"') for n in range(1, 10)
    )


def test_pixels_at_the_limit_are_red_and_wide_frames_are_thinned():
    image = np.full((1080, 1440), 4000, np.uint16)
    image[0, 0] = 65535
    shown = display_picture(image)
    assert shown.shape == (540, 720, 3)
    assert tuple(shown[0, 0]) == (214, 39, 40)
    assert tuple(shown[1, 1]) == (15, 15, 15)


def test_a_click_is_a_distance_from_the_middle_with_y_upwards():
    assert offset_um(LIMITS, 0.5, 0.5) == (0.0, 0.0)
    assert offset_um(LIMITS, 1.0, 0.0) == pytest.approx((LIMITS.field_width_um / 2, LIMITS.field_height_um / 2))


@pytest.mark.parametrize("scene", [(892, 640), (654, 420), (1100, 500)])
def test_the_picture_fits_into_the_scene_in_its_own_shape(scene):
    size = PictureSize.within(scene, 4 / 3)
    assert size.width_px / size.height_px == pytest.approx(4 / 3, rel=0.01)
    assert size.x_px >= 14
    assert size.y_px + size.height_px <= scene[1] - 13


def test_the_bar_tells_the_share_of_the_best_and_the_way_to_it():
    snapshot = live_session().snapshot
    above = words_over(snapshot, a_frame(9.0), SIZE, 0.0)
    assert "4.4" in above
    assert "down" in above
    assert "best is" in words_over(snapshot, a_frame(2.0), SIZE, 0.0)
    assert "at the best" in words_over(snapshot, a_frame(4.6), SIZE, 0.0)


def test_a_drive_shows_its_goal_with_distances_and_time():
    now = live_session().snapshot
    going = replace(now, live=replace(now.live, goal_um=(HERE.x_um + 94.6, HERE.y_um + 75.6), goal_s=0.4))
    shown = words_over(going, a_frame(), SIZE, 0.0)
    assert "Moving there · 0:01" in shown
    assert "Δx +94.6" in shown
    assert "<line" in shown
    far = replace(now, live=replace(now.live, goal_um=(9_000.0, 0.0)))
    assert "<line" not in words_over(far, a_frame(), SIZE, 0.0)


def test_why_there_is_no_picture_is_said():
    now = live_session().snapshot
    failed = replace(now, live=replace(now.live, problem="The camera failed <here>: check its cable."))
    empty = replace(a_frame(), frame=None)
    assert "The camera failed &lt;here&gt;" in words_over(failed, empty, SIZE, 0.0)


def test_the_picture_can_be_kept_as_soon_as_there_is_one():
    now = live_session().snapshot
    assert 'data-pick="live-keep"' in words_over(now, a_frame(), SIZE, 0.0)
    assert "live-keep" not in words_over(now, replace(a_frame(), frame=None), SIZE, 0.0)


def test_the_curve_holds_what_was_seen_and_the_range():
    look, now = a_frame(), live_session().snapshot
    low, high = axis_ends_um(look, now.live, 2.0)
    assert low <= -30.0
    assert high >= 51.0
    drawn = curve_html(look, now, (low, high))
    assert "best +4.6" in drawn
    assert "wv-live-range" in drawn
    assert "not seen yet" in curve_html(look, now, (-100.0, 100.0))
    grips = grips_html(now.live, (low, high))
    assert 'value="-25.0"' in grips
    assert "waits" not in grips
    assert grips_html(LiveState(), (low, high)).count("waits") == 2


def test_a_change_of_place_begins_the_scores_anew():
    trace = with_score(with_score(FocusTrace(), Position(0, 0, 1.0), 3.0), Position(0.2, 0, 4.0), 5.0)
    assert trace.points == ((1.0, 3.0), (4.0, 5.0))
    assert trace.best == (4.0, 5.0)
    assert with_score(trace, Position(0, 0, 4.1), 4.0).points == ((1.0, 3.0), (4.1, 4.0))
    assert with_score(trace, Position(30.0, 0, 4.0), 1.0).points == ((4.0, 1.0),)


def test_the_highest_known_z_names_its_source_and_where_z_stops():
    now = planned()
    free_um = LIMITS.objective.working_distance_um - LIMITS.objective.clearance_um
    top = known_top(now)
    assert (top.source, top.stop_um) == ("sweep of the plan", top.um - free_um)
    marked = replace(now, live=LiveState(highest_um=500.0, found_um=90.0))
    assert (known_top(marked).um, known_top(marked).source) == (500.0, "mark Highest")
    unknown = replace(now, draft=replace(now.draft, job=None))
    assert known_top(unknown) is None
    assert known_top(replace(unknown, live=LiveState(began_um=12.0))).source == "assumed: z at start"


def test_places_are_listed_and_the_objective_is_drawn_with_its_clearance():
    now = live_session().snapshot
    assert [place.name for place in all_places(now)] == ["Corner 1", "Corner 2", "Gauge blocks"]
    table = places_table(now)
    assert table.count('data-pick="live-forget"') == 1, "only a kept place can be removed"
    drawn = side_view(LIMITS, 0.0, known_top(now))
    assert "mark Highest" in drawn or "sweep of the plan" in drawn
    assert "28.00" in drawn


class Page:
    """A page on the live session, whose commands are noted."""

    def __init__(self) -> None:
        self.session = live_session()
        self.view = View(live=True)
        self.asked: list[str] = []

    def notes(self, _: Any) -> str:
        return ""

    def ask(self, failed: str, answer: Any, then: Any = None) -> None:
        self.asked.append(failed)

    def change(self, **choices: Any) -> None:
        self.view = replace(self.view, **choices)


def shown(step: Any, page: Page, own: Any = None, **changes: Any) -> list[Any]:
    here: Any = SimpleNamespace(snapshot=replace(page.session.snapshot, **changes), view=page.view, page=page, own=own)
    return flat(step(here))


def state_of(elements: list[Any]) -> dict[str, bool]:
    return {one.label: one.disabled for one in elements if isinstance(one, Button | Input)}


def test_the_panel_offers_drive_light_marks_and_the_plan_in_the_order_of_work():
    assert list(state_of(shown(live_step, Page()))) == [
        *("Go to focus", "Up to safe z", "Exposure, µs", "Light, %", "Objective", "Tilt A, deg"),
        *("Corner 1 is here", "Corner 2 is here", "Lowest is here", "Highest is here", "Use for the plan"),
    ]


def test_nothing_can_be_driven_while_the_rig_scans_and_marks_come_before_the_plan():
    page = Page()
    scanning = replace(page.session.snapshot.rig, state="scanning")
    off = state_of(shown(live_step, page, rig=scanning))
    assert [name for name, disabled in off.items() if not disabled] == ["Exposure, µs", "Use for the plan"]
    bare = shown(live_step, page, live=LiveState())
    assert state_of(bare)["Use for the plan"]
    assert any("mark two corners" in one.content for one in bare if isinstance(one, Html))


def test_a_number_typed_goes_to_its_command_and_what_fails_is_told_under_its_name():
    page = Page()
    inputs = {one.label: one for one in shown(live_step, page) if isinstance(one, Input)}
    inputs["Exposure, µs"].put(150.0)
    inputs["Light, %"].put(50.0)
    inputs["Light, %"].put(None)
    inputs["Objective"].put(ELSEWHERE)
    assert page.asked == ["The exposure was not changed", "The positioner did not move"]


def test_the_curve_keeps_its_ends_while_what_is_seen_lies_within():
    page = Page()
    here: Any = SimpleNamespace(snapshot=page.session.snapshot, view=page.view, page=page, own=FIRST_ENDS_UM)
    live_dock(here)
    ends_um = here.own
    assert ends_um[0] < FIRST_ENDS_UM[0]
    page.session.live.latest = a_frame(3.0)
    live_dock(here)
    assert here.own is ends_um


def test_labels_of_close_lines_lie_on_their_outer_sides():
    session = live_session()
    look, snapshot = session.live.look(), session.snapshot
    assert look.trace.best_um is not None
    sides = []
    for here_um in (look.trace.best_um - 3, look.trace.best_um + 3, look.trace.best_um - 40):
        drawn = curve_html(look, replace(snapshot, rig=replace(snapshot.rig, z_um=here_um)), (-40.0, 60.0))
        sides.append(re.findall(r'<b style="(left|right):[^"]*">(here|best)', drawn))
    close_below, close_above, apart = ({label: side for side, label in found} for found in sides)
    assert close_below == {"here": "right", "best": "left"}
    assert close_above == {"here": "left", "best": "right"}
    assert apart == {"here": "left", "best": "left"}


def test_a_place_can_be_kept_where_the_stage_can_move():
    page = Page()
    assert state_of(shown(live_places, page)) == {"Keep this place": False}
    absent = replace(page.session.snapshot.rig, state="absent", limits=None)
    assert state_of(shown(live_places, page, rig=absent)) == {"Keep this place": True}


def test_a_row_shows_the_number_or_the_name_and_which_positioners_are_not_homed():
    lamp, nosepiece, tilt = POSITIONERS
    between = replace(nosepiece, reading=msgspec.structs.replace(nosepiece.reading, named="", position=44.0))
    rows = [positioner(Page(), state) for state in (lamp, nosepiece, tilt, between)]
    assert [type(row) for row in rows] == [NumberOrEmpty, Dropdown, NumberOrEmpty, Dropdown]
    assert [row.value for row in rows] == [80.0, "10x", None, ELSEWHERE]
    assert words(POSITIONERS) == "not homed: Tilt A"
    assert words((lamp, nosepiece)) == "z goes up before it turns"
    assert words((lamp,)) == ""
