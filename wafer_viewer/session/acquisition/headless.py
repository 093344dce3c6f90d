"""Scans and procedures on the rig without a browser; Ctrl-C stops them with the rig at rest."""

from __future__ import annotations

import datetime
import signal
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from wafer_viewer._version import __version__
from wafer_viewer.acquire.conformance.bench import ConformanceCheck, TravelLimits
from wafer_viewer.acquire.conformance.runner import run_checks
from wafer_viewer.acquire.focus.search import FocusAtPlace, FocusedPlace
from wafer_viewer.acquire.motion import device_errors, move_positioner, positioner_of, read_positioners
from wafer_viewer.acquire.pass_runner import rig_at_rest
from wafer_viewer.model.acquisition.conformance import ConformanceReport, ConformanceResult
from wafer_viewer.model.acquisition.devices import Rig, SampleChanger
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.model.acquisition.procedure import FoundExposure, Procedure, ProcedureStep
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job, changed_settings
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import encode
from wafer_viewer.model.spec import replace as replace_spec
from wafer_viewer.rigs.rig_config import RigConfig, open_rig
from wafer_viewer.session.acquisition.live_controller import exposure_search
from wafer_viewer.session.acquisition.rig_messages import FrameTaken, Scan, ScanFault
from wafer_viewer.session.acquisition.scan_run import Steering, run_scan_job, writer_of
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.planning.plan_editor import free_bytes, look_before, plan_of
from wafer_viewer.session.planning.preflight import Preflight, PreflightCheck, preflight
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import remove_half_made
from wafer_viewer.store.records.calibration_records import calibration_in_force

# ---------------------------------------------------------------------------------------------------------- conformance


def check_conformance(
    rig: RigConfig,
    *,
    move: bool = False,
    longest_um: float | None = None,
    z_um: tuple[float, float] | None = None,
    by: str = "",
    rig_file: str = "",
    tell: Callable[[str], None] = lambda sentence: None,
    begin: Callable[[ConformanceCheck], None] = lambda check: None,
    done: Callable[[ConformanceResult], None] = lambda result: None,
    should_stop: ShouldStop = never,
) -> ConformanceReport:
    """Run the conformance checks on a rig and return their results; the rig is left at rest.

    Parameters
    ----------
    rig : RigConfig
        Configuration of the rig.
    move : bool
        Move the stage. Without it, the checks that need a motion are not run.
    longest_um : float or None
        Longest motion of x and y in um; None for as much as their full speed needs.
    z_um : tuple of two floats or None
        Range of z in um. None keeps z below where it stands, away from the objective; at the lower end of its range it
        moves up by as much as it needs.
    by : str
        Lab or person, for the report.
    rig_file : str
        Name of the rig's file, for the report.
    tell : callable
        Called with a sentence for each axis before it moves.
    begin : callable
        Called with each check before it runs.
    done : callable
        Called with each result.
    should_stop : callable
        Polled during motions. When it returns True, the stage stops and the remaining checks are not run.

    Returns
    -------
    ConformanceReport
        Results of all checks with the devices and the settings of the rig.

    Raises
    ------
    RigError
        When the rig cannot be opened, or a range is out of reach.
    """
    motions: list[str] = []
    results: list[ConformanceResult] = []

    def announce(sentence: str) -> None:
        motions.append(sentence)
        tell(sentence)

    opened = open_rig(rig)
    try:
        devices = opened.identities()
        travel = TravelLimits(longest_um=longest_um, z_um=z_um)
        checks = run_checks(opened, move=move, travel=travel, tell=announce, begin=begin, should_stop=should_stop)
        for result in checks:
            results.append(result)
            done(result)
        return ConformanceReport(
            rig=opened.name,
            simulated=opened.simulated,
            rig_file=rig_file,
            config=encode(rig),
            devices=devices,
            program_version=__version__,
            at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            by=by,
            motions=tuple(motions),
            results=tuple(results),
        )
    finally:
        opened.close()


# ------------------------------------------------------------------------------------------------------------- headless


Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Ended:
    """Outcome of a scan: a sentence for people, whether it was stopped, and the error that ended it."""

    words: str
    stopped: bool
    error: str | None


def scan_to(
    path: Path,
    job: Job,
    rig: Rig,
    tell: Progress,
    ready: Callable[[tuple[PreflightCheck, ...]], None],
    warn: Callable[[str], None],
) -> Ended:
    """Scan a job into a new dataset, or continue an unfinished one.

    A scan is continued by its own job, as long as `job` has the same values of all that frames depend on. `ready` is
    called with the preflight checks and may raise. `warn` is called with every fault of the running scan, and with the
    other settings that differ. Damaged frames are taken again. Raises DatasetError when the dataset cannot be written
    or there is nothing to take, PlanError when it belongs to another job.
    """
    remove_half_made(path)
    if path.exists():
        scan = _continued_scan(path, job, warn)
    else:
        scan = Scan(path, plan_of(job, rig.limits), job)
        ready(_preflight_checks(scan, rig))
    if isinstance(rig, SampleChanger):
        rig.load_sample(job.sample)
    steering = Steering()
    if (look := look_before(job, scan.plan)) is not None:
        scan = replace(scan, plan=plan_of(job, rig.limits, run_procedure(look, rig, tell)))

    def report(event: Any) -> None:
        if isinstance(event, FrameTaken):
            tell(event.progress.frames_done / event.progress.frames_total)
        elif isinstance(event, ScanFault):
            warn(event.what)

    with writer_of(scan, rig) as writer, interrupt_stops(steering.stop):
        ended = run_scan_job(scan, rig, writer, report, steering)
        n_stored = len(writer.kept)
    words = f"{n_stored} of {scan.plan.n_frames} frames kept"
    more = "; the same command continues it" if ended.stopped else ""
    return Ended(f"{words}{more}", ended.stopped, ended.error)


def find_exposure(job: Job, rig: Rig, fields: Sequence[int], tell: Progress) -> FoundExposure:
    """Find the exposure of a plan over fields with these numbers, or a few spread over it; Ctrl-C stops the rig.

    Raises PlanError when the rig cannot do the plan or it is released, RigError if no exposure suits, MotionStopped.
    """
    search = exposure_search(job, plan_of(job, rig.limits), fields)
    if isinstance(rig, SampleChanger):
        rig.load_sample(job.sample)
    return run_procedure(search, rig, tell)


def go_to_focus(
    rig: Rig,
    *,
    x_um: float | None = None,
    y_um: float | None = None,
    z_um: float | None = None,
    z_range_um: float | None = None,
    exposure_us: float | None = None,
    highest_um: float | None = None,
    progress: Progress | None = None,
) -> FocusedPlace:
    """Drive to a place and go to its focus; Ctrl-C stops the rig.

    Parameters
    ----------
    rig : Rig
        Open rig.
    x_um, y_um, z_um : float, optional
        Place on the stage and middle of the search, um. Default: where the stage stands.
    z_range_um : float, optional
        Range of z about the middle that the search looks at, um. Default: six depths of field to either side, and
        farther if nothing is in focus there.
    exposure_us : float, optional
        Exposure, us. Default: found automatically.
    highest_um : float, optional
        Highest z of the sample, which the objective stays clear of, um. Default: the middle of the search.
    progress : callable, optional
        Receives the finished fraction, 0 to 1.

    Returns
    -------
    FocusedPlace
        Place and exposure, and the focus with its z, standard uncertainty u (k = 1) and scores over z.

    Raises
    ------
    RigError
        If a device fails, nothing is in focus, or the place is out of range or too near to the sample.
    MotionStopped
        If interrupted by Ctrl-C: the rig is then at rest.
    """
    order = FocusAtPlace(
        x_um=x_um, y_um=y_um, z_um=z_um, z_range_um=z_range_um, exposure_us=exposure_us, highest_um=highest_um
    )
    return run_procedure(order, rig, progress or silent)


def run_procedure(procedure: Procedure[Result], rig: Rig, tell: Progress) -> Result:
    """Carry a procedure out; Ctrl-C stops it with the rig at rest, by MotionStopped."""
    control = ProcedureSteering(tell)
    with interrupt_stops(control.stop), device_errors("rig", OSError), rig_at_rest(rig):
        return procedure.run(rig, control)


def move_positioners(rig: Rig, goals: Sequence[tuple[str, str]]) -> tuple[PositionerState, ...]:
    """Move positioners one after the other, and return all of the rig with their positions; Ctrl-C stops the rig.

    Raises RigError if one does not exist or cannot go there, before any of them moves. MotionStopped if stopped.
    """
    for name, to in goals:
        positioner_of(rig, name).limits.goal(name, to)
    steering = Steering()
    with interrupt_stops(steering.stop), rig_at_rest(rig):
        for name, to in goals:
            move_positioner(rig, name, to, steering.should_stop)
    return read_positioners(rig)


class ProcedureSteering(Steering):
    """Stop flag of a procedure, and its progress."""

    def __init__(self, tell: Progress) -> None:
        super().__init__()
        self._tell = tell

    def report(self, step: ProcedureStep) -> None:
        """Report the progress."""
        self._tell(step.fraction)


def _continued_scan(path: Path, job: Job, warn: Callable[[str], None]) -> Scan:
    """Return the rest of a scan by its own job; settings that no frame depends on may differ from it."""
    begun = Dataset.open(path).scan
    of_frames, others = changed_settings(replace_spec(begun.job, compression=job.compression), job)
    if of_frames:
        raise PlanError(
            f"{path} was started with another plan, which has other values of {', '.join(of_frames)}: choose another "
            "name, or give the plan it was started with."
        )
    if others:
        warn(f"{path.name} keeps the values of {', '.join(others)} that it was started with; the plan has others.")
    return Scan(path, begun.plan, begun.job, goes_on=True)


def _preflight_checks(scan: Scan, rig: Rig) -> tuple[PreflightCheck, ...]:
    return preflight(
        Preflight(
            job=scan.job,
            plan=scan.plan,
            limits=rig.limits,
            simulated=rig.simulated,
            calibration=calibration_in_force(scan.path.absolute().parent, rig.name, rig.calibration),
            setup=rig.setup,
            free_bytes=free_bytes(scan.path.absolute().parent),
            z_um=rig.stage.position().z_um,
            today=today(),
        )
    )


@contextmanager
def interrupt_stops(stop: Callable[[], None]) -> Generator[None]:
    """Make Ctrl-C call `stop` instead of ending the program, which ends once the rig is at rest."""
    before = signal.signal(signal.SIGINT, lambda *_: stop())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
