"""Operator session: the commands of the page and the command line, executed in order, and its queries.

The state is a frozen `Snapshot`. Every command returns a future, whose ``result()`` raises `WaferViewerError`. Commands
and queries are declared in the parts that carry them out.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from pathlib import Path
from typing import Concatenate, Generic, ParamSpec, TypeVar

from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.acquisition.live_controller import ExposureController, LiveController
from wafer_viewer.session.acquisition.rig_client import RigClient
from wafer_viewer.session.calibration.calibration_controller import CalibrationController
from wafer_viewer.session.coordinator import SessionCoordinator
from wafer_viewer.session.core.audit_trail import AuditTrail
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.commands import forwarded, query
from wafer_viewer.session.core.control_handover import Control
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.files.file_browser import Browsing
from wafer_viewer.session.files.file_jobs import Documents, FileJobs
from wafer_viewer.session.files.frame_check import FrameCheck
from wafer_viewer.session.gauge.gauge_controller import GaugeController
from wafer_viewer.session.gauge.repeat_scans import Studies
from wafer_viewer.session.inspection.inspection_commands import DefectController
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries, Measuring, Sections
from wafer_viewer.session.measurement.results import NotebookController, ResultsStore
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.planning.revision_trial import JobController, TrialController
from wafer_viewer.session.state.snapshot import LatestFrame, Snapshot
from wafer_viewer.session.surface.comparison_job import ComparisonController

P = ParamSpec("P")
T = TypeVar("T")
Part = TypeVar("Part")


class _Part(Generic[Part]):
    """Part of the session, and its commands and queries as methods of the session."""

    def __init__(self, part: Callable[[SessionCoordinator], Part]) -> None:
        self._part = part

    def __call__(self, command: Callable[Concatenate[Part, P], T]) -> Callable[Concatenate[Session, P], T]:
        return forwarded(command, lambda session: self._part(session._coordinator))


_plan = _Part(lambda coordinator: coordinator.plan_editor)
_rig = _Part(lambda coordinator: coordinator.rig)
_exposure = _Part(lambda coordinator: coordinator.exposure)
_session = _Part(lambda coordinator: coordinator)
_library = _Part(lambda coordinator: coordinator.library)
_files = _Part(lambda coordinator: coordinator.files)
_frame_check = _Part(lambda coordinator: coordinator.frame_check)
_notices = _Part(lambda coordinator: coordinator.notices)
_audit = _Part(lambda coordinator: coordinator.audit_trail)
_results = _Part(lambda coordinator: coordinator.results_store)
_queries = _Part(lambda coordinator: coordinator.queries)
_measuring = _Part(lambda coordinator: coordinator.queries.measuring)


class Session:
    """Session with one rig, one data folder and one open dataset, shared by all browsers.

    rig: None means the virtual wafer. scheduler: a running dask cluster; by default an own one is started. browse:
    folders that a file dialog may show, in addition to the data folder and the home folder. The constructor returns at
    once; the rig and the workers start in the background. Raises DatasetError when the data folder does not exist and
    cannot be created, or one of `browse` is not a folder.
    """

    control: Control
    notebook: NotebookController
    comparing: ComparisonController
    defects: DefectController
    jobs: JobController
    trials: TrialController
    sections: Sections
    studies: Studies
    gauge: GaugeController
    calibration: CalibrationController
    live: LiveController
    papers: Documents
    exchange: FileJobs
    browsing: Browsing

    # the plan
    edit_job = _plan(PlanEditor.edit)
    keep_typed = _plan(PlanEditor.keep_typed)
    undo = _plan(PlanEditor.undo)
    redo = _plan(PlanEditor.redo)
    cover_sample = _plan(PlanEditor.cover_sample)
    centre_on_stage = _plan(PlanEditor.centre_on_stage)
    take_tour = _plan(PlanEditor.take_tour)
    load_plan = _plan(PlanEditor.load)
    save_plan = _plan(PlanEditor.save)

    # the rig
    move_to = _session(SessionCoordinator.move_to)
    find_exposure = _exposure(ExposureController.find)
    take_bracket = _exposure(ExposureController.take_bracket)
    start_scan = _session(SessionCoordinator.start_scan)
    look_for_focus = _session(SessionCoordinator.look_for_focus)
    look_at_more_places = _session(SessionCoordinator.look_at_more_places)
    continue_scan = _session(SessionCoordinator.continue_scan)
    pause = _rig(RigClient.pause)
    resume = _rig(RigClient.resume)
    stop = _session(SessionCoordinator.stop)
    stop_scan = _session(SessionCoordinator.stop_scan)

    # datasets and work
    refresh_datasets = _library(Library.refresh)
    open_dataset = _session(SessionCoordinator.open)
    close_dataset = _session(SessionCoordinator.close_dataset)
    hold_frames = _session(SessionCoordinator.hold_frames)
    end_hold = _session(SessionCoordinator.end_hold)
    check_frames = _frame_check(FrameCheck.check)
    import_images = _files(FileJobs.import_images)
    export_surface = _files(FileJobs.export_surface)
    reconstruct = _session(SessionCoordinator.reconstruct)
    cancel = _notices(Notifications.cancel)
    dismiss = _notices(Notifications.dismiss)
    recorded_actions = _audit(AuditTrail.actions)

    # the surface, from any thread
    mosaic = _queries(DatasetQueries.mosaic)
    height_map = _queries(DatasetQueries.height_map)
    surface_source = _queries(DatasetQueries.surface_source)
    poses = _queries(DatasetQueries.poses)
    frame = _queries(DatasetQueries.frame)
    frame_near = _queries(DatasetQueries.frame_near)
    thumbnail = _queries(DatasetQueries.thumbnail)
    read_out = _queries(DatasetQueries.read_out)
    measure = _measuring(Measuring.measure)
    datum = _measuring(Measuring.datum)
    profile = _measuring(Measuring.profile)
    paint = _session(SessionCoordinator.paint)
    focus_curve = _session(SessionCoordinator.focus_curve)

    # the results
    keep = _results(ResultsStore.keep)
    rename = _results(ResultsStore.rename)
    delete = _results(ResultsStore.delete)
    undo_findings = _results(ResultsStore.undo)
    redo_findings = _results(ResultsStore.redo)
    export_findings = _results(ResultsStore.export)

    def __init__(
        self,
        data_folder: Path,
        rig: RigConfig | None = None,
        scheduler: str | None = None,
        browse: tuple[Path, ...] = (),
    ) -> None:
        self._coordinator = coordinator = SessionCoordinator(Path(data_folder), rig or RigConfig(), scheduler)
        self._command_queue = coordinator.command_queue
        self.browsing = Browsing(coordinator.command_queue.snapshot.data_folder, browse)
        self.control = Control(coordinator.command_queue)
        self.notebook, self.comparing, self.defects = coordinator.notebook, coordinator.comparing, coordinator.defects
        self.jobs, self.trials, self.gauge = coordinator.jobs, coordinator.trials, coordinator.gauge
        self.live, self.calibration = coordinator.live, coordinator.calibration
        self.papers, self.exchange = coordinator.papers, coordinator.files
        self.sections, self.studies = Sections(coordinator.queries, lambda: self.snapshot), Studies()
        self._command_queue.note(coordinator.start)
        atexit.register(self.close)

    @property
    def snapshot(self) -> Snapshot:
        """Latest state."""
        return self._command_queue.snapshot

    @property
    def latest_frame(self) -> LatestFrame | None:
        """Latest frame of the running scan, or of the last one."""
        return self._coordinator.rig.latest_frame

    @query
    def subscribe(self, listener: Callable[[Snapshot], None]) -> Callable[[], None]:
        """Call `listener` on the session's thread after changes, at most ten times a second.

        Return the unsubscribe function.
        """
        return self._command_queue.subscribe(listener)

    @query
    def wait_until(self, condition: Callable[[Snapshot], bool], timeout_s: float = 60.0) -> Snapshot:
        """Wait, on a thread other than the session's, until `condition` holds for a snapshot. Raises TimeoutError."""
        return self._command_queue.wait_until(condition, timeout_s)

    def close(self) -> None:
        """Bring the rig to rest and end all processes; can be called twice."""
        atexit.unregister(self.close)
        self._coordinator.close()
        self.browsing.close()
