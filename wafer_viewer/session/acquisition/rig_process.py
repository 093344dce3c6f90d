"""Process that owns the rig: executes moves and scans, writes frames and journal, and sends reports.

When its pipe ends, because the viewer closed it or died, it stops motion, disarms the pulse box and exits.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from wafer_viewer.acquire.motion import (
    at_um,
    come_to_rest,
    device_errors,
    drive,
    jog,
    move,
    move_positioner,
    read_positioners,
)
from wafer_viewer.acquire.pass_runner import require_devices, rig_at_rest
from wafer_viewer.compute.child_process import ChildConnection, Request, run_in_background
from wafer_viewer.model.acquisition.devices import Rig, SampleChanger
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.positioners import PositionerReading
from wafer_viewer.model.acquisition.procedure import Procedure, ProcedureStep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import MotionStopped, RigError, WaferViewerError
from wafer_viewer.rigs.rig_config import RigConfig, open_rig
from wafer_viewer.session.acquisition.live_camera import JogHandle, LiveCamera
from wafer_viewer.session.acquisition.rig_messages import (
    Drive,
    Jog,
    Jogging,
    LiveTaken,
    LoadSample,
    Move,
    MovePositioner,
    OverviewReady,
    Pause,
    PositionersMoved,
    ProcedureProgress,
    Resume,
    RigAbsent,
    RigReady,
    RunProcedure,
    Scan,
    ScanEnded,
    StageMoved,
    Stop,
    WatchLive,
)
from wafer_viewer.session.acquisition.scan_run import REPORT_EVERY_S, Steering, run_scan_job, writer_of
from wafer_viewer.session.planning.guided_tour import tour_of
from wafer_viewer.session.surface.kernel_build import SIMULATION, compile_missing
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors


def run_rig(pipe: Connection, config: RigConfig) -> None:
    """Run the rig process until the pipe ends."""
    run_in_background()
    end = ChildConnection(pipe)
    try:
        rig = open_rig(config)
    except WaferViewerError as fault:
        end.tell(RigAbsent(str(fault)))
        return
    try:
        end.tell(_introduce(rig, config))
        if rig.simulated:
            compile_missing(SIMULATION, lambda _: None, end.is_closed)
        if end.is_closed():
            return
        end.tell(OverviewReady(rig.overview()))
        RigExecutor(rig, end).work()
    except WaferViewerError as fault:
        end.tell(RigAbsent(f"{fault} The next move or scan connects to the rig again."))
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
        positioners=read_positioners(rig),
    )


@dataclass(frozen=True, slots=True)
class RigCommand:
    """Queued command with the number of stops before it; a command queued before a stop is not started after it."""

    request: Request
    n_stops: int


@dataclass(frozen=True, slots=True)
class RunningScan:
    """Scan that has begun: its command was answered, and its end is reported as an event."""

    scan: Scan
    writer: DatasetWriter


class RigExecutor:
    """Executor of one command at a time; pause, resume and stop are received at once on a separate thread.

    That thread only counts and sets flags, which the moving thread polls, so a single thread uses the devices.
    """

    def __init__(self, rig: Rig, end: ChildConnection) -> None:
        self._rig, self._end = rig, end
        self._todo: queue.SimpleQueue[RigCommand | None] = queue.SimpleQueue()
        self._steering = Steering()
        self._steer = {Pause: self._steering.pause, Resume: self._steering.resume}
        self._n_stops = self._heeded = 0
        """Stops received so far, and the number received when motion was last interrupted."""
        self._handle, self._live = JogHandle(), LiveCamera(rig, end.tell)

    def work(self) -> None:
        """Execute commands until the pipe ends, and take live frames between them.

        Raises RigError when a device does not answer any more after a command failed: the rig has to be opened again.
        """
        threading.Thread(target=self._listen, name="verbs", daemon=True).start()
        while (order := self._next()) is not None:
            if not self._execute(order):
                self._live.suspend()
                require_devices(self._rig)

    def _execute(self, order: RigCommand) -> bool:
        """Carry out a command and reply to it once; a scan goes on after the reply. Return whether all went well."""
        try:
            result = self._carry_out(order)
        except WaferViewerError as fault:
            if isinstance(fault, MotionStopped):
                self._heeded = self._n_stops
            self._end.refuse(order.request, fault)
            return isinstance(fault, MotionStopped)
        if not isinstance(result, RunningScan):
            self._end.answer(order.request, result)
            return True
        self._end.answer(order.request)
        ended = self._scan_to_end(result)
        self._end.tell(ended)
        return ended.error is None

    def _next(self) -> RigCommand | None:
        """Return the next command; take live frames until there is one."""
        while self._live.watched:
            try:
                return self._todo.get(timeout=self._live.wait_s)
            except queue.Empty:
                self._live.take()
        self._live.suspend()
        return self._todo.get()

    def _listen(self) -> None:
        try:
            for request in self._end.requests():
                if self._is_done_at_once(request):
                    self._end.answer(request)
                else:
                    self._todo.put(RigCommand(request, self._n_stops))
        finally:
            self._steering.end()
            self._stop()
            self._todo.put(None)

    def _is_done_at_once(self, request: Request) -> bool:
        """Take a request on the listening thread; return whether nothing is left for the executor."""
        if (steer := self._steer.get(type(request.command))) is not None:
            steer()
            return True
        if isinstance(request.command, Stop):
            self._stop()
        return self._renewed(request)

    def _renewed(self, request: Request) -> bool:
        """Take a word that nothing has to be done about by the executor."""
        match request.command:
            case Jog() as word:
                return not self._handle.tell(word)
            case LiveTaken():
                self._live.acknowledge()
                return True
            case WatchLive(exposure_us):
                self._live.watch(exposure_us)
            case _:
                pass
        return False

    def _stop(self) -> None:
        self._handle.break_off()
        self._n_stops += 1
        self._steering.stop()

    def _carry_out(self, order: RigCommand) -> Any:
        """Return the reply to a command, or the scan that has begun."""
        if not isinstance(order.request.command, Jog | WatchLive):
            self._live.suspend()
        match order.request.command:
            case Scan() as scan:
                self._live.end()
                return self._begun_scan(order, scan)
            case Jog():
                return self._jog(order)
            case Drive() as way:
                return self._drive(order, way)
            case WatchLive():
                return None
            case Move() as goal:
                return self._move(order, goal)
            case MovePositioner() as goal:
                return self._move_positioner(order, goal)
            case RunProcedure(number, procedure):
                return self._run_procedure(order, number, procedure)
            case LoadSample() as load:
                return self._load(load.sample)
            case _:
                return order.n_stops <= self._heeded

    def _stopped_since(self, order: RigCommand) -> bool:
        return self._n_stops > order.n_stops

    def _move(self, order: RigCommand, to: Move) -> None:
        wanted: dict[Axis, float | None] = {"x": to.x_um, "y": to.y_um, "z": to.z_um}
        goal_um: dict[Axis, float] = {axis: um for axis, um in wanted.items() if um is not None}
        try:
            with device_errors("stage"):
                move(self._rig, goal_um, lambda: self._stopped_since(order))
        finally:
            self._report_position()

    def _drive(self, order: RigCommand, way: Drive) -> None:
        here = self._rig.stage.position()
        wanted: dict[Axis, float | None] = {"x": way.x_um, "y": way.y_um, "z": way.z_um}
        goal_um: dict[Axis, float] = {
            axis: um + at_um(here, axis) if way.by else um for axis, um in wanted.items() if um is not None
        }
        try:
            drive(self._rig, goal_um, way.highest_um, lambda: self._stopped_since(order))
        finally:
            self._report_position()

    def _move_positioner(self, order: RigCommand, goal: MovePositioner) -> PositionerReading:
        rig = self._rig
        try:
            return move_positioner(rig, goal.name, goal.to, lambda: self._stopped_since(order))
        finally:
            self._report_position()
            self._end.tell(PositionersMoved(read_positioners(rig), rig.limits, rig.setup, rig.calibration))

    def _jog(self, order: RigCommand) -> None:
        """Jog until the handle is released; the words may have ended while another command was executed.

        The position is reported besides that of the frames, because a busy machine takes none during a motion.
        """
        self._end.tell(Jogging(True))
        self._live.begin_motion()
        reported_s = time.monotonic()

        def look() -> None:
            nonlocal reported_s
            self._live.take_within(self._handle.left_s)
            if time.monotonic() - reported_s >= REPORT_EVERY_S:
                reported_s = time.monotonic()
                self._end.tell(StageMoved(self._rig.stage.position()))

        try:
            jog(self._rig, self._handle.velocity, self._handle.highest_um, look)
        finally:
            self._handle.taken = False
            if self._stopped_since(order):
                self._heeded = self._n_stops
            self._report_position()
            self._end.tell(Jogging(False))

    def _run_procedure(self, order: RigCommand, number: int, procedure: Procedure[Any]) -> Any:
        if self._stopped_since(order):
            raise MotionStopped(f"{procedure.title} was stopped before it began.")
        watch = _ProcedureWatch(
            lambda: self._stopped_since(order), lambda step: self._end.tell(ProcedureProgress(number, step))
        )
        try:
            with device_errors("rig", OSError), rig_at_rest(self._rig):
                return procedure.run(self._rig, watch)
        finally:
            with device_errors("stage"):
                come_to_rest(self._rig)
            self._report_position()

    def _load(self, sample: Sample | None) -> None:
        """Load a sample on a rig with a sample changer, and report the new overview."""
        if isinstance(self._rig, SampleChanger) and self._rig.load_sample(sample):
            self._end.tell(OverviewReady(self._rig.overview()))

    def _begun_scan(self, order: RigCommand, scan: Scan) -> RunningScan:
        self._load(scan.job.sample)
        self._steering.reset()
        if self._stopped_since(order):
            self._steering.stop()
        return RunningScan(scan, writer_of(scan, self._rig))

    def _scan_to_end(self, begun: RunningScan) -> ScanEnded:
        """Run a scan and leave the rig at rest; whatever ends it early is the error of its end."""
        scan, ended = begun.scan, ScanEnded(begun.scan.path, stopped=True, n_missing=0, error=None)
        try:
            with os_errors_as_dataset_errors(scan.path), begun.writer:
                ended = run_scan_job(scan, self._rig, begun.writer, self._end.tell, self._steering)
        except WaferViewerError as fault:
            ended = failed(ended, fault)
        if ended.stopped:
            self._heeded = self._n_stops
        try:
            with device_errors("stage"):
                come_to_rest(self._rig)
            self._report_position()
        except RigError as fault:
            ended = failed(ended, fault)
        return ended

    def _report_position(self) -> None:
        """Report the position and whether the stage is homed; an interrupted reference search leaves it not homed."""
        stage = self._rig.stage
        with device_errors("stage"):
            self._end.tell(StageMoved(stage.position(), stage.homed()))


def failed(ended: ScanEnded, fault: WaferViewerError) -> ScanEnded:
    """Return the end of a scan with a fault; the first one is its error."""
    return replace(ended, stopped=True, error=ended.error or str(fault))


class _ProcedureWatch:
    """Stop flag and reports of a procedure; it reports at most a few times a second, and always its end."""

    def __init__(self, should_stop: Callable[[], bool], tell: Callable[[ProcedureStep], None]) -> None:
        self._should_stop, self._tell = should_stop, tell
        self._reported_s = -REPORT_EVERY_S

    def should_stop(self) -> bool:
        """Return whether a stop was requested since the procedure was."""
        return self._should_stop()

    def report(self, step: ProcedureStep) -> None:
        """Report progress."""
        if step.fraction >= 1.0 or time.monotonic() - self._reported_s >= REPORT_EVERY_S:
            self._reported_s = time.monotonic()
            self._tell(step)
