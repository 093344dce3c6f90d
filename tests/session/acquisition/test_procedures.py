"""Procedures in the rig's process and in the session: results, progress, stops and faults."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from multiprocessing import Pipe

import pytest

from tests.support.patience import PATIENCE_S
from wafer_viewer.acquire.motion import move
from wafer_viewer.compute.child_process import ChildConnection, Reply, Request
from wafer_viewer.model.acquisition.procedure import ProcedureStep
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.rigs.virtual.rig import VirtualRig
from wafer_viewer.session.acquisition.rig_messages import Move, ProcedureProgress, RunProcedure, StageMoved, Stop
from wafer_viewer.session.acquisition.rig_process import RigExecutor


@dataclass(frozen=True)
class Visit:
    """Procedure that visits places along x and returns how many it reached."""

    places_um: tuple[float, ...]
    title = "Visit places"

    def run(self, rig, control):
        for done, x_um in enumerate(self.places_um, 1):
            move(rig, {"x": x_um}, control.should_stop)
            control.report(ProcedureStep(done / len(self.places_um), f"at {x_um:g} um"))
        return len(self.places_um)


@dataclass(frozen=True)
class Fails:
    """Procedure whose sample does not allow a result."""

    title = "Find what is not there"

    def run(self, rig, control):
        raise RigError("Nothing is in focus: move to the sample.")


@dataclass(frozen=True)
class Unplugged:
    """Procedure whose device is lost."""

    title = "Ask a lost device"

    def run(self, rig, control):
        raise OSError("no such port")


@pytest.fixture
def rig():
    made = VirtualRig(real_time=True)
    yield made
    made.close()


@pytest.fixture
def ask(rig):
    """Send commands to the executor of the rig; return the reply to the first and the events until then."""
    ours, theirs = Pipe()
    work = threading.Thread(target=RigExecutor(rig, ChildConnection(theirs)).work)
    work.start()
    events = []

    def asked(*commands, until=1, meanwhile=lambda: None):
        for number, command in enumerate(commands[:1], 1):
            ours.send(Request(number, command))
        meanwhile()
        for number, command in enumerate(commands[1:], 2):
            ours.send(Request(number, command))
        while True:
            assert ours.poll(PATIENCE_S), "no reply"
            message = ours.recv()
            if isinstance(message, Reply) and message.number == until:
                return message, events
            events.append(message)

    yield asked
    ours.close()
    work.join(PATIENCE_S)
    assert not work.is_alive()


def test_a_procedure_is_answered_with_its_result_and_reports_its_progress(ask, rig):
    reply, events = ask(RunProcedure(7, Visit((10.0, 20.0))))
    assert (reply.value, reply.error) == (2, None)
    steps = [event for event in events if isinstance(event, ProcedureProgress)]
    assert {event.number for event in steps} == {7}
    assert steps[-1].step.fraction == 1.0
    assert steps[-1].step.words == "at 20 um"
    assert [event.position for event in events if isinstance(event, StageMoved)] == [rig.stage.position()]


def test_a_stop_ends_a_procedure_with_the_rig_at_rest(ask, rig):
    def on_its_way():
        until = time.monotonic() + PATIENCE_S
        while rig.stage.position().x_um == 0.0:
            assert time.monotonic() < until, "the stage never moved"

    reply, _ = ask(RunProcedure(1, Visit((150_000.0, 0.0))), Stop(), meanwhile=on_its_way)
    assert isinstance(reply.error, MotionStopped)
    assert not rig.stage.moving()
    assert 0.0 < rig.stage.position().x_um < 150_000.0


@pytest.mark.parametrize(
    ("procedure", "message"),
    [(Fails(), "Nothing is in focus"), (Unplugged(), "no such port")],
    ids=["sample", "device"],
)
def test_a_failed_procedure_is_refused_with_its_reason_and_the_rig_goes_on(ask, rig, procedure, message):
    reply, _ = ask(RunProcedure(1, procedure), Move(x_um=5.0))
    assert isinstance(reply.error, RigError)
    assert message in str(reply.error)
    reply, _ = ask(RunProcedure(2, Visit((5.0,))))
    assert reply.value == 1


@pytest.mark.slow
def test_a_session_shows_a_procedure_as_work_and_cancels_it(session):
    coordinator = session._coordinator
    rig, queue = coordinator.rig, coordinator.command_queue
    seen = []
    running = queue.do(rig.run_procedure, Visit((150_000.0, 0.0) * 1000), seen.append)  # until it is cancelled
    shown = session.wait_until(lambda s: s.works and s.rig.state == "working", PATIENCE_S)
    (work,) = shown.works
    assert (work.title, work.cancellable) == ("Visit places", True)
    with pytest.raises(RigError, match=r"The rig is at work \(Visit places\): stop it or wait for its end to move"):
        session.move_to(x_um=0.0).result(PATIENCE_S)
    session.cancel(work.id)
    with pytest.raises(MotionStopped):
        running.result(PATIENCE_S)
    shown = session.wait_until(lambda s: not s.works, PATIENCE_S)
    assert shown.rig.state == "ready"
    assert queue.do(rig.run_procedure, Visit((1.0,)), seen.append).result(PATIENCE_S) == 1
    session.wait_until(lambda s: s.rig.state == "ready" and not s.works, PATIENCE_S)
    assert seen[-1].fraction == 1.0
