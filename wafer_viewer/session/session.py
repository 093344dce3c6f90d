"""Operator session: the commands of the page and the command line, executed in order, and its queries.

The state is a frozen `Snapshot`. Every command returns a future, whose ``result()`` raises `WaferViewerError`.
"""

from __future__ import annotations

import atexit
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.acquisition.rig_messages import Move
from wafer_viewer.session.coordinator import SessionCoordinator
from wafer_viewer.session.core.control_handover import Control
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.files.documents import Documents
from wafer_viewer.session.files.file_browser import Browsing
from wafer_viewer.session.files.file_jobs import Exchange
from wafer_viewer.session.gauge.gauge_controller import GaugeVerbs
from wafer_viewer.session.gauge.repeat_scans import Studies
from wafer_viewer.session.inspection.inspection_commands import DefectVerbs
from wafer_viewer.session.inspection.inspection_files import DefectFiles
from wafer_viewer.session.inspection.reference_views import DefectViews
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries, ReadOut
from wafer_viewer.session.measurement.results import NotebookVerbs
from wafer_viewer.session.measurement.sections import Sections
from wafer_viewer.session.planning.job_commands import JobVerbs, TrialVerbs
from wafer_viewer.session.state.snapshot import LatestFrame, Snapshot, Typed
from wafer_viewer.session.surface.comparison_commands import ComparingVerbs

if TYPE_CHECKING:
    from wafer_viewer.session.rendering.render_process import Painter
    from wafer_viewer.session.rendering.render_request import RenderRequest


class QueryApi:
    """Read-only part of a session; its render process starts with the first picture."""

    def __init__(self, questions: DatasetQueries) -> None:
        self._questions = questions
        self._painter: Painter | None = None
        self._painter_lock = threading.Lock()

    def mosaic(self) -> Mosaic:
        """Return the stitched surface of the open dataset."""
        return self._questions.mosaic()

    def height_map(self, field: int) -> HeightMap:
        """Return the surface of one field."""
        return self._questions.height_map(field)

    def surface_source(self, show: int) -> Mosaic:
        """Return the displayed surface: 0 the stitched one, above 0 the field of that number, below 0 a comparison."""
        return self._questions.surface_source(show)

    def poses(self) -> Poses | None:
        """Return the field poses and overlap measurements of the stitched surface.

        None if only stage positions were used.
        """
        return self._questions.poses()

    def frame(self, field: int, k: int) -> Image:
        """Return one frame of a field, as it was stored."""
        return self._questions.frame(field, k)

    def frame_near(self, field: int, z_um: float) -> Image:
        """Return the frame of a field nearest to a z, as it was stored."""
        return self._questions.frame_near(field, z_um)

    def thumbnail(self, number: int) -> bytes | None:
        """Return the thumbnail of a result, JPEG; None if there is none."""
        return self._questions.thumbnail(number)

    def measure(
        self,
        tool: ToolName,
        places: tuple[Region, ...],
        show: int = 0,
        levelling: Levelling | None = None,
        options: ToolOptions | None = None,
    ) -> AnyResult:
        """Return the result of a measuring tool at its regions, heights relative to the stage's zero or levelled."""
        return self._questions.measuring.measure(tool, places, show, levelling, options)

    def datum(self, levelling: Levelling, show: int = 0) -> Datum:
        """Return the datum of a levelling on the displayed surface."""
        return self._questions.measuring.datum(levelling, show)

    def profile(self, line: Region, show: int = 0, levelling: Levelling | None = None) -> tuple[Profile, ProfileCurve]:
        """Return a section along a line."""
        return self._questions.measuring.profile(line, show, levelling)

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        """Return the surface at a point."""
        return self._questions.read_out(x_um, y_um, show)

    def paint(self, request: RenderRequest) -> Future[bytes]:
        """Render an image tile, in a separate process."""
        from wafer_viewer.session.rendering.render_process import Painter

        with self._painter_lock:
            self._painter = self._painter or Painter()
        return self._painter.paint(request)


class Session(QueryApi):
    """Session with one rig, one data folder and one open dataset, shared by all browsers.

    rig: None means the virtual wafer. scheduler: a running dask cluster; by default an own one is started. browse:
    folders that a file dialog may show, in addition to the data folder and the home folder. The constructor returns at
    once; the rig and the workers start in the background. Raises DatasetError when the data folder does not exist and
    cannot be created, or one of `browse` is not a folder.
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
        """Latest state."""
        return self._desk.snapshot

    @property
    def latest_frame(self) -> LatestFrame | None:
        """Latest frame of the running scan, or of the last one."""
        return self._rooms.rig.latest_frame

    def subscribe(self, listener: Callable[[Snapshot], None]) -> Callable[[], None]:
        """Call `listener` on the session's thread after changes, at most ten times a second.

        Return the unsubscribe function.
        """
        return self._desk.subscribe(listener)

    def wait_until(self, condition: Callable[[Snapshot], bool], timeout_s: float = 60.0) -> Snapshot:
        """Wait, on a thread other than the session's, until `condition` holds for a snapshot. Raises TimeoutError."""
        return self._desk.wait_until(condition, timeout_s)

    def close(self) -> None:
        """Bring the rig to rest and end all processes; can be called twice."""
        atexit.unregister(self.close)
        self._rooms.close()
        self.browsing.close()
        if self._painter is not None:
            self._painter.close()

    # ------------------------------------------------------------------- plan

    def edit_job(self, job: Job | None) -> Future[None]:
        """Set the plan; its scan time and size are calculated at once."""
        return self._do(self._rooms.drafting.edit, job)

    def keep_typed(self, typed: Typed | None) -> Future[None]:
        """Store input of the plan form that makes no plan yet; None when the input is a plan again."""
        return self._do(self._rooms.drafting.keep_typed, typed)

    def undo(self) -> Future[None]:
        """Undo the last edit of the plan."""
        return self._do(self._rooms.drafting.undo)

    def redo(self) -> Future[None]:
        """Redo the last undone edit of the plan."""
        return self._do(self._rooms.drafting.redo)

    def cover_sample(self) -> Future[None]:
        """Set the grid to cover the sample."""
        return self._do(self._rooms.drafting.cover_sample)

    def centre_on_stage(self) -> Future[None]:
        """Centre the grid on the current stage position."""
        return self._do(self._rooms.drafting.centre_on_stage)

    def take_tour(self) -> Future[None]:
        """Load a complete plan for the virtual sample."""
        return self._do(self._rooms.drafting.take_tour)

    def load_plan(self, path: Path) -> Future[None]:
        """Load the plan in a PLAN.toml."""
        return self._do(self._rooms.drafting.load, Path(path))

    def save_plan(self, path: Path | None = None) -> Future[Path]:
        """Write the plan, next to the datasets if no path is given."""
        return self._do(self._rooms.drafting.save, path)

    # -------------------------------------------------------------------- rig

    def move_to(self, x_um: float | None = None, y_um: float | None = None, z_um: float | None = None) -> Future[None]:
        """Move the stage; the future is done on arrival, or fails with MotionStopped."""
        return self._do(self._rooms.move_to, Move(x_um, y_um, z_um), self._rooms.rig.n_stops)

    def start_scan(self, name: str | None = None) -> Future[Path]:
        """Scan the plan into a new dataset, which is then the open one.

        The future is done once the scan has started.
        """
        return self._do(self._rooms.start_scan, name)

    def continue_scan(self) -> Future[Path]:
        """Scan the missing frames of the open dataset; the future is done once the scan has started."""
        return self._do(self._rooms.continue_scan)

    def pause(self) -> Future[None]:
        """Pause at the end of the current pass."""
        return self._do(self._rooms.rig.pause)

    def resume(self) -> Future[None]:
        """Resume after a pause."""
        return self._do(self._rooms.rig.resume)

    def stop(self) -> Future[bool]:
        """Stop all motion at once, including a scan's; the result at rest is False if nothing moved.

        This is no emergency stop.
        """
        return self._do(self._rooms.stop, self._rooms.rig.stop_at_once())

    def stop_scan(self) -> Future[None]:
        """End the scan; the future is done when the rig is at rest, at once without a scan.

        This is no emergency stop.
        """
        return self._do(self._rooms.stop_scan)

    # --------------------------------------------------------------- datasets

    def refresh_datasets(self) -> Future[None]:
        """List the data folder again."""
        return self._do(self._rooms.library.refresh)

    def open_dataset(self, path: Path) -> Future[None]:
        """Open a dataset and compute the missing parts of its surface."""
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
        """Import images from another instrument into a dataset, open and reconstruct it.

        The future is done when it is open. numerical_aperture: of the objective, in air; None: unknown. wavelength_um:
        None means 0.55 um.
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
        """Recompute all heights of the open dataset and stitch them; the future is done when the surface exists."""
        return self._do(self._rooms.reconstruct, recipe, result)

    def cancel(self, work_id: str) -> Future[None]:
        """Cancel a background work item."""
        return self._do(self._rooms.notices.cancel, work_id)

    def dismiss(self, fault_id: str) -> Future[None]:
        """Remove a fault from the list."""
        return self._do(self._rooms.notices.dismiss, fault_id)

    # ---------------------------------------------------------------- results

    def keep(self, finding: AnyResult, thumbnail: bytes | None = None) -> Future[AnyResult]:
        """Add a result with a number and a name, with a thumbnail of its region, JPEG."""
        return self._do(self._rooms.book.keep, finding, thumbnail)

    def rename(self, number: int, name: str) -> Future[None]:
        """Rename a result."""
        return self._do(self._rooms.book.rename, number, name)

    def delete(self, number: int) -> Future[None]:
        """Delete a result."""
        return self._do(self._rooms.book.delete, number)

    def undo_findings(self) -> Future[None]:
        """Undo the last change of the results list."""
        return self._do(self._rooms.book.undo)

    def redo_findings(self) -> Future[None]:
        """Redo the last undone change of the results list."""
        return self._do(self._rooms.book.redo)

    def export_surface(
        self, path: Path, field: int | None = None, every: int | None = None, part: Region | None = None
    ) -> Future[Path]:
        """Write the stitched surface, or a field's, in the format of the file ending, with every n-th pixel.

        part: only the upright rectangle around this region.
        """
        return self._do(self._rooms.files.export_surface, Path(path), field, every, part)

    def export_findings(self, path: Path) -> Future[Path]:
        """Write the results as CSV."""
        return self._do(self._rooms.book.export, Path(path))

    def focus_curve(self, x_um: float, y_um: float, show: int = 0) -> Future[FocusCurve]:
        """Return the focus curve that determines the height of a pixel.

        Show 0 uses the field with the nearest centre.
        """
        return self._do(self._rooms.focus_curve, x_um, y_um, show)
