"""What the session knows, as one frozen `Snapshot` shared by all browsers. A verb makes a new one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Literal

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Field, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.state.comparison_state import Compared
from wafer_viewer.session.state.control_state import ControlState
from wafer_viewer.session.state.gauge_state import GaugeState
from wafer_viewer.session.state.inspection_resources import DefectShelf
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.operator_state import Operating
from wafer_viewer.session.state.review_state import NotebookState


class FieldState(Enum):
    """How far a field of the open dataset has come."""

    TO_COME = "to come"
    TAKING = "being taken"
    TAKEN = "taken"
    RECONSTRUCTING = "in reconstruction"
    MEASURED = "measured"
    TO_REPEAT = "to repeat"
    FAILED = "failed"


Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
RigState = Literal["absent", "starting", "ready", "moving", "scanning", "paused", "stopping", "fault"]


@dataclass(frozen=True, slots=True)
class RigStatus:
    """The instrument as the header shows it. `message` says what is wrong in state ``fault`` or ``absent``."""

    name: str = "Virtual rig"
    simulated: bool = True
    state: RigState = "starting"
    x_um: float = 0.0
    y_um: float = 0.0
    z_um: float = 0.0
    limits: RigLimits | None = None
    calibration: Calibration | None = None
    setup: OpticalSetup | None = None
    message: str = ""
    homed: bool | None = None
    """Whether every axis knows where it is; None as long as the rig has not said."""


@dataclass(frozen=True, slots=True)
class Typed:
    """The plan's form as somebody left it, in the page's own words, and the sentence that says why it is no plan."""

    form: str
    problem: str


@dataclass(frozen=True, slots=True)
class Draft:
    """The plan being edited: the job, its priced plan, or the sentence that says why there is none."""

    job: Job | None = None
    plan: ScanPlan | None = None
    problem: str | None = None
    can_undo: bool = False
    can_redo: bool = False
    free_bytes: int | None = None
    seen_um: tuple[tuple[float, float] | None, ...] = ()
    """Where each corner to align by was marked on the stage, in the order of the job's marks."""
    confirmed: bool = True
    """False after a plan was opened again, until a person said that the sample on the stage is the one it names."""
    typed: Typed | None = None


@dataclass(frozen=True, slots=True)
class DatasetEntry:
    """One line of the list of datasets in the data folder."""

    path: Path
    name: str
    taken: str
    unfinished: bool
    simulated: bool


@dataclass(frozen=True, slots=True)
class ScanProgress:
    """A running scan, or the last one."""

    field: Field
    k: int
    z_um: float
    order: int
    """The how-manieth field in the order of taking, from 1."""
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
    """The latest frame of a running scan, full size, as it was stored."""

    image: Image
    field: Field
    k: int
    z_um: float
    brightest: int
    clipped_fraction: float


@dataclass(frozen=True, slots=True)
class Work:
    """Background work: shown with its progress, can be cancelled by its id.

    fraction None: how far it is cannot be told, or it has not begun; `waits_for` says what it waits for then.
    stopping: it was cancelled and has not ended yet.
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
    """Something the operator should read. `needs_person` is red; otherwise amber and ends with 'Nothing to do.'."""

    id: str
    title: str
    text: str
    at: str
    where: str = ""
    needs_person: bool = True
    source: Literal["plan", "scan", "import", "open", "surface", "measure", "export", "rig", "other"] = "other"


@dataclass(frozen=True, slots=True)
class StitchingInfo:
    """How the fields of a stitched surface were placed, in numbers; lengths of U are expanded (k = 2).

    doubts: why overlaps are not believed, in words, with their number, the most frequent first. moved: how far fields
    lie from where the stage says. step: what is left between neighbours along z; None where no overlap is compared.
    form: the terms of the whole surface's form that only the stage knows, each with its U. left_out: fields that fit
    none of their neighbours, by number. n_by_stage: fields that overlap others and are placed by the stage alone.
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


@dataclass(frozen=True, slots=True)
class SurfaceInfo:
    """The stitched surface of the open dataset. `stamp` changes whenever its contents do."""

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
    """Reasons in words with the share of pixels each took."""
    overlap_rms_um: float | None
    low_um: float
    high_um: float
    """0.5 and 99.5 % of the heights: the colour range to begin with."""
    recipe_notes: tuple[str, ...] = ()
    asked: Recipe | None = None
    settled: Recipe | None = None
    """The recipe it was made by, and the same with what ``auto`` chose; None where that was not kept."""
    stitching: StitchingInfo | None = None
    """None where fields lie at their stage positions, without a look at their overlaps."""
    changed: tuple[tuple[int, Box], ...] = ()
    """Of a surface that grows: where it changed, oldest first, and the stamp it got by that; empty: everywhere."""


@dataclass(frozen=True, slots=True)
class OpenDataset:
    """The dataset that is open. calibration_problem None: calibrated; otherwise lengths read 'uncalibrated'."""

    path: Path
    name: str
    taken: str
    simulated: bool
    calibration_problem: str | None
    read_only: str | None
    """Why it cannot be written to, or None."""
    finished: bool
    fields: tuple[Field, ...]
    states: dict[int, FieldState]
    stamps: dict[int, int]
    """By field number: changes whenever the field's surface does; a field without one has no surface yet."""
    plan: ScanPlan
    job: Job
    results: tuple[str, ...] = ()
    imported: bool = False
    """Whether it was taken elsewhere: the rig of this program and the sample on it have nothing to do with it."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything every browser shows alike."""

    version: int = 0
    rig: RigStatus = RigStatus()
    overview: Overview | None = None
    draft: Draft = Draft()
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
    hands: ControlState = ControlState()
    notebook: NotebookState = NotebookState()
    comparisons: tuple[Compared, ...] = ()
    gauge: GaugeState = GaugeState()
    inspection: InspectionState = InspectionState()
    shelf: DefectShelf = DefectShelf()
    reopening: bool = False
    """Whether what was open when the program ended is still being opened again."""

    @property
    def scanning(self) -> bool:
        """Whether the rig is busy with a scan."""
        return self.rig.state in ("scanning", "paused", "stopping")

    @property
    def surface_is_whole(self) -> bool:
        """Whether the stitched surface shows all there is: no scan runs and nothing is at work any more."""
        return self.surface is not None and not self.scanning and not self.works

    @property
    def simulated(self) -> bool:
        """Whether SIMULATED has to stand on the page: the rig in use or the dataset shown is simulated."""
        return self.rig.simulated if self.dataset is None else self.dataset.simulated

    @property
    def is_of_this_rig(self) -> bool:
        """Whether the open dataset was taken by a rig such as this one; data from elsewhere lie at no place of it."""
        data = self.dataset
        return data is not None and not data.imported and data.simulated == self.rig.simulated

    @property
    def dataset_overview(self) -> Overview | None:
        """The overview picture where it shows the sample of the open dataset; None for data of another instrument."""
        return self.overview if self.is_of_this_rig else None
