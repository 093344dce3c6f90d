"""Coordination of the session's parts, and the commands that need several of them."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.acquisition.plan import MIN_FRAMES, CoarseLook
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError, PlanError, RoleError, WaferViewerError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.job import Job
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.acquisition.live_controller import ExposureController, LiveController
from wafer_viewer.session.acquisition.rig_client import RigCallbacks, RigClient
from wafer_viewer.session.acquisition.rig_messages import FrameTaken, Move, OverviewReady, RigReady, Scan, ScanEnded
from wafer_viewer.session.calibration.calibration_controller import CalibrationController
from wafer_viewer.session.core.audit_trail import AuditTrail, account
from wafer_viewer.session.core.background_work import BackgroundWork, Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, observer_command, query
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT, Library, free_name, today
from wafer_viewer.session.files.file_jobs import Documents, FileJobs
from wafer_viewer.session.files.frame_check import FrameCheck, FrameCompression
from wafer_viewer.session.gauge.gauge_controller import GaugeController
from wafer_viewer.session.inspection.inspection_commands import DefectController
from wafer_viewer.session.inspection.inspection_files import DefectFiles
from wafer_viewer.session.inspection.reference_views import DefectViews
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.measurement.results import NotebookController, ResultsStore
from wafer_viewer.session.planning.plan_editor import (
    RIG_STARTS,
    PlanEditor,
    look_before,
    look_for,
    look_further,
    suggested_name,
)
from wafer_viewer.session.planning.preflight import preflight_of_snapshot, require_passed
from wafer_viewer.session.planning.revision_trial import JobController, TrialController
from wafer_viewer.session.planning.verdicts import Judge
from wafer_viewer.session.session_restore import SessionRestore
from wafer_viewer.session.state.snapshot import FieldState, RigStatus, Snapshot
from wafer_viewer.session.surface.comparison_job import ComparisonController
from wafer_viewer.session.surface.focus_evidence import focus_curve
from wafer_viewer.session.surface.kernel_build import KernelBuild
from wafer_viewer.session.surface.reconstruction_queue import Reconstruction

if TYPE_CHECKING:
    from wafer_viewer.acquire.focus.coarse_look import LookForFocus
    from wafer_viewer.session.rendering.render_process import Painter
    from wafer_viewer.session.rendering.render_request import RenderRequest


class SessionCoordinator:
    """Controller of what needs several parts of the session.

    All methods except the constructor, `move_to`, `stop`, `paint` and `close` run on the session's thread.
    """

    def __init__(self, folder: Path, config: RigConfig, scheduler: str | None) -> None:
        self._folder = _made(folder)
        status = RigStatus(name=config.name, simulated=config.kind == "virtual")
        self.command_queue = self._command_queue = command_queue = CommandQueue(
            Snapshot(rig=status, data_folder=self._folder, reopening=True)
        )
        self.reopening = SessionRestore(self._folder)
        self.notices = Notifications(command_queue)
        self.audit_trail = AuditTrail(command_queue, self.notices, self._folder)
        self.plan_editor = PlanEditor(command_queue, self._folder)
        self.library = Library(command_queue, self._folder)
        self.reconstruction = Reconstruction(command_queue, self.notices, self.library, scheduler, self._reconstructed)
        self.kernels = KernelBuild(command_queue)
        self.background = BackgroundWork(command_queue, self.notices, self.reconstruction.compute)
        self.compression = FrameCompression(self.library, self.background, self.notices)
        self.frame_check = FrameCheck(command_queue, self.library, self.background, self.notices)
        self.files = FileJobs(command_queue, self.library, self.background, self.open.run)
        self.papers = Documents(command_queue, self.library, self.files)
        self.queries = DatasetQueries(self.library, lambda: command_queue.snapshot)
        self.results_store = ResultsStore(command_queue, self.library)
        self.notebook = NotebookController(command_queue, self.library)
        self.comparing = ComparisonController(command_queue, self.library, self.background)
        files = DefectFiles(command_queue, self.library, self.background, self._folder)
        views = DefectViews(self.paint, lambda: command_queue.snapshot)
        self.defects = DefectController(command_queue, self.library, self.background, files, views)
        self.jobs = JobController(command_queue, self.plan_editor, self._folder)
        self.gauge = GaugeController(command_queue, self.library, self.results_store, self.queries, self._folder)
        self.trials = TrialController(command_queue, self.background, self.plan_editor)
        self.judge = Judge(command_queue, self.library, self.notices)
        reports = RigCallbacks(
            *(self._rig_ready, self._overview_ready, self._frame_taken, self._field_complete, self._scan_ended),
            live_frame=lambda frame: self.live.frame_arrived(frame),
            live_failed=lambda why: self.live.failed(why),
            optics_changed=lambda: self.plan_editor.price(),
        )
        self.rig = RigClient(command_queue, self.notices, config, reports)
        self.exposure = ExposureController(command_queue, self.plan_editor, self.rig)
        self.live = LiveController(command_queue, self.rig, self.plan_editor)
        self.calibration = CalibrationController(command_queue, self.plan_editor, self.rig, self._folder)
        self._sample: Sample | None = None
        self._scan_over: Future[None] = Future()
        self._query_numbers = count(1)
        self._painter: Painter | None = None
        self._painter_lock = threading.Lock()

    def start(self) -> None:
        """Start the rig and list the available data.

        The workers start later, so that they do not delay the first page.
        """
        self.kernels.start()
        self.rig.start()
        self.defects.watch()
        self.command_queue.subscribe(
            lambda now: self.command_queue.note(self._load_sample) if _sample_of(now) != self._sample else None
        )
        self.plan_editor.price()
        self.library.refresh.run()
        self.jobs.refresh.run()
        self.calibration.refresh.run()
        self.defects.files.refresh.run()
        try:
            self._reopen()
        except WaferViewerError as fault:
            self.notices.fault("What was open is not open again", str(fault), "open", needs_person=False)
        finally:
            self.command_queue.change(reopening=False)
            self.command_queue.subscribe(lambda now: self.reopening.keep(now, self.library.result_name))

    def close(self) -> None:
        """Bring the rig to rest and end all processes."""
        self.command_queue.close()
        self.kernels.close()
        self.reopening.close(self.command_queue.snapshot, self.library.result_name)
        self.judge.close()
        self.gauge.close()
        self.rig.close()
        self.reconstruction.compute.close()
        self.library.release_lock()
        if self._painter is not None:
            self._painter.close()

    @query
    def paint(self, request: RenderRequest) -> Future[bytes]:
        """Render an image tile, in a separate process, which starts with the first one."""
        from wafer_viewer.session.rendering.render_process import Painter

        with self._painter_lock:
            self._painter = self._painter or Painter()
        return self._painter.paint(request)

    @command
    def open(self, path: Path) -> Path:
        """Open a dataset and compute the missing parts of its surface."""
        path = Path(path)
        self.rig.require_idle("open another dataset")
        self.reconstruction.abandon()
        self.frame_check.forget()
        self.library.open(path)
        self._open_books()
        self._compute_missing()
        self.library.refresh.run()
        return path

    def _reopen(self) -> None:
        """Reopen the dataset and plan of the last run. Raises DatasetError when that is not possible."""
        if (why := self.reopening.claim()) is not None:
            self.notices.fault("What is open here is not remembered", why, "open", needs_person=False)
            return
        restored = self.reopening.read()
        if restored.is_empty:
            return
        self.plan_editor.reopen(restored.plan(), restored.typed)
        if restored.dataset is None:
            return
        path = Path(restored.dataset)
        if not path.exists():
            raise DatasetError(f"{path} was open and is not there any more: open it from where it is now.")
        self.open.run(path)
        if restored.result in self.library.shown.results:
            self._look_at(restored.result)
        if (why := self.library.shown.read_only) is not None:
            self.notices.fault(f"{self.library.shown.name} can only be read", why, "open", needs_person=False)

    def _look_at(self, result: str) -> None:
        """Show another result of the open dataset."""
        if result != self.library.result_name:
            self.reconstruction.abandon()
            self.library.show_result(result)
            self._open_books()
            self._compute_missing()

    def move_to(self, x_um: float | None = None, y_um: float | None = None, z_um: float | None = None) -> Future[None]:
        """Move the stage; the future is done on arrival, or fails with MotionStopped.

        The sample on the stage must be confirmed. A move that is queued when motion is stopped does not start.
        """
        return self._command_queue.do(self._move, Move(x_um, y_um, z_um), self.rig.n_stops)

    def _move(self, move: Move, n_stops: int) -> Future[None]:
        self.plan_editor.require_confirmed()
        return self.rig.move_to(move, n_stops)

    @command
    def close_dataset(self) -> None:
        """Close the dataset."""
        self.rig.require_idle("close its dataset")
        self._close_dataset()

    def _close_dataset(self) -> None:
        self.reconstruction.abandon()
        self.frame_check.forget()
        self.library.close()
        self._open_books()

    @command.audited("Scan started")
    def start_scan(self, name: str | None = None) -> Future[Path]:
        """Scan the plan into a new dataset, which is then the open one; a coarse look precedes it where it needs one.

        The future is done once the scan has started.
        """
        from wafer_viewer.store.io.atomic_files import require_space

        self.rig.require_idle("start another")
        job, plan = self.plan_editor.ready()
        self.plan_editor.require_runnable(job)
        if look_before(job, plan) is not None:
            require_passed(preflight_of_snapshot(self.command_queue.now, self.rig.latest_frame, today()))
            return self.command_queue.then(self.look_for_focus.run(), lambda _: self.start_scan.run(name))
        path = self._path_for(name or free_name(self._folder, f"{suggested_name(job)}-{time.strftime('%Y%m%d')}"))
        require_space(self._folder, plan.bytes_on_disk, path.stem)
        require_passed(preflight_of_snapshot(self.command_queue.now, self.rig.latest_frame, today()))
        return self._begin(Scan(path, plan, job))

    @command
    def look_for_focus(self) -> Future[CoarseLook]:
        """Look for the focus at a few fields; the fields of the plan then have windows that follow it.

        Raises PlanError if the plan does not follow the focus.
        """
        self.plan_editor.require_confirmed()
        job, plan = self.plan_editor.ready()
        return self._looked(job, look_for(job, plan))

    @command
    def look_at_more_places(self) -> Future[CoarseLook]:
        """Look for the focus at more fields, where the prediction of the last look is least certain.

        Raises PlanError if there was no look yet, or all fields were looked at.
        """
        self.plan_editor.require_confirmed()
        job, plan = self.plan_editor.ready()
        limits = self.command_queue.now.rig.limits
        if limits is None:
            raise PlanError(RIG_STARTS)
        return self._looked(job, look_further(job, plan, limits))

    def _looked(self, job: Job, look: LookForFocus) -> Future[CoarseLook]:
        def take(found: CoarseLook) -> CoarseLook:
            self.plan_editor.take_look(job, found)
            return found

        return self.command_queue.then(self.rig.run_procedure(look), take)

    @command.audited("Scan continued")
    def continue_scan(self) -> Future[Path]:
        """Scan the missing and the damaged frames of the open dataset; the future is done once the scan has started.

        It fails with a DatasetError when there are none.
        """
        self.rig.require_idle("start another")
        self.plan_editor.require_confirmed()
        shown = self.library.shown
        self.compression.require_over(shown.path)
        if shown.read_only is not None:
            raise DatasetError(f"The scan cannot be continued: {shown.read_only}")
        self.plan_editor.require_runnable(shown.job)
        self.library.release_lock()
        return self._begin(Scan(shown.path, shown.plan, shown.job, goes_on=True))

    @command.audited("Frames held")
    def hold_frames(self, why: str) -> None:
        """Keep the frames of the open dataset, however old they are; why: reason, which is recorded."""
        from wafer_viewer.store.dataset.retention import hold_line

        self.library.append(hold_line(self.library.dataset, self._author(), why))

    @command.audited("Hold ended")
    def end_hold(self, why: str) -> None:
        """End the hold of the open dataset; why: reason, which is recorded."""
        from wafer_viewer.store.dataset.retention import hold_end_line

        self.library.append(hold_end_line(self.library.dataset, self._author(), why))

    def _author(self) -> str:
        control = self.command_queue.now.control
        return control.name_of(control.holder) or account()

    @observer_command.audited("Scan stopped")
    def stop_scan(self) -> Future[None]:
        """End the scan; the future is done when the rig is at rest, at once without a scan.

        This is no emergency stop.
        """
        if not self.command_queue.now.scanning:
            over: Future[None] = Future()
            over.set_result(None)
            return over
        self.rig.stop_scan()
        return self._scan_over

    @query
    def stop(self) -> Future[bool]:
        """Stop all motion at once, including a scan's; the result at rest is False if nothing moved.

        This is no emergency stop.
        """
        return self._command_queue.do(self._stop, self.rig.stop_at_once())

    def _stop(self, at_once: Future[bool]) -> Future[bool]:
        """Stop queued commands that precede a stop already sent to the rig directly (`at_once`)."""
        if self.command_queue.now.scanning:
            return self.command_queue.then(self.stop_scan.run(), lambda _: True)
        return self.command_queue.then(self.rig.break_off(), lambda anything: anything or at_once.result())

    @command.audited("Surface made")
    def reconstruct(self, recipe: Recipe | None = None, result: str = DEFAULT_RESULT) -> Future[None]:
        """Recompute all heights of the open dataset and stitch them; the future is done when the surface exists."""
        shown = self.library.shown
        if not shown.fields:
            raise DatasetError(f"{shown.name} is a surface without frames: there is nothing to reconstruct.")
        self.library.dataset.require_frames("Nothing can be reconstructed")
        if recipe not in (None, shown.job.recipe) and (why := self.command_queue.now.control.refusal("Plan saved")):
            raise RoleError(why)
        if shown.read_only is not None:
            raise DatasetError(f"Nothing can be reconstructed: {shown.read_only}")
        fields = [n for n, state in shown.states.items() if self._has_stack(n, state)]
        if not fields:
            raise DatasetError(f"{shown.name} has no field with all its frames yet: scan first.")
        self.reconstruction.abandon()
        self.library.show_result(result)
        self._open_books()
        completion: Future[None] = Future()
        self.reconstruction.begin(recipe or shown.job.recipe, result, fields, completion)
        return completion

    @observer_command
    def focus_curve(self, x_um: float, y_um: float, show: int = 0) -> Future[FocusCurve]:
        """Return the focus curve that determines the height of a pixel.

        Show 0 uses the field with the nearest centre.
        """
        arguments = (self.library.dataset.path, self.library.result_name, show, x_um, y_um)
        return self.reconstruction.compute.run(f"why-{next(self._query_numbers)}", focus_curve, *arguments)

    def _open_books(self) -> None:
        """Open the stored results, notes, comparisons and defects of the displayed surface."""
        self.results_store.open()
        self.notebook.open()
        self.comparing.open()
        self.defects.open()
        self.defects.files.open()

    def _path_for(self, name: str) -> Path:
        from wafer_viewer.store.dataset.writer import remove_half_made

        path = self._folder / f"{Path(name).name.removesuffix(DATASET_ENDING)}{DATASET_ENDING}"
        remove_half_made(path)
        if path.exists():
            raise DatasetError(f"There is a dataset {path.name} already: choose another name, or continue its scan.")
        return path

    def _begin(self, scan: Scan) -> Future[Path]:
        self.reconstruction.abandon()
        self.frame_check.abandon()
        self._scan_over = Future()
        begun = self.rig.scan(scan)
        begun.add_done_callback(lambda done: self.command_queue.note(self._scan_refused, done))
        return self.command_queue.then(begun, lambda _: self._scan_begun(scan.path))

    def _scan_refused(self, begun: Future[None]) -> None:
        """Take back the open dataset after the rig refused the scan."""
        if begun.exception() is None:
            return
        if self.command_queue.now.dataset is not None:
            self.library.hold()
        self._scan_over.set_result(None)

    def _scan_begun(self, path: Path) -> Path:
        """Open the dataset that the rig process is writing, read-only, and queue its complete fields."""
        self.frame_check.forget()
        self.library.open(path, taking=True)
        self._open_books()
        shown = self.library.shown
        taken = [n for n, state in shown.states.items() if state is FieldState.TAKEN]
        self.reconstruction.begin(shown.job.recipe, self.library.result_name, taken)
        self.library.refresh.run()
        return path

    def _reconstructed(self) -> None:
        """Look for damaged frames where a field got no heights, and compress the others if the job asks for it."""
        if FieldState.FAILED in self.library.shown.states.values():
            self.frame_check.begin()
        self.compression.begin()

    def _load_sample(self) -> None:
        """Load the sample of the plan, or of the open dataset if there is no plan."""
        self._sample = _sample_of(self.command_queue.now)
        self.rig.load(self._sample)

    def _overview_ready(self, event: OverviewReady) -> None:
        self.command_queue.change(overview=event.overview)
        self.reconstruction.compute.start()

    def _rig_ready(self, event: RigReady) -> None:
        self.plan_editor.tour = event.tour
        self.plan_editor.price()

    def _frame_taken(self, event: FrameTaken) -> None:
        if not event.progress.finished:
            self.library.taking(event.progress.field.number)
            self.reconstruction.coming(event.progress.field.number)

    def _field_complete(self, number: int) -> None:
        self.library.set_state(number, FieldState.TAKEN)
        self.reconstruction.add([number])

    def _scan_ended(self, event: ScanEnded | None) -> None:
        """Update the state after a scan, from the data on disk; the event is None when the rig process died."""
        try:
            self.library.scan_ended()
        except DatasetError as fault:
            name = self.library.shown.name
            self.notices.fault(f"{name} was closed", f"{fault} Open it again when its folder is back.", "open")
            self._close_dataset()
        else:
            self._reconstruct_scanned(event)
        self.plan_editor.price()
        self._scan_over.set_result(None)

    def _reconstruct_scanned(self, event: ScanEnded | None) -> None:
        self.reconstruction.no_more_frames()
        if (scan := self.command_queue.now.scan) is not None:
            self.command_queue.change(scan=replace(scan, finished=True, seconds_left=0.0))
        if event is not None and not event.stopped:
            self.reconstruction.add([n for n, s in self.library.shown.states.items() if s is FieldState.TO_REPEAT])
        self.reconstruction.go_on()

    def _compute_missing(self) -> None:
        """Compute missing heights, mosaic and summary, as far as the dataset is writable."""
        shown, result = self.library.shown, self.library.result
        taken = [n for n, s in shown.states.items() if s is FieldState.TAKEN]
        if shown.read_only is None and (taken or (shown.stamps and not result.shows_all(shown.fields))):
            recipe = result.recipe() if shown.stamps else shown.job.recipe
            self.reconstruction.begin(recipe, result.name, taken, restitch=True)
        elif result.has_mosaic and self.command_queue.now.surface is None:
            self.reconstruction.describe()

    def _has_stack(self, number: int, state: FieldState) -> bool:
        if state not in (FieldState.TO_COME, FieldState.TAKING, FieldState.TO_REPEAT):
            return True
        return sum(shot.field == number for shot in self.library.dataset.arrived()) >= MIN_FRAMES


def _sample_of(now: Snapshot) -> Sample | None:
    if now.draft.job is not None:
        return now.draft.job.sample
    return now.dataset.job.sample if now.dataset is not None else None


def _made(folder: Path) -> Path:
    """Return the data folder as an absolute path; create it if it does not exist."""
    from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors

    if folder.exists() and not folder.is_dir():
        raise DatasetError(f"{folder} is a file: choose a folder for the datasets.")
    with os_errors_as_dataset_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder.absolute()
