"""What a browser remembers of its view, its panels and itself."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.gui.page.browser_info import BrowserInfo, layout_of, system_name
from wafer_viewer.gui.page.work_steps import STEPS
from wafer_viewer.gui.state import view_state
from wafer_viewer.gui.state.view_state import BrowserIdentity, PanelLayout, Remembered, View
from wafer_viewer.model.region import Region

PLACES = (Region.circle(1.0, 2.0, 3.0), Region.rectangle(0.0, 0.0, 4.0, 5.0))


@given(st.builds(View, step=st.sampled_from(STEPS), dark=st.booleans(), exaggeration=st.floats(1, 20)))
def test_a_browser_remembers_what_it_chose(view):
    assert view_state.read(view_state.write(view, "")).view == view


def test_what_belongs_to_a_dataset_is_kept_apart_with_the_name_of_it():
    view = View(step="measure", show=3, range_um=(-1.0, 2.5), tool="step", places=PLACES, selected=7, dark=True)
    read = view_state.read(view_state.write(view, "/data/a.wafer"))
    assert read.view == View(step="measure", dark=True)
    assert read.of == "/data/a.wafer"
    assert view_state.changed(read.view, **read.chosen) == view


@pytest.mark.parametrize("text", ["", "{", "[]", '{"step": "nowhere"}', '{"dark": 3}', '{"unknown": 1}'])
def test_a_memory_that_is_no_view_is_a_fresh_view(text):
    assert view_state.read(text) == Remembered()


def test_one_choice_of_another_version_costs_the_others_nothing():
    text = '{"step": "nowhere", "dark": true, "places": [{"kind": "circle", "points": [[1, 2]]}], "show": 2}'
    read = view_state.read(text)
    assert (read.view, read.chosen) == (View(dark=True), {"show": 2})


@pytest.mark.parametrize("text", ["", "null", "[1]", '{"layout": 3}'])
def test_a_browser_that_is_not_known_is_a_new_one(text):
    assert view_state.read_self(text) == BrowserIdentity()


def test_widths_are_kept_and_a_folded_panel_keeps_the_one_it_had():
    before = PanelLayout(left_px=300, right_px=404)
    now = layout_of(BrowserInfo("Linux x86_64", (266, False), (38, True)), before)
    assert now == PanelLayout(left_px=262, right_px=404, left_folded=False, right_folded=True)
    assert layout_of(BrowserInfo("Linux x86_64", None, None), now) == now


def test_a_system_is_called_by_its_name():
    assert [system_name(p) for p in ("Linux x86_64", "Win32", "MacIntel", "")] == [
        "Linux",
        "Windows",
        "macOS",
        "unknown",
    ]
