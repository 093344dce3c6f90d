"""Calibrations of a session: run on a stand-in of the rig, kept, discarded, refused, failed, and evaluated."""

from __future__ import annotations

import datetime
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.support.gauge_repeats import signed
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.acquisition.characteristics import KINDS, CalibrationResult, Characteristic
from wafer_viewer.model.acquisition.procedure import ProcedureStep
from wafer_viewer.model.errors import DatasetError, MeasureError, MotionStopped, PlanError, RigError
from wafer_viewer.model.gauge import GaugeRecord, GaugeTerms
from wafer_viewer.model.spec import replace as replace_spec
from wafer_viewer.rigs.virtual.rig import CALIBRATION
from wafer_viewer.session.calibration import calibration_controller
from wafer_viewer.session.calibration.calibration_controller import CalibrationController
from wafer_viewer.session.calibration.headless import PROCEDURES
from wafer_viewer.session.calibration.procedures import DelayProcedure
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot
from wafer_viewer.store.records.calibration_records import (
    CALIBRATIONS,
    FOLDER,
    CalibrationChange,
    calibration_records,
    record_change,
    sign,
)

RIG = RigStatus(name="Bench 2", simulated=False, state="ready", calibration=replace_spec(CALIBRATION, simulated=False))


class ScriptedRig:
    """Fulfils what the controller asks of a RigClient: a test answers its procedures when it likes."""

    def __init__(self):
        self.procedures, self.answers, self.steps = [], [], []

    def run_procedure(self, procedure, on_step):
        self.procedures.append(procedure)
        self.steps.append(on_step)
        self.answers.append(Future())
        return self.answers[-1]


class Bench:
    """A controller over a scripted rig, with its queue."""

    def __init__(self, folder):
        self.folder, self.rig, self.is_confirmed = folder, ScriptedRig(), True
        self.queue = CommandQueue(Snapshot(rig=RIG, data_folder=folder))
        plan = SimpleNamespace(require_confirmed=self._require_confirmed)
        self.calibration = CalibrationController(self.queue, plan, self.rig, folder)
        self.calibration.refresh().result(PATIENCE_S)

    def _require_confirmed(self):
        if not self.is_confirmed:
            raise PlanError("confirm the sample before anything moves.")

    @property
    def state(self):
        return self.queue.snapshot.calibration

    def change(self, **rig):
        self.queue.do(lambda: self.queue.change(rig=replace(self.queue.now.rig, **rig))).result(PATIENCE_S)

    def started(self, kind="delay", **options):
        running = self.calibration.run(kind, **options)
        self.queue.do(lambda: None).result(PATIENCE_S)
        return running

    def measured(self, value=62.0, **more):
        """A run that the rig answers at once."""
        running = self.started()
        self.rig.answers[-1].set_result(delay_result(value, **more))
        return running.result(PATIENCE_S)


def delay_result(value=62.0, sets=True):
    one = Characteristic(name="trigger delay", value=value, unit="us", expanded=4.0, before=12.0)
    values = {"trigger_delay_us": value, "u_trigger_delay_us": 2.0} if sets else {}
    return CalibrationResult(kind="delay", characteristics=(one,), sets=values, notes=("Speeds of 40 and 240 um/s.",))


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.queue.close()


def nothing_is_recorded(folder):
    return not (folder / FOLDER).exists() and not (folder / CALIBRATIONS).exists()


def test_every_kind_has_its_procedure_or_its_evaluation():
    for kind, one in KINDS.items():
        assert (kind in PROCEDURES) == (one.source == "rig")
        assert (kind in calibration_controller.FROM_CHECKS) == (one.source == "gauge checks")
        fields = getattr(PROCEDURES.get(kind), "__dataclass_fields__", {})
        assert {option.name for option in one.options} <= set(fields)
        assert all(option.default == fields[option.name].default for option in one.options)


def test_a_run_is_told_where_and_how_and_shows_its_steps(bench):
    running = bench.started(z_range_um=40.0, exposure_us=90.0, repeats=2.0)
    (procedure,) = bench.rig.procedures
    assert isinstance(procedure, DelayProcedure)
    site = procedure.site
    assert (site.x_um, site.y_um, site.z_um, site.z_range_um, site.exposure_us) == (None, None, None, 40.0, 90.0)
    assert (procedure.repeats, type(procedure.repeats), procedure.in_force) == (2, int, RIG.calibration)
    bench.queue.do(bench.rig.steps[0], ProcedureStep(0.4, "Sweep up and down, 1 of 2")).result(PATIENCE_S)
    bench.queue.do(bench.rig.steps[0], ProcedureStep(0.5)).result(PATIENCE_S)
    shown = bench.state.running
    assert (shown.kind, shown.fraction, shown.words) == ("delay", 0.5, "Sweep up and down, 1 of 2")
    bench.rig.answers[0].set_result(delay_result())
    assert running.result(PATIENCE_S) == delay_result()
    assert bench.state.running is None
    assert (bench.state.pending.result, bench.state.pending.simulated) == (delay_result(), False)
    assert nothing_is_recorded(bench.folder)


def test_a_kept_result_is_recorded_and_in_force(bench):
    assert bench.state.history("delay").is_due
    bench.measured()
    path = bench.calibration.keep(" Ann ", "new cable").result(PATIENCE_S)
    (record,) = calibration_records(bench.folder, "Bench 2")
    assert (record.signed_by, record.why, record.simulated) == ("Ann", "new cable", False)
    assert path.parent == bench.folder / FOLDER
    in_force = bench.queue.snapshot.rig.calibration
    assert (in_force.trigger_delay_us, in_force.pixel_um) == (62.0, CALIBRATION.pixel_um)
    history = bench.state.history("delay")
    assert (history.newest, history.is_due) == (record, False)
    assert bench.state.pending is None
    assert bench.state.n_due == len(KINDS) - 1


def test_a_discarded_result_leaves_nothing(bench):
    bench.measured()
    bench.calibration.discard().result(PATIENCE_S)
    assert bench.state.pending is None
    assert nothing_is_recorded(bench.folder)
    with pytest.raises(RigError, match="no result to keep"):
        bench.calibration.keep("Ann").result(PATIENCE_S)


@pytest.mark.parametrize(
    "fault", [RigError("The focus is not between 170.0 and 230.0 um."), MotionStopped("Stopped.")], ids=["fail", "stop"]
)
def test_a_run_that_fails_or_is_stopped_says_why_and_leaves_nothing(bench, fault):
    running = bench.started()
    bench.rig.answers[0].set_exception(fault)
    with pytest.raises(type(fault), match=str(fault)):
        running.result(PATIENCE_S)
    assert (bench.state.running, bench.state.pending) == (None, None)
    assert nothing_is_recorded(bench.folder)
    bench.measured()
    assert bench.state.pending is not None


def test_a_signature_needs_a_name_and_a_rig_that_does_not_scan(bench):
    bench.measured()
    with pytest.raises(RigError, match="say who signs it"):
        bench.calibration.keep("  ").result(PATIENCE_S)
    bench.change(state="scanning")
    with pytest.raises(RigError, match="A scan is running: keep the calibration when it has ended"):
        bench.calibration.keep("Ann").result(PATIENCE_S)
    assert nothing_is_recorded(bench.folder)
    bench.change(state="ready")
    bench.calibration.keep("Ann").result(PATIENCE_S)


def test_a_result_that_waits_is_not_overwritten(bench):
    bench.measured()
    with pytest.raises(RigError, match=r"Trigger delay: its result waits\. Keep or discard it first"):
        bench.calibration.run("noise").result(PATIENCE_S)
    assert len(bench.rig.procedures) == 1


def test_a_result_is_not_applied_over_a_value_that_changed_meanwhile(bench):
    def corrected(**values):
        after = replace_spec(RIG.calibration, **values)
        change = CalibrationChange(
            rig="Bench 2", at="2026-11-23", by="Bob", why="", before=RIG.calibration, after=after
        )
        record_change(bench.folder, change)

    bench.measured()
    corrected(trigger_delay_us=30.0)
    with pytest.raises(RigError, match="in force has changed since this was measured"):
        bench.calibration.keep("Ann").result(PATIENCE_S)
    assert calibration_records(bench.folder) == ()
    corrected(z_scale=1.0002)
    bench.calibration.keep("Ann").result(PATIENCE_S)
    in_force = bench.queue.snapshot.rig.calibration
    assert (in_force.z_scale, in_force.trigger_delay_us) == (1.0002, 62.0)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("delay", {"turns": 3}, "Trigger delay has no option turns: it has repeats"),
        ("delay", {"repeats": 0}, "Trigger delay: Pairs is 0, it must be a whole number from 1"),
        ("delay", {"repeats": 2.5}, "it must be a whole number from 1"),
        ("pixel", {"length_um": -1.0}, "it must be at least 0"),
        ("delay", {"z_range_um": 0.0}, "it must be over 0"),
        ("colour", {}, "There is no calibration 'colour': choose one of"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_moves(bench, kind, options, message):
    with pytest.raises(RigError, match=message):
        bench.calibration.run(kind, **options).result(PATIENCE_S)
    assert bench.rig.procedures == []


def test_an_unconfirmed_sample_and_a_rig_without_calibration_are_refused(bench):
    bench.is_confirmed = False
    with pytest.raises(PlanError, match="confirm the sample"):
        bench.calibration.run("delay").result(PATIENCE_S)
    bench.is_confirmed = True
    bench.change(calibration=None)
    with pytest.raises(RigError, match="Bench 2 has no calibration to start from"):
        bench.calibration.run("delay").result(PATIENCE_S)
    assert bench.rig.procedures == []


def test_signed_checks_are_evaluated_without_a_motion(bench, monkeypatch):
    with pytest.raises(RigError, match="Bench 2 has no signed check against gauge blocks"):
        bench.calibration.run("linearity").result(PATIENCE_S)
    checks = [SimpleNamespace(rig=name, check=SimpleNamespace(simulated=True)) for name in ("Bench 1", "Bench 2")]
    monkeypatch.setattr("wafer_viewer.session.gauge.gauge_check.trusted_checks", lambda folder: tuple(checks))
    seen = []

    def evaluate(own, base):
        seen.extend(own)
        one = Characteristic(name="amplification coefficient of z", value=1.0002, unit="1", expanded=2e-4)
        return CalibrationResult(kind="linearity", characteristics=(one,))

    monkeypatch.setitem(calibration_controller.FROM_CHECKS, "linearity", evaluate)
    bench.change(state="scanning")
    result = bench.calibration.run("linearity").result(PATIENCE_S)
    assert (seen, bench.rig.procedures) == (checks[1:], [])
    assert (bench.state.pending.result, bench.state.pending.simulated) == (result, True)


def test_the_z_scale_is_set_by_the_newest_signed_check_and_due_after_its_interval(bench):
    in_force = RIG.calibration
    terms = GaugeTerms(limit_um=2.0, interval_days=30)
    check = signed("2026-06-01", 400.8, 400.8, 400.8, terms=terms, calibration=in_force)
    sign(bench.folder, GaugeRecord(check=check, rig="Bench 2", result="default", software_version="test"))
    scale = bench.calibration.run("z").result(PATIENCE_S).characteristics[0]
    assert scale.value == pytest.approx(in_force.z_scale * 400.0 / 400.8)
    assert nothing_is_recorded(bench.folder)
    assert bench.rig.procedures == []
    bench.calibration.keep("Bob").result(PATIENCE_S)
    (record,) = calibration_records(bench.folder, "Bench 2", "z")
    assert (record.after.z_scale, record.after.z_against) == (scale.value, ("A1", "A2"))
    assert datetime.date.fromisoformat(record.due) == datetime.date.today() + datetime.timedelta(days=30)
    with pytest.raises(MeasureError, match="corrected by this check already"):
        bench.calibration.run("z").result(PATIENCE_S)


def test_damaged_records_are_named_and_due_days_follow_the_day(bench, monkeypatch):
    bench.measured()
    path = bench.calibration.keep("Ann").result(PATIENCE_S)
    monkeypatch.setattr(calibration_controller, "today", lambda: "2999-01-01")
    bench.calibration.refresh().result(PATIENCE_S)
    assert bench.state.history("delay").is_due
    path.chmod(0o644)
    path.write_text(path.read_text().replace('"Ann"', '"Bob"'))
    bench.calibration.refresh().result(PATIENCE_S)
    assert path.name in bench.state.problem
    assert bench.state.history("delay").records == ()
    with pytest.raises(DatasetError, match="is damaged"):
        calibration_records(bench.folder)
