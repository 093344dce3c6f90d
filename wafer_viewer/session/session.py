"""The operator's session: what the page and the command line ask for, one verb after the other on one thread.

State is a frozen `Snapshot`; every verb returns a future, and a `WaferViewerError` comes out of its ``result()``.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.acquisition.rig_messages import Move
from wafer_viewer.session.coordinator import SessionCoordinator
from wafer_viewer.session.core.control_handover import Control
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.files.documents import Documents
from wafer_viewer.session.files.file_browser import Browsing
from wafer_viewer.session.files.file_commands import Exchange
from wafer_viewer.session.gauge.gauge_commands import GaugeVerbs
from wafer_viewer.session.gauge.study_commands import Studies
from wafer_viewer.session.inspection.inspection_commands import DefectVerbs
from wafer_viewer.session.inspection.inspection_files import DefectFiles
from wafer_viewer.session.inspection.reference_views import DefectViews
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.measurement.review_notes import NotebookVerbs
from wafer_viewer.session.measurement.section_commands import Sections
from wafer_viewer.session.planning.job_commands import JobVerbs
from wafer_viewer.session.planning.trial_commands import TrialVerbs
from wafer_viewer.session.queries import QueryApi
from wafer_viewer.session.state.snapshot import LatestFrame, Snapshot, Typed
from wafer_viewer.session.surface.comparison_commands import ComparingVerbs


class Session(QueryApi):
    """One rig, one data folder, one open dataset, shared by all browsers.

    rig: None stands for the virtual wafer. scheduler: a dask cluster that runs already, else one of our own is started.
    browse: folders that a file dialog may show beside the data folder and the home folder.
    The constructor returns at once; the rig and the workers come up meanwhile. Raises DatasetError when the data
    folder is not there and cannot be made, or one of `browse` is not a folder.
    """

    def __init__(
        self,
        data_folder: Path,
        rig: RigConfig | None = None,
        scheduler: str | None = None,
        browse: tuple[Path, ...] = (),
    ) -> None:
        self._rooms = rooms = SessionCoordinator(Path(data_folder), rig or RigConfig(), scheduler)
        self._desk, self._do = rooms.desk, rooms.desk.do
        self.browsing = Browsing(rooms.desk.snapshot.data_folder, browse)
        super().__init__(DatasetQueries(rooms.library, lambda: self.snapshot))
        self.control = Control(rooms.desk)
        self.notebook = NotebookVerbs(self._do, rooms.notebook)
        self.comparing = ComparingVerbs(self._do, rooms.comparing, rooms.library, lambda: self.snapshot)
        views = DefectViews(self.paint, lambda: self.snapshot)
        self.defects = DefectVerbs(self._do, rooms.defects, DefectFiles(self._do, rooms.defect_files), views)
        self.jobs = JobVerbs(self._do, rooms.jobs, rooms.drafting)
        self.trials = TrialVerbs(self._do, rooms.trials)
        self.sections = Sections(self._questions, lambda: self.snapshot)
        self.studies = Studies()
        self.gauge = GaugeVerbs(self._do, rooms.gauge, self._questions, lambda: self.snapshot)
        self.papers = Documents(self._do, rooms.library, rooms.files)
        self.exchange = Exchange(self._do, rooms.desk, rooms.files, rooms.open)
        self._desk.note(rooms.start)
        atexit.register(self.close)

    # ------------------------------------------------------------------ state

    @property
    def snapshot(self) -> Snapshot:
        """The newest state."""
        return self._desk.snapshot

    @property
    def latest_frame(self) -> LatestFrame | None:
        """The latest frame of the running scan, or of the last one."""
        return self._rooms.rig.latest_frame

    def subscribe(self, listener: Callable[[Snapshot], None]) -> Callable[[], None]:
        """Call `listener` on the session's thread after changes, at most ten times a second; returns how to leave."""
        return self._desk.subscribe(listener)

    def wait_until(self, condition: Callable[[Snapshot], bool], timeout_s: float = 60.0) -> Snapshot:
        """Wait, on another thread than the session's, for a snapshot of which `condition` holds, or a TimeoutError."""
        return self._desk.wait_until(condition, timeout_s)

    def close(self) -> None:
        """Put the rig at rest and end all processes; twice does no harm."""
        atexit.unregister(self.close)
        self._rooms.close()
        self.browsing.close()
        if self._painter is not None:
            self._painter.close()

    # ------------------------------------------------------------------- plan

    def edit_job(self, job: Job | None) -> Future[None]:
        """Another plan; it is priced at once."""
        return self._do(self._rooms.drafting.edit, job)

    def keep_typed(self, typed: Typed | None) -> Future[None]:
        """What stands on the plan's form and makes no plan yet; None when it makes one again."""
        return self._do(self._rooms.drafting.keep_typed, typed)

    def undo(self) -> Future[None]:
        """The plan before."""
        return self._do(self._rooms.drafting.undo)

    def redo(self) -> Future[None]:
        """The plan that was undone."""
        return self._do(self._rooms.drafting.redo)

    def cover_sample(self) -> Future[None]:
        """A grid of as many fields as cover the sample."""
        return self._do(self._rooms.drafting.cover_sample)

    def centre_on_stage(self) -> Future[None]:
        """The grid round where the stage stands."""
        return self._do(self._rooms.drafting.centre_on_stage)

    def take_tour(self) -> Future[None]:
        """A filled-in plan for the virtual sample."""
        return self._do(self._rooms.drafting.take_tour)

    def load_plan(self, path: Path) -> Future[None]:
        """The plan in a PLAN.toml."""
        return self._do(self._rooms.drafting.load, Path(path))

    def save_plan(self, path: Path | None = None) -> Future[Path]:
        """Write the plan, beside the datasets when no path is given."""
        return self._do(self._rooms.drafting.save, path)

    # -------------------------------------------------------------------- rig

    def move_to(self, x_um: float | None = None, y_um: float | None = None, z_um: float | None = None) -> Future[None]:
        """Move the stage; done on arrival, or with MotionStopped."""
        return self._do(self._rooms.move_to, Move(x_um, y_um, z_um), self._rooms.rig.n_stops)

    def start_scan(self, name: str | None = None) -> Future[Path]:
        """Take the plan into a new dataset, which is then the open one; done once it has begun."""
        return self._do(self._rooms.start_scan, name)

    def continue_scan(self) -> Future[Path]:
        """Take what is missing in the open dataset; done once it has begun."""
        return self._do(self._rooms.continue_scan)

    def pause(self) -> Future[None]:
        """Halt at the end of this pass."""
        return self._do(self._rooms.rig.pause)

    def resume(self) -> Future[None]:
        """Go on after a pause."""
        return self._do(self._rooms.rig.resume)

    def stop(self) -> Future[bool]:
        """Stop every motion now, a scan's too; done at rest: False if nothing moved. This is no emergency stop."""
        return self._do(self._rooms.stop, self._rooms.rig.stop_at_once())

    def stop_scan(self) -> Future[None]:
        """End the scan; done when the rig is at rest, at once without a scan. This is no emergency stop."""
        return self._do(self._rooms.stop_scan)

    # --------------------------------------------------------------- datasets

    def refresh_datasets(self) -> Future[None]:
        """List the data folder anew."""
        return self._do(self._rooms.library.refresh)

    def open_dataset(self, path: Path) -> Future[None]:
        """Open a dataset; what it lacks of its surface is made."""
        return self._do(self._rooms.open, Path(path))

    def close_dataset(self) -> Future[None]:
        """Close the dataset."""
        return self._do(self._rooms.close_dataset)

    def import_images(
        self,
        srcs: tuple[Path, ...],
        *,
        z_step_um: float | None,
        pixel_um: float | None,
        pattern: str | None = None,
        name: str | None = None,
        overlap_fraction: float = 0.1,
        numerical_aperture: float | None = None,
        wavelength_um: float | None = None,
    ) -> Future[Path]:
        """Make a dataset of images taken elsewhere, open and reconstruct it; done when it is open.

        numerical_aperture: of the objective, in air; None: not known. wavelength_um: None stands for 0.55 um.
        """
        options = {
            "z_step_um": z_step_um,
            "pixel_um": pixel_um,
            "pattern": pattern,
            "overlap_fraction": overlap_fraction,
            "numerical_aperture": numerical_aperture,
            "wavelength_um": wavelength_um,
        }
        made = self._do(self._rooms.files.import_images, srcs, options, name)
        return self._desk.then(made, self._rooms.open)

    def reconstruct(self, recipe: Recipe | None = None, result: str = DEFAULT_RESULT) -> Future[None]:
        """Make all heights of the open dataset again and stitch them; done when the surface is there."""
        return self._do(self._rooms.reconstruct, recipe, result)

    def cancel(self, work_id: str) -> Future[None]:
        """Stop a background work."""
        return self._do(self._rooms.notices.cancel, work_id)

    def dismiss(self, fault_id: str) -> Future[None]:
        """Take a fault off the list."""
        return self._do(self._rooms.notices.dismiss, fault_id)

    # ---------------------------------------------------------------- results

    def keep(self, finding: AnyResult, thumbnail: bytes | None = None) -> Future[AnyResult]:
        """Number, name and keep a measurement, with a small picture of the place, JPEG."""
        return self._do(self._rooms.book.keep, finding, thumbnail)

    def rename(self, number: int, name: str) -> Future[None]:
        """Another name for a result."""
        return self._do(self._rooms.book.rename, number, name)

    def delete(self, number: int) -> Future[None]:
        """Take a result off the list."""
        return self._do(self._rooms.book.delete, number)

    def undo_findings(self) -> Future[None]:
        """The list of results before."""
        return self._do(self._rooms.book.undo)

    def redo_findings(self) -> Future[None]:
        """The list of results that was undone."""
        return self._do(self._rooms.book.redo)

    def export_surface(
        self, path: Path, field: int | None = None, every: int | None = None, part: Region | None = None
    ) -> Future[Path]:
        """Write the stitched surface, or a field's, as the file that the ending names, every n-th pixel of it.

        part: only what lies in the upright rectangle round this region.
        """
        return self._do(self._rooms.files.export_surface, Path(path), field, every, part)

    def export_findings(self, path: Path) -> Future[Path]:
        """Write the results as CSV."""
        return self._do(self._rooms.book.export, Path(path))

    def focus_curve(self, x_um: float, y_um: float, show: int = 0) -> Future[FocusCurve]:
        """Why a pixel has its height, by a field's focus curve; show 0 asks the nearest field with the place."""
        return self._do(self._rooms.focus_curve, x_um, y_um, show)
