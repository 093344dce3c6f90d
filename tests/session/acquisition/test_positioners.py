"""Positioners from the session and the command line: motions, what follows from them, records, refusals."""

from __future__ import annotations

import msgspec
import pytest

from tests.session.acquisition.test_live import Talk, talk  # noqa: F401
from tests.session.conftest import small_job
from tests.support.paths import ROOT
from tests.support.patience import PATIENCE_S
from wafer_viewer.acquire.motion import move_positioner, read_positioners
from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import MotionStopped, PlanError, RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.rig_config import open_rig, read_config
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits
from wafer_viewer.session.acquisition.headless import scan_to
from wafer_viewer.session.acquisition.rig_messages import MovePositioner, PositionersMoved, Scan, StageMoved, Stop
from wafer_viewer.session.acquisition.scan_run import require_same_optics
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset

NOSEPIECE = ROOT / "assets/rigs/nosepiece_simulated.toml"


@pytest.fixture
def rig():
    made = VirtualRig("plane", real_time=True, limits=virtual_limits(135, 180))
    yield made
    made.close()


@pytest.mark.slow
def test_a_command_moves_a_positioner_and_reports_where_all_of_them_are(talk, rig):  # noqa: F811
    reply = talk.answer(talk.say(MovePositioner("lamp", 40.0)))
    assert reply.error is None
    assert reply.value.words == "40.0 %"
    moved = next(event for event in talk.events if isinstance(event, PositionersMoved))
    assert [(one.reading.name, one.reading.position) for one in moved.positioners] == [
        ("lamp", 40.0),
        ("tilt_a", 0.0),
        ("tilt_b", 0.0),
    ]
    assert isinstance(talk.answer(talk.say(MovePositioner("filter", 1.0))).error, RigError)


def test_a_stop_ends_a_motion_of_a_positioner_and_the_lift_before_it(talk, rig):  # noqa: F811
    tilted = talk.say(MovePositioner("tilt_a", 1.0))
    stopped = talk.say(Stop())
    assert isinstance(talk.answer(tilted).error, MotionStopped)
    assert talk.answer(stopped).value is True
    assert not rig.stage.moving()
    assert rig.positioners["tilt_a"].position() == 0.0
    assert [event.position.z_um < 9_000.0 for event in talk.events if isinstance(event, StageMoved)] == [True]


@pytest.mark.slow
def test_a_session_turns_the_nosepiece_and_plans_again_for_the_new_field(tmp_path):
    session = Session(tmp_path, read_config(NOSEPIECE))
    try:
        session.wait_until(lambda now: now.rig.state == "ready", PATIENCE_S)
        assert session.snapshot.rig.setup.objective == "unknown"
        session.live.set_positioner("zoom", "wide").result(PATIENCE_S)
        assert session.live.set_positioner("nosepiece", "20x").result(PATIENCE_S).named == "20x"
        session.wait_until(lambda now: now.rig.calibration is not None, PATIENCE_S)
        now = session.snapshot.rig
        assert (now.setup.objective, now.limits.pixel_um) == ("20x/0.42", 0.233645)
        assert now.z_um == pytest.approx(4_800.0, abs=0.01)
        with pytest.raises(RigError, match=r"'lamp' cannot go to 300 %"):
            session.live.set_positioner("lamp", 300.0).result(PATIENCE_S)
        with pytest.raises(RigError, match=r"no positioner 'filter'"):
            session.live.set_positioner("filter", 1.0).result(PATIENCE_S)
    finally:
        session.close()


@pytest.mark.campaign
def test_a_scan_records_the_positions_and_does_not_go_on_with_another_objective(tmp_path):
    rig = open_rig(read_config(NOSEPIECE))
    try:
        for name, to in (("zoom", "wide"), ("nosepiece", "10x"), ("lamp", 80.0)):
            move_positioner(rig, name, to, lambda: False)
        rig.stage.move_to(x_um=0.0, y_um=0.0, z_um=0.0)
        job = replace(small_job(), objective="20x/0.42")
        with pytest.raises(PlanError, match=r"Objective: The plan is for 20x/0\.42 at zoom 1, the rig has 10x/0\.28"):
            scan(tmp_path, job, rig)
        assert scan(tmp_path, replace(small_job(), objective="10x/0.28", zoom=1.0), rig).error is None
        record = Dataset.open(tmp_path / "one.wafer").scan
        assert {one.name: one.words for one in record.positioners} == {
            "lamp": "80.0 %",
            "nosepiece": "10x",
            "zoom": "wide",
            "tilt_a": "not homed",
            "tilt_b": "not homed",
        }
        assert record.calibration_problem("2026-11-23") is None
        older = msgspec.to_builtins(record)
        del older["positioners"], older["job"]["objective"], older["job"]["zoom"]
        assert msgspec.convert(older, type(record)).positioners == ()
        before = Scan(tmp_path / "one.wafer", record.plan, record.job)
        require_same_optics(before, rig)
        move_positioner(rig, "nosepiece", "20x", lambda: False)
        with pytest.raises(
            PlanError, match=r"made for pixels of 0\.46729 um.*0\.233645 um with the objective 20x/0\.42"
        ):
            require_same_optics(before, rig)
        move_positioner(rig, "zoom", 1.0, lambda: False)
        again = replace(record.plan, pixel_um=rig.limits.pixel_um)
        with pytest.raises(PlanError, match=r"one\.wafer was begun with the objective 10x/0\.28 at zoom 1, and"):
            require_same_optics(Scan(before.path, again, record.job, goes_on=True), rig)
    finally:
        rig.close()


def scan(folder, job, rig):
    from wafer_viewer.session.planning.preflight import require_passed

    return scan_to(folder / "one.wafer", job, rig, lambda _: None, require_passed, lambda _: None)


def test_a_rig_whose_objective_is_not_known_does_not_scan(tmp_path):
    rig = open_rig(read_config(NOSEPIECE))
    try:
        assert read_positioners(rig)[1].reading.position is None
        rig.stage.move_to(z_um=0.0)
        with pytest.raises(PlanError, match=r"Objective: The objective in the light path is not known\. Turn"):
            scan(tmp_path, small_job(), rig)
    finally:
        rig.close()


def test_a_plan_for_a_rig_is_of_the_objective_in_the_light_path():
    rig = open_rig(read_config(NOSEPIECE))
    try:
        move_positioner(rig, "zoom", 1.0, lambda: False)
        move_positioner(rig, "nosepiece", "10x", lambda: False)
        assert plan_of(small_job(), rig.limits).pixel_um == 0.46729
    finally:
        rig.close()


@pytest.mark.slow
def test_the_command_line_lists_and_moves_positioners(capsys):
    assert main(["positioners", "--rig", str(NOSEPIECE), "--move", "lamp=40", "nosepiece=20x"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "lamp: Light, 40.0 %, range 0 to 100 %"
    assert lines[1] == "nosepiece: Objective, 20x, range 0 to 180 deg, positions 10x, 20x"
    assert lines[2] == "zoom: Zoom, not homed, range 1 to 4 x, positions wide, narrow"


@pytest.mark.parametrize(
    ("move", "words"), [("lamp", "NAME=POSITION"), ("lamp=200", "range is 0 to 100 %"), ("filter=1", "no positioner")]
)
def test_the_command_line_refuses_a_wrong_position(move, words, capsys):
    assert main(["positioners", "--move", move]) == 2
    assert words in capsys.readouterr().err
