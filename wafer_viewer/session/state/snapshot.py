"""Session state: one frozen `Snapshot` shared by all browsers. Every command creates a new one."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Literal

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Field, FieldFocus, ScanPlan, Shot
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.model.acquisition.procedure import FoundExposure
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.job import Job, Notebook, Trial, WaferVerdict
from wafer_viewer.model.roles import Action, Role, refusal
from wafer_viewer.model.surface.comparison import Comparison
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.state.inspection_state import DefectFilesState, GaugeState, InspectionState
from wafer_viewer.session.state.instrument_state import CalibrationState, LiveState


@dataclass(frozen=True, slots=True)
class Compared:
    """Comparison that can be displayed.

    `stamp` changes whenever it does; outdated: a surface has been recomputed since.
    """

    number: int
    name: str
    comparison: Comparison
    stamp: int
    outdated: bool = False


NOT_SIGNED_IN = "Nobody is signed in at this browser: sign in first, in the list of browsers."


@dataclass(frozen=True, slots=True)
class Browser:
    """Connected browser with its name, and the role of the person who signed in at it, None without one.

    present: False while its return is expected, as after a reload.
    """

    key: str
    name: str
    present: bool = True
    role: Role | None = None

    @property
    def public_id(self) -> str:
        """Name of the browser on the pages of others: who has its key has its role."""
        return hashlib.sha256(self.key.encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class ControlState:
    """Connected browsers, and the holder and requester of control.

    browsers: in order of arrival. holder, requester: keys, None for nobody. requested_at: clock time in s of the
    request, after which the holder has `answer_s` to refuse it. refused: key of the last refused requester. engineers:
    names of those who are listed; if nobody is, everyone is an engineer.
    """

    browsers: tuple[Browser, ...] = ()
    holder: str | None = None
    requester: str | None = None
    requested_at: float = 0.0
    answer_s: float = 0.0
    refused: str | None = None
    engineers: tuple[str, ...] = ()

    def browser(self, key: str | None) -> Browser | None:
        """Return the browser with a key; None if it is not connected."""
        return next((b for b in self.browsers if b.key == key), None)

    def name_of(self, key: str | None) -> str:
        """Return the name of a browser; empty if it is not connected."""
        found = self.browser(key)
        return found.name if found is not None else ""

    def holds(self, key: str) -> bool:
        """Return whether a browser has control."""
        return bool(key) and key == self.holder

    def why_not(self, key: str) -> str | None:
        """Return why a browser does not have control; None if it does."""
        if self.holds(key):
            return None
        name = self.name_of(self.holder)
        return f"{name} holds the controls." if name else "Nobody holds the controls."

    def role_of(self, key: str | None) -> Role | None:
        """Return the role of a browser; None where people are listed and nobody signed in at it."""
        if not self.engineers:
            return "engineer"
        found = self.browser(key)
        return found.role if found is not None else None

    def is_signed_in(self, key: str) -> bool:
        """Return whether a listed person signed in at a browser."""
        found = self.browser(key)
        return found is not None and found.role is not None

    def author(self, name: str) -> str:
        """Return who signs: the person who is signed in and holds the controls, else who is named."""
        return self.name_of(self.holder) if self.holder and self.is_signed_in(self.holder) else name

    def require_reason(self, why: str) -> None:
        """Raise PlanError if people are listed and a change has no reason."""
        if self.engineers and not why.strip():
            raise PlanError("This has no reason: say what it is for, or what changed.")

    def why_only_watching(self, key: str) -> str | None:
        """Return why a browser may give no command that needs control; None if it may."""
        if (why := self.why_not(key)) is not None:
            return f"{why} Ask for control first: you are only watching."
        return NOT_SIGNED_IN if self.role_of(key) is None else None

    def refusal(self, action: Action) -> str | None:
        """Return why the holder of the controls may not do an action; None if allowed, or if nobody holds them."""
        role = self.role_of(self.holder)
        if self.holder is None or role is None:
            return None
        return refusal(action, self.name_of(self.holder), role, self.engineers)


@dataclass(frozen=True, slots=True)
class JobEntry:
    """Entry of the list of released jobs."""

    path: Path
    product: str
    revision: str
    n_fields: int
    n_features: int
    edited: bool = False
    """True if its file is not the one that was released."""


@dataclass(frozen=True, slots=True)
class Operating:
    """Released jobs, wafer verdict and trial.

    judging: the features of the open dataset are being measured for their verdict. trial: result of a plan on stored
    wafers, `trial_of` that plan; trying: a trial is running.
    """

    jobs: tuple[JobEntry, ...] = ()
    verdict: WaferVerdict | None = None
    judging: bool = False
    trial: Trial | None = None
    trial_of: Job | None = None
    trying: bool = False


@dataclass(frozen=True, slots=True)
class NotebookState:
    """Saved views and judgements, and whether their last change can be undone or redone."""

    book: Notebook = Notebook()
    can_undo: bool = False
    can_redo: bool = False


class FieldState(Enum):
    """Progress of a field of the open dataset."""

    TO_COME = "to come"
    TAKING = "being taken"
    TAKEN = "taken"
    RECONSTRUCTING = "in reconstruction"
    MEASURED = "measured"
    TO_REPEAT = "to repeat"
    FAILED = "failed"


Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
RigState = Literal["absent", "starting", "ready", "moving", "working", "scanning", "paused", "stopping", "fault"]


@dataclass(frozen=True, slots=True)
class RigStatus:
    """Rig status of the page header. `message` gives the reason for the state ``fault`` or ``absent``.

    ``working``: a procedure runs, such as the search for the exposure.
    """

    name: str = "Virtual rig"
    simulated: bool = True
    state: RigState = "starting"
    x_um: float = 0.0
    y_um: float = 0.0
    z_um: float = 0.0
    limits: RigLimits | None = None
    calibration: Calibration | None = None
    setup: OpticalSetup | None = None
    positioners: tuple[PositionerState, ...] = ()
    message: str = ""
    homed: bool | None = None
    """True if all axes are homed; None before the rig has reported it."""

    @property
    def can_start(self) -> bool:
        """True if a move or a scan can be started; a rig that was lost is connected to again by it."""
        return self.state == "ready" or (self.state in ("absent", "fault") and self.limits is not None)


@dataclass(frozen=True, slots=True)
class Typed:
    """Input of the plan form in the page's own format, and the reason why it is no plan."""

    form: str
    problem: str


@dataclass(frozen=True, slots=True)
class Draft:
    """Plan being edited: the job, its calculated plan, or the reason why there is none."""

    job: Job | None = None
    plan: ScanPlan | None = None
    problem: str | None = None
    can_undo: bool = False
    can_redo: bool = False
    free_bytes: int | None = None
    marked_um: tuple[tuple[float, float] | None, ...] = ()
    """Marked stage positions of the alignment corners, in the order of the job's marks; None for an unmarked one."""
    confirmed: bool = True
    """False after a plan was restored, until a person confirms that the sample on the stage is the named one."""
    typed: Typed | None = None
    focus: tuple[FieldFocus, ...] = ()
    """Focus of the fields by the coarse look that the plan follows, in their order."""


@dataclass(frozen=True, slots=True)
class DatasetEntry:
    """Entry of the list of datasets in the data folder.

    taken: ISO 8601; verdict: word of the stored verdict on its surface, empty if there is none. frames: what is said of
    how long its frames are kept, empty if nothing is.
    """

    path: Path
    name: str
    taken: str
    unfinished: bool
    simulated: bool
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    verdict: str = ""
    frames: str = ""

    def matches(self, words: str) -> bool:
        """Return whether each word is part of the name, lot, wafer, product, verdict or date; case does not matter."""
        texts = (self.path.stem, self.lot, self.wafer_id, self.product, self.verdict, self.taken[:10])
        signs = ("unfinished" * self.unfinished, "simulated" * self.simulated)
        told = [text.casefold() for text in (*texts, *signs)]
        return all(any(word in text for text in told) for word in words.casefold().split())


@dataclass(frozen=True, slots=True)
class ScanProgress:
    """Progress of the running scan, or of the last one."""

    field: Field
    k: int
    z_um: float
    order: int
    """Position of the field in the scan order, from 1."""
    frames_done: int
    frames_total: int
    frames_missing: int
    pulses: int
    seconds_left: float
    seconds_gone: float
    started: str
    """Clock time, ``09:41:07``."""
    strategy: str
    finished: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LatestFrame:
    """Latest frame of a running scan, full size, as it was stored."""

    image: Image
    field: Field
    k: int
    z_um: float
    brightest: int
    clipped_fraction: float


@dataclass(frozen=True, slots=True)
class Work:
    """Background work item: shown with its progress, can be cancelled by its id.

    fraction None: the progress is unknown, or the work has not started; `waits_for` then gives the reason. stopping: it
    was cancelled and has not ended yet.
    """

    id: str
    title: str
    fraction: float | None = None
    cancellable: bool = True
    waits_for: str = ""
    seconds_left: float | None = None
    stopping: bool = False


@dataclass(frozen=True, slots=True)
class Fault:
    """Notification for the operator. `needs_person` is red; otherwise it is amber and ends with 'Nothing to do.'."""

    id: str
    title: str
    text: str
    at: str
    where: str = ""
    needs_person: bool = True
    source: Literal["plan", "scan", "import", "open", "surface", "measure", "export", "rig", "other"] = "other"


@dataclass(frozen=True, slots=True)
class StitchingInfo:
    """Statistics of the field placement of a stitched surface; uncertainties are expanded (k = 2).

    doubts: reasons for rejected overlaps, as text, with their number, the most frequent first. moved: distance of
    fields from their stage positions. step: remaining z step between neighbours; None if no overlap is compared. form:
    the terms of the overall form that only the stage determines, each with its U. left_out: numbers of fields that fit
    none of their neighbours. n_by_stage: number of fields that overlap others and are placed by the stage alone;
    n_periodic: of the accepted overlaps with a repeating pattern, whose period the stage helped to choose;
    period_probability: of the chosen period of the least sure of these, None without any.
    """

    n_overlaps: int
    n_believed: int
    doubts: tuple[tuple[str, int], ...]
    stage_error_um: float
    z_error_um: float
    moved_rms_um: float
    moved_max_um: float
    position_u_um: float
    height_u_um: float
    step_median_um: float | None
    step_p95_um: float | None
    form: tuple[tuple[str, float], ...] = ()
    n_groups: int = 1
    left_out: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    n_by_stage: int = 0
    n_periodic: int = 0
    period_probability: float | None = None


@dataclass(frozen=True, slots=True)
class SurfaceInfo:
    """Stitched surface of the open dataset. `stamp` changes whenever its contents do."""

    result: str
    stamp: int
    rows: int
    cols: int
    pixel_um: float
    x0_um: float
    y0_um: float
    levels: int
    n_fields: int
    highest_um: float
    lowest_um: float
    measured_fraction: float
    filled_fraction: float
    unmeasured: tuple[tuple[str, float], ...]
    """Reasons as text, with the fraction of pixels of each."""
    overlap_rms_um: float | None
    low_um: float
    high_um: float
    """0.5 and 99.5 % of the heights: the initial colour range."""
    recipe_notes: tuple[str, ...] = ()
    asked: Recipe | None = None
    settled: Recipe | None = None
    """Recipe of the surface, and the same with ``auto`` resolved; None if that was not stored."""
    stitching: StitchingInfo | None = None
    """None if fields are at their stage positions, without an evaluation of their overlaps."""
    changed: tuple[tuple[int, Box], ...] = ()
    """Changed areas of a growing surface with their stamps, oldest first; empty: everywhere."""


@dataclass(frozen=True, slots=True)
class FrameStorage:
    """Size of compressed frames on the disk, and uncompressed, in bytes."""

    stored_bytes: int
    raw_bytes: int

    @property
    def saved_bytes(self) -> int:
        """Bytes that the compression saves."""
        return self.raw_bytes - self.stored_bytes


@dataclass(frozen=True, slots=True)
class OpenDataset:
    """Open dataset. calibration_problem None: calibrated; otherwise lengths read 'uncalibrated'."""

    path: Path
    name: str
    taken: str
    simulated: bool
    calibration_problem: str | None
    read_only: str | None
    """Reason why it is read-only, or None."""
    finished: bool
    fields: tuple[Field, ...]
    states: dict[int, FieldState]
    stamps: dict[int, int]
    """Stamps by field number, which change whenever the field's surface does.

    A field without one has no surface yet.
    """
    plan: ScanPlan
    job: Job
    results: tuple[str, ...] = ()
    imported: bool = False
    """True if it was imported: it is unrelated to this program's rig and the sample on it."""
    storage: FrameStorage | None = None
    """Size of its frames if they may be compressed."""
    damaged: tuple[Shot, ...] = ()
    """Frames that were found to differ from their checksums."""
    held: str = ""
    """Who holds its frames, and why; empty without a hold."""


@dataclass(frozen=True, slots=True)
class KernelProgress:
    """Compilation of the numerical kernels: parts that are done, of how many, and the part that comes next.

    seconds: since it began, told now and then while a part takes long.
    """

    n_done: int
    n_parts: int
    part: str
    seconds: int = 0

    @property
    def words(self) -> str:
        """One line for people."""
        so_far = f", {self.seconds} s so far" if self.seconds else ""
        return f"{COMPILING}: {self.n_done} of {self.n_parts}, {self.part}{so_far}"


COMPILING = "Compiling the numerical kernels for this machine, once"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State that all browsers share."""

    version: int = 0
    rig: RigStatus = RigStatus()
    overview: Overview | None = None
    draft: Draft = Draft()
    exposure: FoundExposure | None = None
    data_folder: Path = Path()
    datasets: tuple[DatasetEntry, ...] = ()
    dataset: OpenDataset | None = None
    scan: ScanProgress | None = None
    works: tuple[Work, ...] = ()
    faults: tuple[Fault, ...] = ()
    surface: SurfaceInfo | None = None
    findings: tuple[AnyResult, ...] = ()
    findings_undo: bool = False
    findings_redo: bool = False
    operating: Operating = Operating()
    compute_ready: bool = False
    kernels: KernelProgress | None = None
    """Compilation in progress; None if there is nothing to compile."""
    control: ControlState = ControlState()
    notebook: NotebookState = NotebookState()
    comparisons: tuple[Compared, ...] = ()
    gauge: GaugeState = GaugeState()
    calibration: CalibrationState = CalibrationState()
    inspection: InspectionState = InspectionState()
    live: LiveState = LiveState()
    defect_files: DefectFilesState = DefectFilesState()
    reopening: bool = False
    """True while the state of the last run is being restored."""

    @property
    def scanning(self) -> bool:
        """True if the rig is busy with a scan."""
        return self.rig.state in ("scanning", "paused", "stopping")

    @property
    def surface_is_whole(self) -> bool:
        """True if the stitched surface is complete: no scan and no background work is running."""
        return self.surface is not None and not self.scanning and not self.works

    @property
    def simulated(self) -> bool:
        """True if the page must show SIMULATED: the dataset is simulated, or without one the rig."""
        return self.rig.simulated if self.dataset is None else self.dataset.simulated

    @property
    def is_of_this_rig(self) -> bool:
        """True if the open dataset was taken by such a rig; other data have no positions on its stage."""
        data = self.dataset
        return data is not None and not data.imported and data.simulated == self.rig.simulated

    @property
    def dataset_overview(self) -> Overview | None:
        """Overview image if it shows the sample of the open dataset; None for data of another instrument."""
        return self.overview if self.is_of_this_rig else None


Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class MarkedPositions:
    """Stage x, y in um of corners by number from 0; empty for another wafer or other corners."""

    of: tuple[object, ...] = ()
    at_um: dict[int, Place] = field(default_factory=dict[int, Place])

    def with_place(self, job: Job, n: int, place_um: Place) -> MarkedPositions:
        """Return a copy with the position of the n-th corner. Raises PlanError when the job has no such corner."""
        if job.marks is None or not 0 <= n < len(job.marks.places):
            raise PlanError(f"There is no corner {n + 1} to mark: the job names how many there are.")
        before = self.at_um if self.of == _wafer(job) else {}
        return replace(self, of=_wafer(job), at_um={**before, n: place_um})

    def places_um(self, job: Job) -> tuple[Place | None, ...]:
        """Return the position of each corner of the job; None for a corner not marked yet."""
        if job.marks is None:
            return ()
        at_um = self.at_um if self.of == _wafer(job) else {}
        return tuple(at_um.get(n) for n in range(len(job.marks.places)))


def _wafer(job: Job) -> tuple[object, ...]:
    return job.product, job.marks, job.sample.lot, job.sample.wafer_id
