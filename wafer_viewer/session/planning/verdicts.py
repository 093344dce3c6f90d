"""Wafer verdict: the features of the job are measured and judged once the surface is complete; it is stored."""

from __future__ import annotations

import hashlib
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.job import Job, WaferVerdict
from wafer_viewer.model.spec import encode
from wafer_viewer.model.surface.height_map import Provenance
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import VERDICT, Library, today
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.result import Result

Subject = tuple[Path, str, int]


class Judge:
    """Controller of the snapshot's verdict, which follows the surface. Changed on the session's thread only."""

    def __init__(self, command_queue: CommandQueue, library: Library, notices: Notifications) -> None:
        self._command_queue, self._library, self._notices = command_queue, library, notices
        self._at_work = ThreadPoolExecutor(1, thread_name_prefix="judge")
        self._of: Subject | None = None
        command_queue.subscribe(self._look)

    def close(self) -> None:
        """End the thread."""
        self._at_work.shutdown(wait=True, cancel_futures=True)

    def _look(self, now: Snapshot) -> None:
        """Start a judgement if a complete surface has none yet; called after every change."""
        subject = _subject(now)
        ready = subject is None or now.surface_is_whole
        if subject == self._of or not (ready or self._of is not None):
            return
        self._of = subject if ready else None
        self._command_queue.note(self._begin, self._of)

    def _begin(self, subject: Subject | None) -> None:
        self._show(None, judging=subject is not None)
        if subject is None or subject != _subject(self._command_queue.now):
            return
        data, result = self._library.dataset, self._library.result
        done = self._at_work.submit(verdict_of, data, result, keep=self._library.shown.read_only is None)
        done.add_done_callback(lambda done: self._command_queue.note(self._judged, subject, done))

    def _judged(self, subject: Subject, done: Future[WaferVerdict]) -> None:
        if subject != self._of or done.cancelled():
            return
        fault = done.exception()
        if fault is not None:
            self._notices.fault("There is no verdict", str(fault), "measure")
        self._show(done.result() if fault is None else None, judging=False)

    def _show(self, verdict: WaferVerdict | None, *, judging: bool) -> None:
        self._command_queue.change(
            operating=replace(self._command_queue.now.operating, verdict=verdict, judging=judging)
        )


def stored_verdict(data: Dataset, result: Result) -> WaferVerdict | None:
    """Return the stored verdict on this very surface of a result; None if there is none.

    Raises DatasetError when the file is damaged, is not the one that was signed, or contradicts itself or the job.
    """
    from wafer_viewer.measure.verdict import contradiction
    from wafer_viewer.store.io.checksums import load_json
    from wafer_viewer.store.records.manifest import require_as_saved

    path = result.path / VERDICT
    if not (path.exists() and result.has_mosaic):
        return None
    verdict = load_json(path, WaferVerdict)
    if verdict.surface != _mark(result.mosaic().provenance):
        return None
    if (fault := contradiction(verdict, data.scan.job)) is not None:
        raise DatasetError(f"{path} was altered: {fault}. Remove it to have the wafer judged again.")
    require_as_saved(path, trusted=True)
    return verdict


def verdict_of(data: Dataset, result: Result, *, keep: bool) -> WaferVerdict:
    """Return the verdict on the wafer of a dataset: the stored one if it is of this very surface, else a new one.

    Raises MeasureError if the job has no feature with a place, DatasetError without a stitched surface.
    """
    from wafer_viewer.measure.verdict import judge_dies, judge_features, next_action, not_judged, overall
    from wafer_viewer.store.records.manifest import save_record

    job, mosaic = data.scan.job, result.mosaic()
    require_features(job)
    if (stored := stored_verdict(data, result)) is not None:
        return stored
    calibrated = data.calibration_problem(today()) is None
    judged = judge_features(mosaic, job.features, job.alignment, calibration_valid=calibrated, dies=job.dies)
    items = (*judged, *not_judged(job.features, job.dies))
    verdict = WaferVerdict(
        word=overall(items),
        next=next_action(items),
        items=items,
        dies=judge_dies(items, job.dies),
        job=f"{job.product} {job.revision}".strip(),
        lot=job.sample.lot,
        wafer_id=job.sample.wafer_id or job.sample.name,
        released=job.released,
        simulated=data.simulated or mosaic.provenance.simulated,
        residual_um=job.alignment.residual_um if job.alignment else None,
        surface=_mark(mosaic.provenance),
    )
    if keep:
        save_record(result.path / VERDICT, verdict)
    return verdict


def require_features(job: Job) -> None:
    """Raise MeasureError if no feature can be judged."""
    if not any(feature.has_place for feature in job.features):
        raise MeasureError(
            "The job of this dataset has no feature with a place: there is nothing to give a verdict on."
        )


def _subject(now: Snapshot) -> Subject | None:
    """Return the key of the surface to be judged; None if there is none."""
    data, surface = now.dataset, now.surface
    if data is None or surface is None or not data.finished:
        return None
    judged = any(feature.has_place for feature in data.job.features)
    return (data.path, surface.result, surface.stamp) if judged else None


def _mark(provenance: Provenance) -> str:
    """Return a hash of a surface's provenance."""
    return hashlib.sha256(encode(provenance, "json").encode()).hexdigest()[:16]
