"""A session on a rig that slips and hangs: the page is told what happened, and the scan can be continued."""

from __future__ import annotations

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
    ended = session.wait_until(lambda s: not s.scanning and any(f.title == "The scan stopped" for f in s.faults), 60)
    reported = {f.title: f.text for f in ended.faults}
    assert "125 quadrature errors on the z scale" in reported["The scan reports a fault"]
    assert "The stage does not report the end of its motion" in reported["The scan stopped"]
    assert "the x axis stands at" in reported["The scan stopped"]
    assert len(Dataset.open(path).kept()) == 20
    session.continue_scan().result(patience_s)
    session.wait_until(lambda s: not s.scanning and s.dataset.finished, patience_s)
    assert Dataset.open(path).check().ok
