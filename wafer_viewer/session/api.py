"""Session interface that the page uses, and the view of it per browser: reading is free, commands need control.

The commands are documented in `Session` and in the classes of its groups.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Protocol, cast

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import ControlHeldError
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
from wafer_viewer.session.core.control_handover import Control
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.files.documents import Documents
from wafer_viewer.session.files.file_browser import Browsing
from wafer_viewer.session.files.file_jobs import Exchange
from wafer_viewer.session.gauge.gauge_controller import GaugeVerbs
from wafer_viewer.session.gauge.repeat_scans import Studies
from wafer_viewer.session.inspection.inspection_commands import DefectVerbs
from wafer_viewer.session.measurement.dataset_queries import ReadOut
from wafer_viewer.session.measurement.results import NotebookVerbs
from wafer_viewer.session.measurement.sections import Sections
from wafer_viewer.session.planning.job_commands import JobVerbs, TrialVerbs
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.state.snapshot import LatestFrame, Snapshot, Typed
from wafer_viewer.session.surface.comparison_commands import ComparingVerbs


class SessionApi(Protocol):
    """State, command groups and commands; a command that returns a future runs on the session's thread."""

    control: Control
    notebook: NotebookVerbs
    comparing: ComparingVerbs
    defects: DefectVerbs
    jobs: JobVerbs
    trials: TrialVerbs
    sections: Sections
    studies: Studies
    gauge: GaugeVerbs
    papers: Documents
    exchange: Exchange
    browsing: Browsing

    # state
    @property
    def snapshot(self) -> Snapshot: ...
    @property
    def latest_frame(self) -> LatestFrame | None: ...
    def subscribe(self, listener: Callable[[Snapshot], None]) -> Callable[[], None]: ...

    # surface, frames and pictures, from any thread
    def mosaic(self) -> Mosaic: ...
    def height_map(self, field: int) -> HeightMap: ...
    def surface_source(self, show: int) -> Mosaic: ...
    def poses(self) -> Poses | None: ...
    def frame(self, field: int, k: int) -> Image: ...
    def frame_near(self, field: int, z_um: float) -> Image: ...
    def thumbnail(self, number: int) -> bytes | None: ...
    def measure(
        self,
        tool: ToolName,
        places: tuple[Region, ...],
        show: int = 0,
        levelling: Levelling | None = None,
        options: ToolOptions | None = None,
    ) -> AnyResult: ...
    def datum(self, levelling: Levelling, show: int = 0) -> Datum: ...
    def profile(
        self, line: Region, show: int = 0, levelling: Levelling | None = None
    ) -> tuple[Profile, ProfileCurve]: ...
    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut: ...
    def paint(self, request: RenderRequest) -> Future[bytes]: ...
    def focus_curve(self, x_um: float, y_um: float, show: int = 0) -> Future[FocusCurve]: ...

    # plan
    def edit_job(self, job: Job | None) -> Future[None]: ...
    def keep_typed(self, typed: Typed | None) -> Future[None]: ...
    def undo(self) -> Future[None]: ...
    def redo(self) -> Future[None]: ...
    def cover_sample(self) -> Future[None]: ...
    def centre_on_stage(self) -> Future[None]: ...
    def take_tour(self) -> Future[None]: ...
    def load_plan(self, path: Path) -> Future[None]: ...
    def save_plan(self, path: Path | None = None) -> Future[Path]: ...

    # rig
    def move_to(
        self, x_um: float | None = None, y_um: float | None = None, z_um: float | None = None
    ) -> Future[None]: ...
    def start_scan(self, name: str | None = None) -> Future[Path]: ...
    def continue_scan(self) -> Future[Path]: ...
    def pause(self) -> Future[None]: ...
    def resume(self) -> Future[None]: ...
    def stop(self) -> Future[bool]: ...
    def stop_scan(self) -> Future[None]: ...

    # datasets and work
    def refresh_datasets(self) -> Future[None]: ...
    def open_dataset(self, path: Path) -> Future[None]: ...
    def close_dataset(self) -> Future[None]: ...
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
    ) -> Future[Path]: ...
    def reconstruct(self, recipe: Recipe | None = None, result: str = DEFAULT_RESULT) -> Future[None]: ...
    def cancel(self, work_id: str) -> Future[None]: ...
    def dismiss(self, fault_id: str) -> Future[None]: ...

    # results
    def keep(self, finding: AnyResult, thumbnail: bytes | None = None) -> Future[AnyResult]: ...
    def rename(self, number: int, name: str) -> Future[None]: ...
    def delete(self, number: int) -> Future[None]: ...
    def undo_findings(self) -> Future[None]: ...
    def redo_findings(self) -> Future[None]: ...
    def export_surface(
        self, path: Path, field: int | None = None, every: int | None = None, part: Region | None = None
    ) -> Future[Path]: ...
    def export_findings(self, path: Path) -> Future[Path]: ...


FREE = frozenset(
    {
        *("snapshot", "latest_frame", "subscribe", "wait_until", "control"),
        *("mosaic", "height_map", "surface_source", "poses", "frame", "frame_near", "paint", "refresh_datasets"),
        *("profile", "read_out", "focus_curve", "measure", "datum", "thumbnail"),
        *("export_surface", "export_findings", "exchange.is_surface"),
        *("papers.keep_picture", "papers.write_report", "papers.contents"),
        *("browsing.roots", "browsing.list_folder", "browsing.look", "browsing.allowed"),
        *("browsing.path_of", "browsing.existing", "browsing.remember"),
        *("stop", "stop_scan", "comparing.choices", "sections.section", "sections.others", "sections.file"),
        "defects.files.write",
        *("gauge.find_faces", "gauge.check", "studies.gauge_rr"),
        *("defects.views.beside", "defects.views.die", "defects.views.repeats"),
    }
)
"""Names that any browser may use: read, measure without storing, export to a file, and stop motion.

A name in a command group is prefixed with the group's name, ``notebook.views``. Every name not listed here moves the
rig or changes the plan, the dataset or the results.
"""


def restricted_session(session: SessionApi, key: Callable[[], str]) -> SessionApi:
    """Return the session as the browser with key `key` may use it.

    It has all attributes of `session`. Commands that need control return a future that fails with ControlHeldError for
    browsers that only watch.
    """
    return cast("SessionApi", _Seat(session, lambda: session.snapshot.hands.why_not(key()), ""))


class _Seat:
    """Proxy of a session or of one of its command groups; checks `why_not` before every name not in `FREE`."""

    def __init__(self, whole: Any, why_not: Callable[[], str | None], path: str) -> None:
        self._whole, self._why_not, self._path = whole, why_not, path

    def __getattr__(self, name: str) -> Any:
        meant, path = getattr(self._whole, name), f"{self._path}{name}"
        if path in FREE or name.startswith("_"):
            return meant
        if callable(meant):
            return self._require_control(meant)
        return _Seat(meant, self._why_not, f"{path}.") if _is_group(meant) else meant

    def _require_control(self, verb: Callable[..., Any]) -> Callable[..., Any]:
        def ask(*args: Any, **kwargs: Any) -> Any:
            why = self._why_not()
            return verb(*args, **kwargs) if why is None else _refused(why)

        return ask


def _is_group(thing: object) -> bool:
    return type(thing).__module__.startswith(f"{__package__}.") and not is_dataclass(thing)


def _refused(why: str) -> Future[Any]:
    refusal: Future[Any] = Future()
    refusal.set_exception(ControlHeldError(f"{why} Ask for them first: you are only watching."))
    return refusal
