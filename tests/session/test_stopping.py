"""A stop from afar: what the rig's process does with it, and what a session makes of that."""

from __future__ import annotations

import threading
import time
from multiprocessing import Pipe

import numpy as np
import pytest

from wafer_viewer.model.errors import MotionStopped
from wafer_viewer.rigs.config import RigConfig
from wafer_viewer.rigs.virtual.rig import VirtualRig
from wafer_viewer.session.drafting import plan_of
from wafer_viewer.session.link import Answer, Ask, ChildEnd
from wafer_viewer.session.messages import At, Move, Scan, ScanEnded, Stop
from wafer_viewer.session.rig_process import Operator
from wafer_viewer.session.session import Session

FAR_UM = 150_000.0
"""The stage needs a second and a half for it."""


class Grey:
    """Renders the same grey picture everywhere."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        return np.full((540, 720), 99, np.uint8)


class Desk:
    """The near end of an operator's pipe: asks, and sorts what comes up."""

    def __init__(self, pipe):
        self.pipe, self.events = pipe, []

    def ask(self, *asks):
        for number, verb in asks:
            self.pipe.send(Ask(number, verb))

    def answer(self, number):
        """What came to the asker; what the rig told meanwhile is in `events`."""
        while True:
            assert self.pipe.poll(60.0), f"no answer to {number}"
            message = self.pipe.recv()
            if isinstance(message, Answer) and message.number == number:
                return message
            self.events.append(message)

    def where(self):
        return [event for event in self.events if isinstance(event, At)][-1].position


@pytest.fixture
def rig():
    made = VirtualRig(renderer=Grey(), real_time=True)
    yield made
    made.close()


@pytest.fixture
def desk(rig):
    ours, theirs = Pipe()
    work = threading.Thread(target=Operator(rig, ChildEnd(theirs)).work)
    work.start()
    made = Desk(ours)
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


def test_a_stop_breaks_off_the_move_under_way_and_forgets_those_behind_it(rig, desk):
    desk.ask((1, Move(x_um=FAR_UM)), (2, Move(x_um=-FAR_UM)))
    on_its_way(rig)
    desk.ask((3, Stop()), (4, Stop()))
    first, second = desk.answer(1), desk.answer(2)
    assert isinstance(first.error, MotionStopped)
    assert isinstance(second.error, MotionStopped)
    assert desk.answer(3).value
    assert desk.answer(4).value
    stood = desk.where()
    assert stood == rig.stage.position()
    assert 0.0 < stood.x_um < FAR_UM
    assert f"X {stood.x_um / 1000:+.4f}" in str(first.error)

    desk.ask((5, Stop()), (6, Move(x_um=stood.x_um + 100.0)))
    assert not desk.answer(5).value
    assert desk.answer(6).error is None
    assert desk.where().x_um == pytest.approx(stood.x_um + 100.0)


def test_the_end_of_the_pipe_breaks_off_a_move(rig, desk):
    desk.ask((1, Move(x_um=FAR_UM)))
    on_its_way(rig)
    desk.pipe.send(None)
    assert isinstance(desk.answer(1).error, MotionStopped)
    desk.work.join(60.0)
    assert not rig.stage.moving()
    assert rig.stage.position().x_um < FAR_UM


def test_a_scan_that_waited_behind_a_move_ends_with_it(rig, desk, job, tmp_path):
    made = job()
    scan = Scan(tmp_path / "scan.wafer", plan_of(made, rig.limits), made)
    desk.ask((1, Move(x_um=FAR_UM)), (2, scan))
    on_its_way(rig)
    desk.ask((3, Stop()))
    assert isinstance(desk.answer(1).error, MotionStopped)
    assert desk.answer(3).value
    (ended,) = (event for event in desk.events if isinstance(event, ScanEnded))
    assert (ended.stopped, ended.error) == (True, None)
    assert rig.stage.position().x_um < FAR_UM


@pytest.mark.slow
def test_a_session_stops_any_motion_and_goes_on(tmp_path, patience_s):
    session = Session(tmp_path, RigConfig(real_time=True))
    try:
        session.wait_until(lambda s: s.rig.state == "ready", patience_s)
        assert session.stop().result(patience_s) is False
        away, back = session.move_to(x_um=FAR_UM), session.move_to(x_um=0.0)
        session.wait_until(lambda s: s.rig.state == "moving", patience_s)
        assert session.stop().result(patience_s) is True
        for move in (away, back):
            with pytest.raises(
                MotionStopped, match=r"^The move was stopped at X \+[\d.]+, Y \+0\.0000, Z \+0\.0000 mm"
            ):
                move.result(patience_s)
        stood = session.snapshot.rig
        assert stood.state == "ready"
        assert 0.0 <= stood.x_um < FAR_UM
        session.move_to(x_um=stood.x_um + 250.0, z_um=40.0).result(patience_s)
        there = session.snapshot.rig
        assert (there.state, there.x_um - stood.x_um, there.z_um) == ("ready", pytest.approx(250.0), 40.0)
    finally:
        session.close()
