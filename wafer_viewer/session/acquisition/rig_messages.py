"""Commands to the rig process, and its reports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import Overview, Position
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job.job import Job
from wafer_viewer.session.state.snapshot import LatestFrame, ScanProgress


@dataclass(frozen=True, slots=True)
class Move:
    """Go there; None leaves an axis where it is. Answered on arrival."""

    x_um: float | None = None
    y_um: float | None = None
    z_um: float | None = None


@dataclass(frozen=True, slots=True)
class LoadSample:
    """Load the sample that a job names, on a rig that changes samples by itself. Answered once it lies on the stage."""

    sample: Sample | None


@dataclass(frozen=True, slots=True)
class Scan:
    """Take a plan into a new dataset, or what is missing of it into one that exists. Answered once it has begun."""

    path: Path
    plan: ScanPlan
    job: Job
    goes_on: bool = False


@dataclass(frozen=True, slots=True)
class Pause:
    """Halt at the end of this pass. Answered at once."""


@dataclass(frozen=True, slots=True)
class Resume:
    """Go on after a pause. Answered at once."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Break off the motion under way and those that wait for it, and end the scan.

    Answered once the rig is at rest, with whether there was anything to stop.
    """


@dataclass(frozen=True, slots=True, eq=False)
class RigReady:
    """The rig answers: what it is and can do; `tour`: a filled-in job, where the rig brings a sample of its own."""

    name: str
    simulated: bool
    limits: RigLimits
    setup: OpticalSetup
    calibration: Calibration | None
    position: Position
    tour: Job | None
    homed: bool


@dataclass(frozen=True, slots=True, eq=False)
class OverviewReady:
    """The picture of the whole sample, which may take longer than the rig itself; None where there is none."""

    overview: Overview | None


@dataclass(frozen=True, slots=True)
class RigAbsent:
    """The rig could not be opened."""

    why: str


@dataclass(frozen=True, slots=True)
class StageMoved:
    """Where the stage stands, and whether it still knows so by itself; None: as it was before."""

    position: Position
    homed: bool | None = None


@dataclass(frozen=True, slots=True)
class Paused:
    """The scan halted, or went on."""

    paused: bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameTaken:
    """How far the scan is; `latest` a few times a second."""

    progress: ScanProgress
    position: Position
    latest: LatestFrame | None


@dataclass(frozen=True, slots=True)
class FieldComplete:
    """The last frame of a field is kept."""

    number: int


@dataclass(frozen=True, slots=True)
class ScanFault:
    """Something about the running scan that a person should know."""

    what: str


@dataclass(frozen=True, slots=True)
class ScanEnded:
    """The scan is over and its dataset closed. `error` says what ended it, where it did not end by itself."""

    path: Path
    stopped: bool
    n_missing: int
    error: str | None
