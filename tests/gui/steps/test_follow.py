"""Page of a plan that follows the focus: map, row from the side, and the scene."""

from __future__ import annotations

import dataclasses

import pytest

from tests.browser.sessions.fake_session import planned
from tests.browser.sessions.followed_session import followed as a_followed_plan
from wafer_viewer.gui.scenes.plan_scene import followed, plan_contents
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps import follow


@pytest.fixture(scope="module")
def snapshot():
    return a_followed_plan()


def test_the_map_shows_places_windows_and_those_without_a_focus(snapshot):
    shown = followed(snapshot.draft, None)
    html = str(follow.windows(shown))
    assert html.count("<circle") == 11
    (blank,) = shown.blank
    assert f"Field {blank}. It takes the whole sweep" in html
    assert "11 of 12 places in focus" in follow.head(shown)
    assert html.count('data-pick="focus-row"') == 48


def test_the_chosen_row_is_shown_from_the_side_over_the_whole_sweep(snapshot):
    shown = followed(snapshot.draft, 1)
    assert {field.row for field, _ in shown.in_row} == {1}
    assert "Row 2 from the side" in follow.windows(shown)
    assert shown.whole_um == (-200.0, 200.0)
    assert followed(snapshot.draft, 99).row == 3


def test_an_uncertain_focus_is_pale(snapshot):
    shown = followed(snapshot.draft, None)
    pairs = sorted(zip((one.u_um for one in shown.focus), shown.opacities(), strict=True))
    assert pairs[0][1] == 1.0
    assert pairs[-1][1] < 0.8


def test_the_scene_has_the_surface_and_the_windows_only_after_a_look(snapshot):
    keys = [item.name for item in plan_contents(snapshot, View()).items]
    assert {"focus/surface", "focus/windows", "focus/blank/48"} <= set(keys)
    before = dataclasses.replace(snapshot, draft=planned().draft)
    assert not any(item.name.startswith("focus/") for item in plan_contents(before, View()).items)
