"""Scans without a browser: start or continue a scan; Ctrl-C stops it with the rig at rest."""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.devices import Rig, SampleChanger
from wafer_viewer.model.errors import DatasetError, PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress
from wafer_viewer.session.acquisition.rig_messages import FrameTaken, Scan, ScanFault
from wafer_viewer.session.acquisition.scan_run import Steering, run_scan_job, writer_of
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.planning.plan_editor import free_bytes, plan_of
from wafer_viewer.session.planning.preflight import Preflight, PreflightCheck, preflight
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.gauge_records import calibration_in_force


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

    `ready` is called with the preflight checks and may raise. `warn` is called with every fault of the running scan.
    Raises DatasetError when the dataset cannot be written, PlanError when it belongs to another job.
    """
    if path.exists():
        scan = _continued_scan(path, job)
    else:
        scan = Scan(path, plan_of(job, rig.limits), job)
        ready(_preflight_checks(scan, rig))
    if isinstance(rig, SampleChanger):
        rig.load_sample(job.sample)
    steering = Steering()

    def report(event: Any) -> None:
        if isinstance(event, FrameTaken):
            tell(event.progress.frames_done / event.progress.frames_total)
        elif isinstance(event, ScanFault):
            warn(event.what)

    with writer_of(scan, rig) as writer, _interrupt_stops(steering):
        ended = run_scan_job(scan, rig, writer, report, steering)
        n_stored = len(writer.kept)
    words = f"{n_stored} of {scan.plan.n_frames} frames kept"
    more = "; the same command continues it" if ended.stopped else ""
    return Ended(f"{words}{more}", ended.stopped, ended.error)


def _continued_scan(path: Path, job: Job) -> Scan:
    data = Dataset.open(path)
    if data.scan.job != job:
        raise PlanError(
            f"{path} was started with another plan: choose another name, or give the plan it was started with."
        )
    if not data.missing():
        raise DatasetError(f"{path} has all its frames: choose another name.")
    return Scan(path, data.scan.plan, job, goes_on=True)


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
def _interrupt_stops(steering: Steering) -> Generator[None]:
    """Make Ctrl-C stop the scan instead of the program, which ends once the rig is at rest."""
    before = signal.signal(signal.SIGINT, lambda *_: steering.stop())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
