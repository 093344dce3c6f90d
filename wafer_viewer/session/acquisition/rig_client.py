"""Client of the rig process: sends moves and scans, and updates the snapshot from its reports."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any, TypeVar

from wafer_viewer.compute.child_process import ChildProcess
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.procedure import Procedure, ProcedureStep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError, MotionStopped, RigError
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.acquisition.rig_messages import (
    Drive,
    FieldComplete,
    FrameTaken,
    Jog,
    Jogging,
    LiveFailed,
    LiveTaken,
    LoadSample,
    Move,
    MovePositioner,
    OverviewReady,
    Pause,
    Paused,
    PositionersMoved,
    ProcedureProgress,
    Resume,
    RigAbsent,
    RigReady,
    RunProcedure,
    Scan,
    ScanEnded,
    ScanFault,
    StageMoved,
    Stop,
    WatchLive,
)
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command
from wafer_viewer.session.state.instrument_state import LiveFrame
from wafer_viewer.session.state.snapshot import LatestFrame, RigStatus, Snapshot

Result = TypeVar("Result")


def _ignore_step(_: ProcedureStep) -> None: ...


@dataclass(frozen=True, slots=True)
class RunningProcedure:
    """Work item of a running procedure and the receiver of its steps."""

    work_id: str
    on_step: Callable[[ProcedureStep], None]


@dataclass(frozen=True, slots=True)
class RigCallbacks:
    """Callbacks for events of the rig; called on the session's thread."""

    ready: Callable[[RigReady], None]
    overview_ready: Callable[[OverviewReady], None]
    frame_taken: Callable[[FrameTaken], None]
    field_complete: Callable[[int], None]
    scan_ended: Callable[[ScanEnded | None], None]
    """Called with None when the rig process died during a scan."""
    live_frame: Callable[[LiveFrame], None]
    """Called on the thread that reads the pipe, so that frames do not wait for commands."""
    live_failed: Callable[[str], None]
    optics_changed: Callable[[], None]
    """Called when another objective or zoom has changed the limits."""


class RigClient:
    """Rig of the snapshot. Use on the session's thread only."""

    def __init__(
        self, command_queue: CommandQueue, notices: Notifications, config: RigConfig, reports: RigCallbacks
    ) -> None:
        self._command_queue, self._notices, self._config, self._reports = command_queue, notices, config, reports
        self._link: ChildProcess | None = None
        self._sample: Sample | None = None
        """Sample of the last load request."""
        self._moves = 0
        """Number of moves requested and not finished."""
        self._numbers = count(1)
        self._procedures: dict[int, RunningProcedure] = {}
        self.n_stops = 0
        """Number of stops requested from other threads, ahead of the queued commands."""
        self._sending = Lock()
        """Held while a move is sent unless it was stopped, and while a stop is: no move follows a stop by chance."""
        self.latest_frame: LatestFrame | None = None
        self._on = {
            RigReady: self._ready,
            OverviewReady: reports.overview_ready,
            RigAbsent: self._absent,
            StageMoved: self._at,
            PositionersMoved: self._positioners_moved,
            Paused: self._paused,
            Jogging: self._jogging,
            LiveFailed: lambda event: reports.live_failed(event.why),
            FrameTaken: self._frame_taken,
            ProcedureProgress: self._procedure_step,
            FieldComplete: lambda event: reports.field_complete(event.number),
            ScanFault: self._scan_fault,
            ScanEnded: self._scan_ended,
        }

    def start(self) -> ChildProcess:
        """Return the connection to a running rig process; start the process if none is running."""
        if self._link is None or not self._link.alive:
            self._show(state="starting", message="")
            self._link = ChildProcess("wafer-viewer rig", _own_rig, (self._config,), self._heard, self._gone)
            if self._sample is not None:
                self._link.ask(LoadSample(self._sample))
        return self._link

    def load(self, sample: Sample | None) -> None:
        """Load a sample on a rig with a sample changer; a rig that is not running loads it when it starts."""
        if sample == self._sample:
            return
        self._sample = sample
        if self._link is not None and self._link.alive:
            self._link.ask(LoadSample(sample))

    def move_to(self, move: Move | Drive | MovePositioner, n_stops: int | None = None) -> Future[Any]:
        """Move the stage or a positioner.

        The future is done on arrival, or fails with MotionStopped. Raises MotionStopped when more than `n_stops` stops
        were requested since.
        """
        self.require_idle("move a positioner" if isinstance(move, MovePositioner) else "move the stage")
        link = self.start()
        with self._sending:
            if n_stops is not None and n_stops < self.n_stops:
                stood = self._command_queue.now.rig
                raise MotionStopped.at(stood.x_um, stood.y_um, stood.z_um)
            arrived = link.ask(move)
        self._moves += 1
        self._show_moves()
        return self._command_queue.afterwards(arrived, self._move_over)

    def jog(self, word: Jog) -> Future[None]:
        """Send a word of a jog, from any thread: it must not wait for commands.

        The future of the first word is done when the stage is at rest again.
        """
        self.require_idle("move the stage", self._command_queue.snapshot)
        if self._link is None or not self._link.alive:
            raise RigError("The rig does not answer: move the stage once to start it again.")
        return self._link.ask(word)

    def watch_live(self, exposure_us: float) -> None:
        """Show the live view for some more seconds, from any thread; without effect while the rig is busy."""
        now = self._command_queue.snapshot
        if self._link is not None and self._link.alive and now.rig.state in ("ready", "moving"):
            self._link.ask(WatchLive(exposure_us))

    def run_procedure(
        self, procedure: Procedure[Result], on_step: Callable[[ProcedureStep], None] = _ignore_step
    ) -> Future[Result]:
        """Carry out a procedure, shown as work that can be cancelled; cancelling it stops the rig.

        The future has its result. `on_step` is called with its progress on the session's thread.
        """
        self.require_idle(procedure.title[0].lower() + procedure.title[1:])
        link, number = self.start(), next(self._numbers)
        work_id = self._notices.begin(procedure.title, stop=self._cancel_procedure)
        self._procedures[number] = RunningProcedure(work_id, on_step)
        self._show(state="working", message=procedure.title)
        return self._command_queue.afterwards(
            link.ask(RunProcedure(number, procedure)), lambda: self._procedure_over(number)
        )

    def scan(self, scan: Scan) -> Future[None]:
        """Start a scan; the future is done once the scan has started."""
        link = self.start()
        self._show(state="scanning", message="")
        begun = link.ask(scan)
        begun.add_done_callback(lambda done: self._command_queue.note(self._begun, done))
        return begun

    @command
    def pause(self) -> Future[None]:
        """Pause at the end of the current pass."""
        self._require_scan("pause")
        self._show(message="Halts at the end of this pass.")
        return self.start().ask(Pause())

    @command
    def resume(self) -> Future[None]:
        """Resume after a pause."""
        self._require_scan("continue")
        self._show(message="")
        return self.start().ask(Resume())

    def stop_at_once(self) -> Future[bool]:
        """Stop motion from any thread, ahead of queued commands; queued moves are not started."""
        with self._sending:
            self.n_stops += 1
            return self.break_off()

    def break_off(self) -> Future[bool]:
        """Stop all motion, from any thread.

        The future is done when the rig is at rest; its result is True if anything was moving.
        """
        if self._link is not None and self._link.alive:
            return self._link.ask(Stop())
        nothing: Future[bool] = Future()
        nothing.set_result(False)
        return nothing

    def stop_scan(self) -> None:
        """End the scan and bring the rig to rest."""
        self._require_scan("stop")
        self._show(state="stopping", message="")
        self.break_off()

    def require_idle(self, purpose: str, now: Snapshot | None = None) -> None:
        """Raise RigError while a scan or a procedure is running; `now`: on another thread than the session's."""
        now = now or self._command_queue.now
        if now.scanning:
            raise RigError(f"A scan is running: stop it or wait for its end to {purpose}.")
        if now.rig.state == "working":
            raise RigError(f"The rig is at work ({now.rig.message}): stop it or wait for its end to {purpose}.")

    def close(self) -> None:
        """Stop motion, disarm the pulse box and end the process."""
        if self._link is not None:
            self._link.close()

    def _heard(self, event: Any) -> None:
        if isinstance(event, LiveFrame):
            self._reports.live_frame(event)
            if self._link is not None:
                self._link.ask(LiveTaken())
            return
        self._command_queue.note(self._on[type(event)], event)

    def _gone(self, exit_code: int | None) -> None:
        self._command_queue.note(self._died, exit_code)

    def _ready(self, event: RigReady) -> None:
        state = "scanning" if self._command_queue.now.scanning else "ready"
        status = RigStatus(
            event.name,
            event.simulated,
            state,
            limits=event.limits,
            calibration=self._calibration(event.name, event.calibration),
            setup=event.setup,
            positioners=event.positioners,
            homed=event.homed,
        )
        self._command_queue.change(rig=status)
        self._at(StageMoved(event.position))
        self._show_moves()
        self._reports.ready(event)

    def _positioners_moved(self, event: PositionersMoved) -> None:
        before = self._command_queue.now.rig
        calibration = self._calibration(before.name, event.calibration)
        self._show(positioners=event.positioners, limits=event.limits, setup=event.setup, calibration=calibration)
        if event.limits != before.limits:
            self._reports.optics_changed()

    def _calibration(self, rig: str, own: Calibration | None) -> Calibration | None:
        """Return the calibration in force: a later correction if there is one, else the rig's own."""
        from wafer_viewer.store.records.calibration_records import calibration_in_force

        try:
            return calibration_in_force(self._command_queue.now.data_folder, rig, own)
        except DatasetError as fault:
            self._notices.fault("The rig's calibration is not known", str(fault), "rig")
            return None

    def _absent(self, event: RigAbsent) -> None:
        """Await the end of the process, so that the next one can open the devices."""
        self.close()
        self._show(state="absent", message=event.why)

    def _at(self, event: StageMoved) -> None:
        p, homed = event.position, event.homed
        is_homed = self._command_queue.now.rig.homed if homed is None else homed
        self._show(x_um=p.x_um, y_um=p.y_um, z_um=p.z_um, homed=is_homed)

    def _jogging(self, event: Jogging) -> None:
        self._moves += 1 if event.jogging else -1
        self._show_moves()

    def _move_over(self) -> None:
        self._moves -= 1
        self._show_moves()

    def _show_moves(self) -> None:
        """Show the rig as moving from the start of the first of several moves to the end of the last."""
        if self._command_queue.now.rig.state in ("ready", "moving"):
            self._show(state="moving" if self._moves else "ready")

    def _paused(self, event: Paused) -> None:
        if self._command_queue.now.rig.state != "stopping":
            self._show(state="paused" if event.paused else "scanning", message="")

    def _frame_taken(self, event: FrameTaken) -> None:
        self.latest_frame = event.latest or self.latest_frame
        self._at(StageMoved(event.position))
        self._command_queue.change(scan=event.progress)
        self._reports.frame_taken(event)

    def _procedure_step(self, event: ProcedureProgress) -> None:
        if (running := self._procedures.get(event.number)) is not None:
            self._notices.progress(running.work_id, event.step.fraction)
            running.on_step(event.step)

    def _cancel_procedure(self) -> None:
        self.stop_at_once()

    def _procedure_over(self, number: int) -> None:
        self._notices.end(self._procedures.pop(number).work_id)
        if self._command_queue.now.rig.state == "working":
            self._show(state="moving" if self._moves else "ready", message="")

    def _scan_fault(self, event: ScanFault) -> None:
        self._notices.fault("The scan reports a fault", event.what, "scan")

    def _begun(self, done: Future[None]) -> None:
        if done.exception() is not None and self._command_queue.now.scanning:
            self._show(state="ready")

    def _scan_ended(self, event: ScanEnded) -> None:
        self._show(state="ready", message="")
        if event.error is not None:
            self._notices.fault("The scan stopped", f"{event.error} The frames of complete passes are kept.", "scan")
        self._reports.scan_ended(event)

    def _died(self, exit_code: int | None) -> None:
        """Report that the process died unexpectedly."""
        snapshot = self._command_queue.now
        remark = " The frames of complete passes are kept." if snapshot.scanning else ""
        text = f"The rig's process ended (exit code {exit_code}).{remark}"
        self._show(state="fault", message=f"{text} The next move or scan restarts it.")
        self._notices.fault("The rig stopped answering", f"{text} The next move or scan restarts it.", "rig")
        if snapshot.scanning:
            self._reports.scan_ended(None)

    def _require_scan(self, purpose: str) -> None:
        if not self._command_queue.now.scanning:
            raise RigError(f"No scan is running: there is nothing to {purpose}.")

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(rig=replace(self._command_queue.now.rig, **changes))


def _own_rig(pipe: Connection, config: RigConfig) -> None:
    from wafer_viewer.session.acquisition.rig_process import run_rig

    run_rig(pipe, config)
