"""The process that owns the rig: it carries out moves and scans, writes frames and journal, and reports.

When its pipe ends, because the viewer closed it or is gone, it stops motion, disarms the pulse box and exits.
"""

from __future__ import annotations

import queue
import threading
from multiprocessing.connection import Connection

from wafer_viewer.model.devices import Rig
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.rigs.config import RigConfig, open_rig
from wafer_viewer.session.link import Ask, ChildEnd, live_in_the_background
from wafer_viewer.session.messages import At, Move, Pause, Resume, RigAbsent, RigReady, SampleSeen, Scan, Stop
from wafer_viewer.session.scan_watch import Steering
from wafer_viewer.session.scanning import take, writer_of
from wafer_viewer.session.tour import tour_of


def run_rig(pipe: Connection, config: RigConfig) -> None:
    """Live as the rig's process until the pipe ends."""
    live_in_the_background()
    end = ChildEnd(pipe)
    try:
        rig = open_rig(config)
    except WaferViewerError as fault:
        end.tell(RigAbsent(str(fault)))
        return
    try:
        end.tell(_introduce(rig, config))
        end.tell(SampleSeen(rig.overview()))
        Operator(rig, end).work()
    finally:
        rig.close()


def _introduce(rig: Rig, config: RigConfig) -> RigReady:
    return RigReady(
        name=rig.name,
        simulated=rig.simulated,
        limits=rig.limits,
        setup=rig.setup,
        calibration=rig.calibration,
        position=rig.stage.position(),
        tour=tour_of(rig, config),
        homed=rig.stage.homed(),
    )


class Operator:
    """Carries out one verb at a time; what steers a running scan is heard at once, on a thread of its own."""

    def __init__(self, rig: Rig, end: ChildEnd) -> None:
        self._rig, self._end = rig, end
        self._todo: queue.SimpleQueue[Ask | None] = queue.SimpleQueue()
        self._steering = Steering()
        self._steer = {Pause: self._steering.pause, Resume: self._steering.resume, Stop: self._steering.stop}

    def work(self) -> None:
        """Work until the pipe ends."""
        threading.Thread(target=self._listen, name="verbs", daemon=True).start()
        while (ask := self._todo.get()) is not None:
            try:
                self._carry_out(ask)
            except WaferViewerError as fault:
                self._end.refuse(ask, fault)

    def _listen(self) -> None:
        for ask in self._end.verbs():
            if isinstance(ask.verb, Move | Scan):
                self._todo.put(ask)
            else:
                self._steer[type(ask.verb)]()
                self._end.answer(ask)
        self._steering.end()
        self._todo.put(None)

    def _carry_out(self, ask: Ask) -> None:
        if isinstance(ask.verb, Scan):
            self._scan(ask, ask.verb)
        else:
            self._move(ask, ask.verb)

    def _move(self, ask: Ask, move: Move) -> None:
        try:
            self._rig.stage.move_to(x_um=move.x_um, y_um=move.y_um, z_um=move.z_um)
        finally:
            self._end.tell(At(self._rig.stage.position()))
        self._end.answer(ask)

    def _scan(self, ask: Ask, scan: Scan) -> None:
        self._steering.reset()
        with writer_of(scan, self._rig) as writer:
            self._end.answer(ask)
            ended = take(scan, self._rig, writer, self._end.tell, self._steering)
        self._end.tell(At(self._rig.stage.position()))
        self._end.tell(ended)
