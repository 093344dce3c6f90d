"""A stop from afar: what the rig's process does with it, and what a session makes of that."""

from __future__ import annotations

import dataclasses
import threading
import time
from concurrent.futures import Future
from multiprocessing import Pipe

import numpy as np
import pytest

from wafer_viewer.compute.child_process import ChildConnection, Reply, Request
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.errors import MotionStopped
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.rig import VirtualRig
from wafer_viewer.session.acquisition import rig_client as instrument_module
from wafer_viewer.session.acquisition.rig_client import RigCallbacks, RigClient
from wafer_viewer.session.acquisition.rig_messages import Move, Scan, ScanEnded, StageMoved, Stop
from wafer_viewer.session.acquisition.rig_process import RigExecutor
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue as SessionDesk
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

FAR_UM = 150_000.0
"""The stage needs a second and a half for it."""


class Grey:
    """Renders the same grey picture everywhere."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        return np.full((540, 720), 99, np.uint8)


class NearEnd:
    """The near end of an operator's pipe: asks, and sorts what comes up."""

    def __init__(self, pipe):
        self.pipe, self.events = pipe, []

    def ask(self, *asks):
        for number, command in asks:
            self.pipe.send(Request(number, command))

    def answer(self, number):
        """What came to the asker; what the rig told meanwhile is in `events`."""
        while True:
            assert self.pipe.poll(60.0), f"no answer to {number}"
            message = self.pipe.recv()
            if isinstance(message, Reply) and message.number == number:
                return message
            self.events.append(message)

    def where(self):
        return [event for event in self.events if isinstance(event, StageMoved)][-1].position


@pytest.fixture
def rig():
    made = VirtualRig(renderer=Grey(), real_time=True)
    yield made
    made.close()


@pytest.fixture
def command_queue(rig):
    ours, theirs = Pipe()
    work = threading.Thread(target=RigExecutor(rig, ChildConnection(theirs)).work)
    work.start()
    made = NearEnd(ours)
    made.work = work
    yield made
    ours.close()
    work.join(60.0)
    assert not work.is_alive()


def on_its_way(rig):
    """Wait until the stage has left where it was."""
    until = time.monotonic() + 60.0
    while rig.stage.position().x_um == 0.0:
        assert time.monotonic() < until, "the stage never moved"


def test_a_stop_breaks_off_the_move_under_way_and_forgets_those_behind_it(rig, command_queue):
    command_queue.ask((1, Move(x_um=FAR_UM)), (2, Move(x_um=-FAR_UM)))
    on_its_way(rig)
    command_queue.ask((3, Stop()), (4, Stop()))
    first, second = command_queue.answer(1), command_queue.answer(2)
    assert isinstance(first.error, MotionStopped)
    assert isinstance(second.error, MotionStopped)
    assert command_queue.answer(3).value
    assert command_queue.answer(4).value
    stood = command_queue.where()
    assert stood == rig.stage.position()
    assert 0.0 < stood.x_um < FAR_UM
    assert f"X {stood.x_um / 1000:+.4f}" in str(first.error)

    command_queue.ask((5, Stop()), (6, Move(x_um=stood.x_um + 100.0)))
    assert not command_queue.answer(5).value
    assert command_queue.answer(6).error is None
    assert command_queue.where().x_um == pytest.approx(stood.x_um + 100.0)


def test_the_end_of_the_pipe_breaks_off_a_move(rig, command_queue):
    command_queue.ask((1, Move(x_um=FAR_UM)))
    on_its_way(rig)
    command_queue.pipe.send(None)
    assert isinstance(command_queue.answer(1).error, MotionStopped)
    command_queue.work.join(60.0)
    assert not rig.stage.moving()
    assert rig.stage.position().x_um < FAR_UM


def test_a_scan_that_waited_behind_a_move_ends_with_it(rig, command_queue, job, tmp_path):
    made = job()
    scan = Scan(tmp_path / "scan.wafer", plan_of(made, rig.limits), made)
    command_queue.ask((1, Move(x_um=FAR_UM)), (2, scan))
    on_its_way(rig)
    command_queue.ask((3, Stop()))
    assert isinstance(command_queue.answer(1).error, MotionStopped)
    assert command_queue.answer(3).value
    (ended,) = (event for event in command_queue.events if isinstance(event, ScanEnded))
    assert (ended.stopped, ended.error) == (True, None)
    assert rig.stage.position().x_um < FAR_UM


def test_a_search_for_the_reference_that_was_broken_off_leaves_it_not_homed(rig, command_queue, monkeypatch):
    monkeypatch.setattr(rig.stage, "homed", lambda: False)
    command_queue.ask((1, Move(x_um=FAR_UM)))
    on_its_way(rig)
    command_queue.ask((2, Stop()))
    assert command_queue.answer(2).value
    assert [event.homed for event in command_queue.events if isinstance(event, StageMoved)] == [False]


class StandingLink:
    """Stands for the way to the rig's process: keeps what was asked, and its test answers and tells."""

    alive = True

    def __init__(self, name, target, args, on_event, on_exit):
        self.tell, self.asked = on_event, []

    def ask(self, command):
        self.asked.append((command, Future()))
        return self.asked[-1][1]


@pytest.fixture
def instrument(monkeypatch):
    """An instrument whose rig is ready and stands still, and its session's desk."""
    monkeypatch.setattr(instrument_module, "ChildProcess", StandingLink)
    command_queue = SessionDesk(Snapshot(rig=RigStatus(state="ready", homed=True)))
    nobody = RigCallbacks(*[lambda _: None] * len(dataclasses.fields(RigCallbacks)))
    made = RigClient(command_queue, Notifications(command_queue), RigConfig(), nobody)
    link = command_queue.do(made.start).result()
    command_queue.do(command_queue.change, rig=RigStatus(state="ready", homed=True)).result()
    yield made, command_queue, link
    command_queue.close()


def test_it_moves_from_the_first_of_several_moves_to_the_end_of_the_last(instrument):
    rig, command_queue, link = instrument
    moves = [command_queue.do(rig.move_to, Move(x_um=x_um)) for x_um in (1.0, 2.0)]
    command_queue.wait_until(lambda s: s.rig.state == "moving", 60.0)
    command_queue.do(lambda: None).result()
    link.tell(StageMoved(Position(1.0, 0.0, 0.0), homed=True))
    link.asked[0][1].set_result(None)
    moves[0].result(60.0)
    assert (command_queue.snapshot.rig.state, command_queue.snapshot.rig.x_um) == ("moving", 1.0)
    link.tell(StageMoved(Position(1.5, 0.0, 0.0), homed=False))
    link.asked[1][1].set_exception(MotionStopped.at(1.5, 0.0, 0.0))
    with pytest.raises(MotionStopped):
        moves[1].result(60.0)
    stood = command_queue.snapshot.rig
    assert (stood.state, stood.x_um, stood.homed) == ("ready", 1.5, False)


def test_a_move_that_waited_when_a_stop_came_is_not_begun(instrument):
    rig, command_queue, link = instrument
    asked_before = rig.n_stops
    rig.stop_at_once()
    with pytest.raises(MotionStopped, match=r"stopped at X \+0\.0000"):
        command_queue.do(rig.move_to, Move(x_um=1.0), asked_before).result(60.0)
    assert command_queue.snapshot.rig.state == "ready"
    command_queue.do(rig.move_to, Move(x_um=2.0), rig.n_stops)
    command_queue.wait_until(lambda s: s.rig.state == "moving", 60.0)
    assert [command for command, _ in link.asked] == [Stop(), Move(x_um=2.0)]


def test_no_move_is_sent_after_a_stop_that_came_while_it_was_on_its_way(instrument, monkeypatch):
    rig, command_queue, link = instrument
    begin = rig.start

    def stopped_meanwhile():
        rig.stop_at_once()
        return begin()

    monkeypatch.setattr(rig, "start", stopped_meanwhile)
    with pytest.raises(MotionStopped):
        command_queue.do(rig.move_to, Move(x_um=1.0), rig.n_stops).result(60.0)
    assert [command for command, _ in link.asked] == [Stop()]
    assert command_queue.snapshot.rig.state == "ready"


def test_without_a_process_nothing_moves(instrument, monkeypatch):
    rig, _, link = instrument
    monkeypatch.setattr(StandingLink, "alive", False)
    assert rig.break_off().result(0) is False
    assert link.asked == []


@pytest.mark.slow
def test_a_session_stops_any_motion_and_stays_usable(tmp_path, patience_s):
    session = Session(tmp_path, RigConfig(real_time=True))
    try:
        session.wait_until(lambda s: s.rig.state == "ready", patience_s)
        assert session.stop().result(patience_s) is False
        moves = [session.move_to(x_um=x_um) for x_um in (FAR_UM, 0.0) * 10]  # a busy machine may hear of some too late
        session.wait_until(lambda s: s.rig.state == "moving", patience_s)
        assert session.stop().result(patience_s) is True
        ended = next(k for k, move in enumerate(moves) if move.exception(patience_s) is not None)
        assert ended < len(moves) - 1
        for move in moves[ended:]:
            with pytest.raises(
                MotionStopped, match=r"^The move was stopped at X \+[\d.]+, Y \+0\.0000, Z \+0\.0000 mm"
            ):
                move.result(patience_s)
        stood = session.snapshot.rig
        assert stood.state == "ready"
        assert 0.0 <= stood.x_um <= FAR_UM
        session.move_to(x_um=stood.x_um + 250.0, z_um=40.0).result(patience_s)
        present = session.snapshot.rig
        assert (present.state, present.x_um - stood.x_um, present.z_um) == ("ready", pytest.approx(250.0), 40.0)
    finally:
        session.close()


@pytest.mark.slow
def test_a_session_stops_a_scan_by_the_same_verb(session, job, patience_s):
    session.edit_job(job(cols=2, rows=2, n_frames=60, z_step_um=0.8)).result()
    session.start_scan("stopped").result(patience_s)
    session.wait_until(lambda s: s.scan is not None and s.scan.frames_done > 5, patience_s)
    assert session.stop().result(patience_s) is True
    stopped = session.snapshot
    assert (stopped.rig.state, stopped.dataset.finished) == ("ready", False)
    assert session.stop().result(patience_s) is False
