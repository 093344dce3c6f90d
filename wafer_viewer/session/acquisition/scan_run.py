"""Run of a scan in the process that owns the rig: frames go to a dataset, progress and verdicts are reported."""

from __future__ import annotations

import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.focus.coarse_look import sharpness, tile_peaks, touched_ends
from wafer_viewer.acquire.focus.windows import replanned, widened
from wafer_viewer.acquire.motion import device_errors, read_positioners
from wafer_viewer.acquire.scan_runner import ScanOutcome, run_scan
from wafer_viewer.model.acquisition.devices import Position, PulseSummary, Rig
from wafer_viewer.model.acquisition.focus_stack import Frame, Image
from wafer_viewer.model.acquisition.plan import FOLLOW_FOCUS, MIN_FRAMES, Field, Leg, ScanPlan, Shot
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import DatasetError, PlanError, WaferViewerError
from wafer_viewer.model.job import Job
from wafer_viewer.session.acquisition.rig_messages import FieldComplete, FrameTaken, Paused, Scan, ScanEnded, ScanFault
from wafer_viewer.session.state.snapshot import LatestFrame, ScanProgress
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.records.calibration_records import FOLDER as CALIBRATIONS
from wafer_viewer.store.records.calibration_records import calibration_in_force, flat_field_in_force

REPORT_EVERY_S = 0.12
SAME_PIXEL_FRACTION = 1e-6
"""Difference of two nominal pixel sizes that rounding may make."""
RATE_KNOWN_AFTER = 10
"""Number of frames after which the remaining time follows from the measured rate instead of the plan's prediction."""


class Steering:
    """Pause and stop flags of the running scan; set on one thread, read on another."""

    def __init__(self) -> None:
        self._stop, self._ended = threading.Event(), threading.Event()
        self._go = threading.Event()
        self._go.set()

    def reset(self) -> None:
        """Reset for a new scan: neither paused nor stopped."""
        self._stop.clear()
        self._go.set()

    def pause(self) -> None:
        """Pause at the end of the pass."""
        self._go.clear()

    def resume(self) -> None:
        """Resume."""
        self._go.set()

    def stop(self) -> None:
        """End the scan soon, also while paused."""
        self._stop.set()
        self._go.set()

    def end(self) -> None:
        """End this scan and every later one, because the client is gone."""
        self._ended.set()
        self._go.set()

    def should_stop(self) -> bool:
        """Return whether the scan has to end."""
        return self._stop.is_set() or self._ended.is_set()

    def should_pause(self) -> bool:
        """Return whether the scan has to pause."""
        return not self._go.is_set()

    def wait_while_paused(self) -> None:
        """Wait until the pause is over or the scan has to end."""
        self._go.wait()


class Stopwatch:
    """Elapsed time of a scan in seconds, without pauses."""

    def __init__(self) -> None:
        self._since, self._gone_s = time.monotonic(), 0.0

    def halt(self) -> None:
        """Pause the stopwatch."""
        self._gone_s = self.seconds()
        self._since = float("inf")

    def go_on(self) -> None:
        """Resume the stopwatch."""
        self._since = time.monotonic()

    def seconds(self) -> float:
        """Return the elapsed seconds."""
        return self._gone_s + max(0.0, time.monotonic() - self._since)


class ScanWatch:
    """Frame sink and scan control in one object, as the scan runner uses them.

    Write errors of the operating system become DatasetErrors here, so any other OSError comes from a device.
    """

    def __init__(
        self,
        writer: DatasetWriter,
        plan: ScanPlan,
        tell: Callable[[Any], None],
        steering: Steering,
        focus: FocusWatch | None = None,
    ) -> None:
        self._writer, self._tell, self._steering, self._focus = writer, tell, steering, focus
        self._order: dict[int, int] = {}
        writer.on_field_complete = self._field_complete
        self.follow(plan)
        self._n_stored_before = len(writer.kept)
        self._done = self._n_stored_before
        self._empty: set[Shot] = set()
        self._pulses = 0
        self._watch = Stopwatch()
        self._started = time.strftime("%H:%M:%S")
        self._reported_at = -REPORT_EVERY_S
        self._last: Frame | None = None

    def follow(self, plan: ScanPlan) -> None:
        """Take up a plan, also one with other legs during the scan."""
        self._plan = plan
        self._fields = {f.number: f for f in plan.fields}
        self._order |= {number: i for i, number in enumerate(order_of_fields(plan), 1)}

    def _field_complete(self, number: int) -> None:
        if self._focus is not None:
            self._focus.judge(number)
        self._tell(FieldComplete(number))

    def pass_begun(self, number: int, leg: Leg) -> None:
        """Start a leg."""
        with os_errors_as_dataset_errors(self._writer.path):
            self._writer.pass_begun(number, leg)

    def frame(self, frame: Frame) -> None:
        """Store a frame, and report progress a few times a second."""
        with os_errors_as_dataset_errors(self._writer.path):
            self._writer.frame(frame)
        if self._focus is not None:
            self._focus.add(frame)
        self._pulses += 1
        self._done = self._writer.n_arrived
        self._last = frame
        if time.monotonic() - self._reported_at >= REPORT_EVERY_S:
            self._report(frame)

    def missed(self, shot: Shot, pulse_count: int, why: str) -> None:
        """Record an empty slot."""
        self._empty.add(shot)
        with os_errors_as_dataset_errors(self._writer.path):
            self._writer.missed(shot, pulse_count, why)
        self._done = self._writer.n_arrived

    def repaired(self, shot: Shot) -> None:
        """Record the frame of a slot that was empty."""
        self._empty.discard(shot)
        with os_errors_as_dataset_errors(self._writer.path):
            self._writer.repaired(shot)

    def pass_ended(self, number: int, summary: PulseSummary) -> None:
        """End a leg."""
        with os_errors_as_dataset_errors(self._writer.path):
            self._writer.pass_ended(number, summary)

    def fault(self, what: str) -> None:
        """Record and report a fault of the scan."""
        with os_errors_as_dataset_errors(self._writer.path):
            self._writer.fault(what)
        self._tell(ScanFault(what))

    def should_stop(self) -> bool:
        """Return whether the scan has to end."""
        return self._steering.should_stop()

    def should_pause(self) -> bool:
        """Return whether the scan has to pause at the end of this leg."""
        return self._steering.should_pause()

    def wait_while_paused(self) -> None:
        """Report the pause and wait until it is over or the scan has to stop."""
        self._watch.halt()
        self._tell(Paused(True))
        self._steering.wait_while_paused()
        self._watch.go_on()
        self._tell(Paused(False))

    def progress(self, plan: ScanPlan, frame: Frame) -> None:
        """Do nothing: `frame` has already reported the progress."""

    def finish(self) -> None:
        """Report the final progress of the scan."""
        if self._last is not None:
            self._report(self._last, finished=True)

    def _report(self, frame: Frame, *, finished: bool = False) -> None:
        self._reported_at = time.monotonic()
        position = Position(frame.x_um, frame.y_um, frame.z_um)
        self._tell(FrameTaken(self._progress(frame, finished), position, self._latest(frame)))

    def _progress(self, frame: Frame, finished: bool) -> ScanProgress:
        return ScanProgress(
            field=self._fields[frame.shot.field],
            k=frame.shot.k,
            z_um=frame.z_um,
            order=self._order[frame.shot.field],
            frames_done=self._done,
            frames_total=self._plan.n_frames,
            frames_missing=len(self._empty),
            pulses=self._pulses,
            seconds_left=0.0 if finished else self._seconds_left(),
            seconds_gone=self._watch.seconds(),
            started=self._started,
            strategy=self._plan.strategy,
            finished=finished,
        )

    def _seconds_left(self) -> float:
        """Return the remaining seconds: from the measured rate, or at the very beginning from the prediction."""
        remaining, new = self._plan.n_frames - self._done, self._done - self._n_stored_before
        if new < RATE_KNOWN_AFTER:
            return self._plan.predicted_s * remaining / self._plan.n_frames
        return self._watch.seconds() / new * remaining

    def _latest(self, frame: Frame) -> LatestFrame | None:
        if frame.image is None:
            return None
        return LatestFrame(
            image=frame.image,
            field=self._fields[frame.shot.field],
            k=frame.shot.k,
            z_um=frame.z_um,
            brightest=int(frame.image.max()),
            clipped_fraction=clipped_fraction(frame.image),
        )


def clipped_fraction(image: Image) -> float:
    """Return the fraction of pixels at the top of the image's range."""
    return float(np.count_nonzero(image == np.iinfo(image.dtype).max)) / image.size


def order_of_fields(plan: ScanPlan) -> list[int]:
    """Return the field numbers in the order of their first frame."""
    return list(dict.fromkeys(shot.field for leg in plan.legs for shot in leg.shots))


def writer_of(scan: Scan, rig: Rig) -> DatasetWriter:
    """Return the writer of a new dataset, or of the continued one.

    Raises DatasetError when it cannot be written, or has all its frames and none of them is damaged.
    """
    positioners = tuple(state.reading for state in read_positioners(rig))
    require_same_optics(scan, rig)
    if scan.goes_on:
        return _continuing_writer(scan.path)
    folder = scan.path.absolute().parent
    calibration = calibration_in_force(folder, rig.name, rig.calibration)
    return DatasetWriter.create(
        scan.path,
        scan.plan,
        scan.job,
        calibration=calibration,
        flat_field=flat_field_in_force(folder / CALIBRATIONS, calibration),
        setup=rig.setup,
        rig=rig.name,
        simulated=rig.simulated,
        bits=rig.limits.camera.bits,
        positioners=positioners,
    )


def _continuing_writer(path: Path) -> DatasetWriter:
    writer = DatasetWriter.resume(path)
    if writer.is_complete:
        writer.close()
        raise DatasetError(f"{path} has all its frames, and none is damaged: choose another name for a new scan.")
    return writer


def require_same_optics(scan: Scan, rig: Rig) -> None:
    """Raise PlanError when the rig has another objective or zoom than the plan, or the begun scan, was made with."""
    now_um, setup = rig.limits.pixel_um, rig.setup
    if not math.isclose(scan.plan.pixel_um, now_um, rel_tol=SAME_PIXEL_FRACTION):
        raise PlanError(
            f"The plan was made for pixels of {scan.plan.pixel_um:g} um on the sample, and they are {now_um:g} um with "
            f"the objective {setup.objective or 'of the rig'} at zoom {setup.zoom:g}: change it, or plan again."
        )
    begun = Dataset.open(scan.path).scan.setup if scan.goes_on else setup
    if begun.objective and (begun.objective, begun.zoom) != (setup.objective, setup.zoom):
        raise PlanError(
            f"{scan.path.name} was begun with the objective {begun.objective} at zoom {begun.zoom:g}, and the rig has "
            f"{setup.objective} at zoom {setup.zoom:g}: change it before the scan is continued."
        )


def run_scan_job(
    scan: Scan, rig: Rig, writer: DatasetWriter, tell: Callable[[Any], None], steering: Steering
) -> ScanEnded:
    """Run a scan; a fault that ends it early becomes the `error` text, because its dataset can be continued."""
    follows = scan.plan.strategy == FOLLOW_FOCUS
    focus = FocusWatch(writer, scan.job, rig.limits) if follows else None
    watch = ScanWatch(writer, scan.plan, tell, steering, focus)
    try:
        with device_errors("rig", OSError):
            outcome = _run_plan(scan, rig, writer, watch, focus)
        if not outcome.stopped:
            with os_errors_as_dataset_errors(scan.path):
                writer.finish()
    except WaferViewerError as fault:
        return _scan_end_after_fault(scan, writer, fault)
    finally:
        watch.finish()
    return ScanEnded(scan.path, outcome.stopped, len(outcome.missing), error=None)


def _run_plan(scan: Scan, rig: Rig, writer: DatasetWriter, watch: ScanWatch, focus: FocusWatch | None) -> ScanOutcome:
    """Run the plan of a scan, and once more for the fields whose window was too short."""
    plan = plan_to_continue(scan.plan, writer, rig.limits) if scan.goes_on else scan.plan
    calibration = writer.record.calibration
    delay_us = None if calibration is None else calibration.trigger_delay_us
    while True:
        watch.follow(plan)
        outcome = run_scan(plan, rig, watch, watch, skip=writer.kept, delay_us=delay_us)
        wider = focus.next_round(plan, watch.fault) if focus is not None and not outcome.stopped else None
        if wider is None:
            return outcome
        plan = wider


def _scan_end_after_fault(scan: Scan, writer: DatasetWriter, fault: WaferViewerError) -> ScanEnded:
    """Return the end of a scan after a fault; the dataset records the fault if it can still be written."""
    with suppress(DatasetError), os_errors_as_dataset_errors(scan.path):
        writer.fault(str(fault))
    return ScanEnded(scan.path, stopped=True, n_missing=0, error=str(fault))


NAMED = 8
"""Largest number of fields that a message names."""


class FocusWatch:
    """Focus of the fields of a running scan, and the windows that are too short.

    The sharpness of every frame is measured when it is stored. A field with heights in focus at an end of its window,
    or without any focus in it, is named in the journal; after the last leg it gets a window that is longer by its own
    length at that end, and so on up to the whole sweep.
    """

    def __init__(self, writer: DatasetWriter, job: Job, limits: RigLimits) -> None:
        self._writer, self._limits = writer, limits
        self._whole = {field.number: field for field in job.all_fields()}
        self._n_frames = {field.number: field.n_frames for field in writer.record.plan.fields}
        self._frames: dict[int, dict[int, tuple[float, NDArray[np.float64]]]] = defaultdict(dict)

    def add(self, frame: Frame) -> None:
        """Measure the sharpness of a frame of the first exposure."""
        if frame.image is not None and frame.shot.exposure == 0:
            self._frames[frame.shot.field][frame.shot.k] = frame.z_um, sharpness(frame.image)

    def judge(self, number: int) -> None:
        """Record in the journal that a complete field has heights in focus at an end of its window."""
        frames = self._frames.pop(number, {})
        if len(frames) < MIN_FRAMES:
            return
        z_um, curves = zip(*frames.values(), strict=True)
        peaks = tile_peaks(np.array(z_um), np.stack(curves))
        ends = touched_ends(peaks)
        is_blank = self._n_frames[number] is None and peaks.n_in_focus == 0
        if any(ends) and not is_blank:
            self._writer.note_focus_at_end(number, ends)

    def next_round(self, plan: ScanPlan, report: Callable[[str], None]) -> ScanPlan | None:
        """Widen the windows that are too short; return the plan with the legs for them, None if there are none."""
        fields = {field.number: field for field in plan.fields}
        touching = self._writer.focus_at_end
        wider = {
            number: widened(fields[number], self._whole[number], plan.sweep, ends)
            for number, ends in touching.items()
            if number in fields
        }
        wider = {number: field for number, field in wider.items() if field != fields[number]}
        if short := touching.keys() - wider.keys():
            report(
                f"{_named(short)} in focus at an end of the whole sweep: heights beyond it are not measured. Take a "
                "longer sweep, or move it."
            )
        if not wider:
            return None
        report(
            f"{_named(wider)} in focus at an end of the z window, or nowhere in it: taken again with a longer one. "
            "Nothing to do."
        )
        for field in wider.values():
            self._writer.change_window(field)
            self._n_frames[field.number] = field.n_frames
        return replanned(plan, wider, self._limits)


def plan_to_continue(plan: ScanPlan, writer: DatasetWriter, limits: RigLimits) -> ScanPlan:
    """Return the plan of a continued scan; one that follows the focus gets legs for the windows as they are now."""
    if plan.strategy != FOLLOW_FOCUS:
        return plan
    plan = writer.record.plan
    kept = {(shot.field, shot.exposure, shot.k) for shot in writer.kept}
    missing: dict[int, Field] = {
        field.number: field
        for field in plan.fields
        if any(
            (field.number, exposure, k) not in kept
            for exposure in range(len(plan.exposures_us))
            for k in range(plan.sweep.frames_of(field))
        )
    }
    return replanned(plan, missing, limits) if missing else plan


def _named(numbers: Iterable[int]) -> str:
    """Return the subject of a sentence about fields, "Field 3 is" or "Fields 3, 7 are"."""
    ordered = sorted(numbers)
    names = ", ".join(map(str, ordered[:NAMED])) + (f" and {len(ordered) - NAMED} more" if len(ordered) > NAMED else "")
    return f"Field {names} is" if len(ordered) == 1 else f"Fields {names} are"
