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
from wafer_viewer.session.messages import At, Move, Pause, Resume, RigAbsent, RigReady, Scan, ScanEnded, Stop
from wafer_viewer.session.scan_watch import ScanWatch, Steering
from wafer_viewer.session.tour import tour_of
from wafer_viewer.store.files import writing
from wafer_viewer.store.writer import DatasetWriter


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
        overview=rig.overview(),
        position=rig.stage.position(),
        tour=tour_of(rig, config),
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
        with self._writer(scan) as writer:
            self._end.answer(ask)
            ended = self._take(scan, writer)
        self._end.tell(At(self._rig.stage.position()))
        self._end.tell(ended)

    def _take(self, scan: Scan, writer: DatasetWriter) -> ScanEnded:
        """Run the scan; whatever ends it before its time becomes a sentence, for its dataset can be gone on with."""
        from wafer_viewer.acquire.runner import run_scan

        watch = ScanWatch(writer, scan.plan, self._end, self._steering)
        try:
            with writing(scan.path):
                outcome = run_scan(scan.plan, self._rig, watch, watch, skip=writer.kept)
                if not outcome.stopped:
                    writer.finish()
        except WaferViewerError as fault:
            return ScanEnded(scan.path, stopped=True, n_missing=0, error=str(fault))
        finally:
            watch.finish()
        return ScanEnded(scan.path, outcome.stopped, len(outcome.missing), error=None)

    def _writer(self, scan: Scan) -> DatasetWriter:
        if scan.goes_on:
            return DatasetWriter.resume(scan.path)
        rig = self._rig
        return DatasetWriter.create(
            scan.path,
            scan.plan,
            scan.job,
            calibration=rig.calibration,
            setup=rig.setup,
            rig=rig.name,
            simulated=rig.simulated,
            bits=rig.limits.camera.bits,
        )
