"""The gauge-block check as a session has it: certificate, repeats, terms, signing, correcting the z scale."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.datasets.gauge_scans import CALIBRATION, LOWER, RESULT, RIG, UPPER, scan_of_blocks
from tests.support.paths import ASSETS
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.gauge import GaugeCheck, GaugeTerms
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import CALIBRATION as RIGS_OWN
from wafer_viewer.rigs.virtual.rig import VirtualRig
from wafer_viewer.session.acquisition.rig_messages import Scan
from wafer_viewer.session.acquisition.scan_run import writer_of
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.gauge.gauge_controller import GaugeController
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.measurement.results import ResultsStore
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.calibration_records import (
    CALIBRATIONS,
    CalibrationChange,
    calibration_changes,
    calibration_in_force,
    read_certificate,
    record_change,
    signed_checks,
)

CERTIFICATE = ASSETS / "gauge" / "step.toml"


class Bench:
    """A data folder with scans of the blocks, and the parts of a session that a check needs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.command_queue = CommandQueue(
            Snapshot(data_folder=folder, rig=RigStatus(name=RIG, state="ready", calibration=CALIBRATION))
        )
        self.library = Library(self.command_queue, folder)
        self.results_store = ResultsStore(self.command_queue, self.library)
        questions = DatasetQueries(self.library, lambda: self.command_queue.snapshot)
        self.gauge = GaugeController(self.command_queue, self.library, self.results_store, questions, folder)

    def open(self, path: Path) -> None:
        self.command_queue.do(self.library.open, path).result()
        self.command_queue.do(self.results_store.open).result()

    def add(self, path: Path):
        self.open(path)
        return self.gauge.add_repeat(UPPER, LOWER, show=1).result()

    def wait_refused(self, message: str) -> None:
        """Another dataset is seen to by itself, soon after it was opened."""
        self.command_queue.wait_until(lambda now: message in (now.gauge.refusal or ""), 20.0)

    @property
    def state(self):
        return self.command_queue.snapshot.gauge

    def close(self) -> None:
        self.command_queue.close()
        self.gauge.close()
        self.library.release_lock()


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.close()


@pytest.fixture
def scans(tmp_path):
    """Three scans in which the step measures 0.3 um too much."""
    return [scan_of_blocks(tmp_path, seed, 0.3) for seed in (1, 2, 3)]


@pytest.mark.slow
def test_from_the_certificate_to_a_signed_check_in_log_and_results(bench, scans):
    assert bench.gauge.load_certificate(CERTIFICATE).result().number == "EXAMPLE-2"
    bench.gauge.set_terms(GaugeTerms(limit_um=1.0, temperature_c=21.0, tolerance_um=10.0)).result()
    for path in scans:
        assert bench.add(path).dataset == path.stem
    state = bench.state
    assert state.faces == (UPPER, LOWER)
    assert not state.busy
    check = state.check
    assert check.n == 3
    assert check.deviation.value_um == pytest.approx(0.3, abs=0.05)
    assert check.verdict == "pass"
    assert check.simulated
    assert (state.capability.n, state.capability.capable) == (3, None)
    assert (check.signed_by, state.signed, state.records) == ("", None, ())

    record = bench.gauge.sign(" Ann ").result()
    state = bench.state
    assert (record.check.signed_by, record.rig) == ("Ann", RIG)
    assert signed_checks(bench.folder) == state.records == (record,)
    assert state.signed == record.check
    assert [point.at for point in state.chart.points] == [record.check.at]
    assert (state.capability.n, state.capability.capable) == (3, None)
    (stored,) = Dataset.open(scans[-1]).result(RESULT).findings().items
    assert isinstance(stored, GaugeCheck)
    assert replace(stored, number=0, name="") == record.check
    with pytest.raises(MeasureError, match="is signed"):
        bench.gauge.sign("Ann").result()

    bench.add(scans[0])
    assert (bench.state.signed, len(bench.state.repeats)) == (None, 1)


@pytest.mark.slow
def test_the_z_scale_is_offered_after_signing_and_set_by_a_person(bench, scans):
    bench.gauge.load_certificate(CERTIFICATE).result()
    for path in scans:
        bench.add(path)
    assert bench.state.correction is None
    with pytest.raises(MeasureError, match="sign it first"):
        bench.gauge.correct_scale("Ann").result()
    check = bench.gauge.sign("Ann").result().check
    offered = bench.state.correction
    assert offered.changes_um == pytest.approx(-0.3, abs=0.05)
    with pytest.raises(MeasureError, match="under a name"):
        bench.gauge.correct_scale(" ").result()
    assert calibration_changes(bench.folder, RIG) == ()

    corrected = bench.gauge.correct_scale("Ann", "after the move").result()
    assert corrected == offered.calibration
    assert bench.command_queue.snapshot.rig.calibration == corrected
    assert calibration_in_force(bench.folder, RIG, CALIBRATION) == corrected
    (change,) = calibration_changes(bench.folder, RIG)
    assert (change.by, change.why, change.before) == ("Ann", "after the move", CALIBRATION)
    assert check.height.value_um * corrected.z_scale == pytest.approx(399.88)
    assert bench.state.correction is None

    bench.open(scan_of_blocks(bench.folder, 9, calibration=corrected))
    bench.wait_refused("set the z scale")
    with pytest.raises(MeasureError, match="set the z scale"):
        bench.gauge.add_repeat(UPPER, LOWER, show=1).result()


@pytest.mark.slow
def test_what_is_no_repeat_is_refused_and_does_not_count(bench, scans, tmp_path):
    with pytest.raises(MeasureError, match="no certificate"):
        bench.gauge.add_repeat(UPPER, LOWER, show=1).result()
    certificate = bench.gauge.load_certificate(CERTIFICATE).result()
    with pytest.raises(DatasetError, match="No dataset is open"):
        bench.gauge.add_repeat(UPPER, LOWER, show=1).result()
    bench.add(scans[0])
    with pytest.raises(MeasureError, match="in the check already"):
        bench.gauge.add_repeat(UPPER, LOWER, show=1).result()
    with pytest.raises(MeasureError, match="other way round"):
        bench.gauge.add_repeat(LOWER, UPPER, show=1).result()
    bench.open(scan_of_blocks(tmp_path, 8, calibration=None))
    bench.wait_refused("without a calibration")
    with pytest.raises(MeasureError, match="without a calibration"):
        bench.gauge.add_repeat(UPPER, LOWER, show=1).result()
    with pytest.raises(MeasureError, match="open one of its scans"):
        bench.gauge.sign("Ann").result()
    assert len(bench.state.repeats) == 1
    assert not bench.state.busy

    old = replace(certificate, expires=certificate.issued.replace(month=2))
    bench.gauge.put_certificate(old).result()
    bench.open(scans[1])
    bench.wait_refused("expired")
    assert bench.state.repeats == ()


def test_a_check_can_be_asked_for_while_its_faces_move(bench, scans):
    bench.gauge.load_certificate(CERTIFICATE).result()
    bench.add(scans[0])
    assert bench.gauge.check(UPPER, LOWER, show=1).n == 1
    bench.open(scans[1])
    assert bench.gauge.check(UPPER, LOWER, show=1).n == 2
    assert len(bench.state.repeats) == 1


def test_repeats_can_be_dropped_and_points_ticked(bench, scans):
    bench.gauge.put_certificate(read_certificate(CERTIFICATE)).result()
    for path in scans[:2]:
        bench.add(path)
    bench.gauge.tick("clean").result()
    bench.gauge.tick("warm").result()
    bench.gauge.tick("clean", False).result()
    assert [tick.point for tick in bench.state.ticks] == ["warm"]
    bench.gauge.drop_repeat(0).result()
    assert [repeat.dataset for repeat in bench.state.repeats] == ["scan-2"]
    with pytest.raises(MeasureError, match="no number 4"):
        bench.gauge.drop_repeat(3).result()
    bench.gauge.clear().result()
    assert (bench.state.repeats, bench.state.check, bench.state.ticks) == ((), None, ())
    with pytest.raises(MeasureError, match="measure a repeat first"):
        bench.gauge.sign("Ann").result()


def test_the_next_scan_takes_the_corrected_calibration(tmp_path):
    rig = VirtualRig("gauge_blocks")
    corrected = replace(rig.calibration, z_scale=0.999, made="2026-06-01", z_against=("V-1",))
    facts = {"rig": rig.name, "at": "2026-06-01T10:00:00", "by": "Ann", "why": "check"}
    record_change(tmp_path, CalibrationChange(**facts, before=rig.calibration, after=corrected))
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    job = Job(fields=(field,), sweep=FocusSweep(z_step_um=4.0, n_frames=5))
    writer_of(Scan(tmp_path / "next.wafer", plan_of(job, rig.limits), job), rig).close()
    assert Dataset.open(tmp_path / "next.wafer").scan.calibration == corrected
    rig.close()


@pytest.mark.slow
def test_a_session_has_the_corrected_calibration_or_says_why_none(tmp_path, patience_s):
    corrected = replace(RIGS_OWN, z_scale=0.999, made="2026-06-01")
    facts = {"rig": RIG, "at": "2026-06-01T10:00:00", "by": "Ann", "why": "check"}
    record_change(tmp_path, CalibrationChange(**facts, before=RIGS_OWN, after=corrected))
    assert rig_of(tmp_path, patience_s).calibration == corrected
    (tmp_path / CALIBRATIONS).write_text("{half\n")
    assert rig_of(tmp_path, patience_s).calibration is None


def rig_of(folder, patience_s):
    session = Session(folder)
    try:
        now = session.wait_until(lambda s: s.rig.state == "ready", patience_s)
        assert (now.rig.calibration is None) == any(f"{CALIBRATIONS} was altered" in fault.text for fault in now.faults)
        return now.rig
    finally:
        session.close()
