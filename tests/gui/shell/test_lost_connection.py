"""What a page is told beforehand to say when contact is lost, and when it is back; and when a window is too narrow."""

from __future__ import annotations

import dataclasses

import pytest

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.page.browser_info import BrowserInfo, is_cramped
from wafer_viewer.gui.page.work_steps import STEPS, why_not
from wafer_viewer.gui.shell.build_page import disconnection_summary, out_of_reach, restart_summary, state
from wafer_viewer.gui.state.view_state import PanelLayout
from wafer_viewer.session.state.snapshot import RigStatus


def test_the_last_word_names_the_field_under_way():
    assert state(fake.scanning()) == "scanning, field 5"
    assert state(fake.planned()) == "at rest"


def test_a_real_rig_has_a_red_button_and_a_simulated_one_harms_nobody():
    assert out_of_reach(RigStatus(simulated=False)).endswith("Press the red button on the rig.")
    assert "nothing real moves" in out_of_reach(RigStatus())


def test_what_went_on_meanwhile_is_told_with_its_numbers():
    assert "frame 274 of 540, 1 missing, taken again later. Nothing to do." in disconnection_summary(fake.scanning())
    assert (
        disconnection_summary(fake.measured())
        == "The scan has ended: 9 of 9 fields are complete; all frames are kept. Nothing to do."
    )
    lost = dataclasses.replace(fake.planned(), rig=RigStatus(state="fault", message="The box does not answer."))
    assert disconnection_summary(lost) == "The box does not answer."


def test_after_a_restart_stands_what_is_kept_and_what_it_waits_for():
    now = fake.unfinished()
    assert restart_summary(now) == "coupon-07: 3 of 9 fields are complete; all frames are kept."
    waits = dataclasses.replace(now, draft=dataclasses.replace(now.draft, confirmed=False))
    assert restart_summary(waits).endswith("Nothing moves before the sample is confirmed.")


@pytest.mark.parametrize(
    ("window_px", "cramped"), [(0, False), (1024, True), (1143, True), (1144, False), (1600, False)]
)
def test_a_scene_under_440_px_is_too_narrow(window_px: int, cramped: bool):
    assert is_cramped(BrowserInfo(window=window_px), PanelLayout()) == cramped


def test_every_step_that_is_not_possible_says_why():
    for now in (fake.empty(), fake.planned(), fake.scanning(), fake.unfinished(), fake.measured()):
        for step in STEPS:
            why = why_not(step, now)
            assert why is None or why.endswith(".")
    assert why_not("measure", fake.scanning()) == "the fields are not stitched."
    assert why_not("acquire", fake.measured()) is None
