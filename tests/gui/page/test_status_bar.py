"""The line at the foot of the page, in words."""

from __future__ import annotations

import dataclasses
import datetime

import pytest

from tests.browser.sessions import fake_session as fake
from tests.support.made_up_poses import made_up_poses, stitching_of
from tests.support.page_stand_in import grid
from wafer_viewer.gui.shell.header import calibration, calibration_due, job_shown, motion, placement, sample, surface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Levy, Recipe
from wafer_viewer.session.state.snapshot import RigStatus

TODAY = datetime.date(2026, 3, 14)


def calibrated(until: str) -> Calibration:
    return Calibration(pixel_um=0.5, u_pixel_um=0.001, u_z_scale=1e-3, made="2026-01-01", due=until, against="block 2")


@pytest.mark.parametrize(
    ("until", "said", "tone"),
    [
        ("2026-05-14", "Calibrated, due in 61 days", ""),
        ("2026-03-28", "Calibration due in 14 days", "attention"),
        ("2026-03-15", "Calibration due in 1 day", "attention"),
        ("2026-03-14", "Calibration due today", "attention"),
        ("2026-03-13", "Calibration overdue by 1 day", "fault"),
        ("2999-12-31", "Calibrated until 2999-12-31", ""),
    ],
)
def test_the_calibration_counts_down(until, said, tone):
    words, colour, more = calibration_due(calibrated(until), TODAY)
    assert (words, colour) == (said, tone)
    assert "block 2" in more


def test_the_calibration_of_a_simulation_is_never_due():
    words, tone, more = calibration_due(replace(calibrated("2999-12-31"), simulated=True), TODAY)
    assert (words, tone) == ("Calibrated by simulation", "")
    assert "nothing real" in more


def test_no_calibration_is_said_in_words():
    assert calibration_due(None, TODAY)[:2] == ("No calibration", "fault")
    now = fake.measured("imported without one")
    words, tone, more = calibration(now, View(step="surface"), TODAY)
    assert (words, tone) == ("Uncalibrated", "fault")
    assert "imported without one" in more


@pytest.mark.parametrize(
    ("status", "said", "tone"),
    [
        (RigStatus(homed=True, state="ready"), "Homed · at rest", ""),
        (RigStatus(homed=True, state="moving"), "Homed · moving", "busy"),
        (RigStatus(homed=False, state="ready"), "Not homed · at rest", "attention"),
        (RigStatus(homed=True, state="fault"), "Rig at fault", "fault"),
        (RigStatus(homed=None, state="starting"), "Rig starting", "busy"),
    ],
)
def test_the_rig_says_whether_it_knows_where_it_is_and_whether_it_moves(status, said, tone):
    assert motion(status)[:2] == (said, tone)


def test_lot_wafer_and_revision_of_the_job_that_is_looked_at():
    job = replace(fake.a_job(), product="GATE-3", revision="B")
    assert sample(job) == ("Lot L2231 · Wafer W07 · Job GATE-3 rev. B", "", "not released")
    assert sample(replace(job, sample=Sample(), product="", revision=""))[0] == "Unnamed sample"
    assert sample(None)[0] == ""
    now = dataclasses.replace(fake.measured(), draft=fake.draft_of(None))
    assert job_shown(now, View(step="plan")) is None
    assert job_shown(now, View(step="surface")) == now.dataset.job


def test_what_was_done_to_the_heights_on_show():
    info = fake.measured().surface
    (heights, _, _), (missing, _, reasons) = surface(info)
    assert heights == "Filtered heights, 0.2\u202f% filled"
    assert missing == "0.6\u202f% unmeasured"
    assert "no texture 0.4\u202f%" in reasons
    raw = dataclasses.replace(info, settled=Recipe(levy=Levy(mode="none")), filled_fraction=0.0)
    assert surface(raw)[0][0] == "Measured heights, none filled"
    assert surface(None) == (("", "", ""), ("", "", ""))


def test_a_surface_that_only_the_stage_placed_is_drawn_attention_to():
    info = fake.measured().surface
    assert info is not None
    assert placement(info) == placement(None) == ("", "", "")
    result = stitching_of(made_up_poses(grid(3, 3).fields(0.0), 600.0, 400.0))
    undecided = dataclasses.replace(result, n_believed=0, n_by_stage=9)
    text, tone, _ = placement(dataclasses.replace(info, stitching=undecided, n_fields=9))
    assert (text, tone) == ("Stitched by the stage alone", "attention")
