"""A session on a rig that slips and hangs: the page is told what happened, and the scan can be continued."""

from __future__ import annotations

import re

import pytest

from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset


@pytest.fixture
def session(tmp_path, patience_s):
    # Motions: 0 to the first field, 1 its pass, which slips, 2 back, 3 its pass again, 4 to the second field.
    made = Session(tmp_path, RigConfig(faults=Faults(slips=(5,), slip_counts=250, endless_motions=(4,))))
    made.wait_until(lambda s: s.rig.state == "ready", patience_s)
    yield made
    made.close()


@pytest.mark.slow
def test_slipped_pulses_and_a_stuck_stage_are_reported_and_the_scan_continues(session, job, patience_s):
    session.edit_job(job(cols=2, n_frames=20)).result()
    path = session.start_scan("faults").result(patience_s)
    ended = session.wait_until(
        lambda s: not s.scanning and any(f.title == "The scan stopped" for f in s.faults), patience_s
    )
    reported = {f.title: f.text for f in ended.faults}
    assert "125 quadrature errors on the z scale" in reported["The scan reports a fault"]
    assert "The stage does not report the end of its motion" in reported["The scan stopped"]
    assert "the x axis stands at" in reported["The scan stopped"]
    assert len(Dataset.open(path).kept()) == 20
    session.continue_scan().result(patience_s)
    session.wait_until(lambda s: not s.scanning and s.dataset.finished, patience_s)
    assert Dataset.open(path).check().ok


LOST = {
    "stage": (Faults(stage_lost=(25,)), "The stage failed (No such device): check its cable and its power"),
    "box": (
        Faults(box_lost=(25,)),
        r"The pulse box's port cannot be \w+( to)? \(Input/output error\): check its cable and its power",
    ),
    "camera": (Faults(camera_lost=(25,)), "The camera failed (Camera is not available): check its cable and its power"),
}
"""Devices that are lost in the second pass, and what is said then; a scan that is continued needs fewer pulses."""


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("device", LOST)
def test_scan_ends_when_a_device_is_lost_and_continues_on_the_reopened_rig(device, tmp_path, job, patience_s):
    faults, sentence = LOST[device]
    session = Session(tmp_path, RigConfig(faults=faults))
    try:
        session.wait_until(lambda s: s.rig.state == "ready", patience_s)
        session.edit_job(job(cols=2, n_frames=20)).result()
        path = session.start_scan("lost").result(patience_s)
        lost = session.wait_until(lambda s: s.rig.state == "absent", patience_s)
        (text,) = (f.text for f in lost.faults if f.title == "The scan stopped")
        assert re.match(sentence if device == "box" else re.escape(sentence), text)
        assert "The frames of complete passes are kept." in text
        assert "The next move or scan connects to the rig again." in lost.rig.message
        assert not lost.scanning
        assert len(Dataset.open(path).kept()) == 20
        session.continue_scan().result(patience_s)
        session.wait_until(lambda s: not s.scanning and s.dataset.finished, patience_s)
        assert Dataset.open(path).check().ok
    finally:
        session.close()


@pytest.mark.campaign
def test_scan_ends_when_its_folder_is_gone_and_another_one_starts(session_at_rest, tmp_path, job, patience_s):
    session = session_at_rest
    session.edit_job(job(cols=6, n_frames=60, z_step_um=0.8)).result()
    path = session.start_scan("gone").result(patience_s)
    session.wait_until(lambda s: s.scan is not None and s.scan.frames_done > 5, patience_s)
    path.rename(tmp_path / "elsewhere")
    ended = session.wait_until(
        lambda s: not s.scanning and any(f.title == "The scan stopped" for f in s.faults), patience_s
    )
    (text,) = (f.text for f in ended.faults if f.title == "The scan stopped")
    assert "gone.wafer" in text
    assert ended.rig.state == "ready"
    assert ended.dataset is None
    assert "Open it again" in {f.title: f.text for f in ended.faults}["gone was closed"]
    assert session.stop_scan().result(patience_s) is None
    session.edit_job(job(cols=2, n_frames=20)).result()
    again = session.start_scan("again").result(patience_s)
    session.wait_until(lambda s: not s.scanning and s.dataset is not None and s.dataset.finished, patience_s)
    assert Dataset.open(again).check().ok


@pytest.fixture
def session_at_rest(tmp_path, patience_s):
    made = Session(tmp_path / "data", RigConfig())
    made.wait_until(lambda s: s.rig.state == "ready", patience_s)
    yield made
    made.close()
