"""Commands to the rig process, and its reports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wafer_viewer.acquire.motion import REST, JogVelocity
from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import Overview, Position
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.model.acquisition.procedure import Procedure, ProcedureStep
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.session.state.snapshot import LatestFrame, ScanProgress


@dataclass(frozen=True, slots=True)
class Move:
    """Move to a position; None leaves an axis unchanged. Answered on arrival."""

    x_um: float | None = None
    y_um: float | None = None
    z_um: float | None = None


@dataclass(frozen=True, slots=True)
class Drive:
    """Move to a position, or by a distance, clear of the highest known point; far ways go over the safe z.

    None leaves an axis unchanged. Answered on arrival.
    """

    x_um: float | None = None
    y_um: float | None = None
    z_um: float | None = None
    by: bool = False
    highest_um: float | None = None


@dataclass(frozen=True, slots=True)
class MovePositioner:
    """Move a positioner to a position or to the name of one, with z at the safe z before it turns.

    Answered on arrival, with its reading.
    """

    name: str
    to: float | str


@dataclass(frozen=True, slots=True)
class Jog:
    """Word of a jog: the velocity for the next moment; the stage stops by itself when no word follows in time.

    hold: number of the press of a key, the same in all its words; a stop ends that press. highest_um: highest known z
    of the sample. The first word is answered when the stage is at rest again, the others at once.
    """

    hold: int
    velocity: JogVelocity = REST
    highest_um: float | None = None


@dataclass(frozen=True, slots=True)
class WatchLive:
    """Take frames on command at an exposure, between other commands, until nobody has watched for some seconds."""

    exposure_us: float


@dataclass(frozen=True, slots=True)
class LiveTaken:
    """The last live frame was received: the next may be sent. Answered at once."""


@dataclass(frozen=True, slots=True)
class LoadSample:
    """Load the sample named by a job, on a rig with a sample changer. Answered once it is on the stage."""

    sample: Sample | None


@dataclass(frozen=True, slots=True)
class Scan:
    """Scan a plan into a new dataset, or the missing frames into an existing one.

    Answered once the scan has started.
    """

    path: Path
    plan: ScanPlan
    job: Job
    goes_on: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RunProcedure:
    """Carry out a procedure; `number` identifies it in the reports. Answered with its result, once the rig is at rest.

    A stop ends it, and it is answered with MotionStopped.
    """

    number: int
    procedure: Procedure[Any]


@dataclass(frozen=True, slots=True)
class Pause:
    """Pause at the end of the current pass. Answered at once."""


@dataclass(frozen=True, slots=True)
class Resume:
    """Resume after a pause. Answered at once."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop the current motion, drop queued motions and end the scan.

    Answered once the rig is at rest, with whether there was anything to stop.
    """


@dataclass(frozen=True, slots=True, eq=False)
class RigReady:
    """The rig is ready: its identity, limits and state.

    `tour` is a complete job, for a rig that brings its own sample.
    """

    name: str
    simulated: bool
    limits: RigLimits
    setup: OpticalSetup
    calibration: Calibration | None
    position: Position
    tour: Job | None
    homed: bool
    positioners: tuple[PositionerState, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OverviewReady:
    """Overview image of the sample, which may take longer than the rig itself; None if there is none."""

    overview: Overview | None


@dataclass(frozen=True, slots=True)
class RigAbsent:
    """The rig could not be opened."""

    why: str


@dataclass(frozen=True, slots=True)
class StageMoved:
    """Stage position, and whether the stage is still homed; None means unchanged."""

    position: Position
    homed: bool | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PositionersMoved:
    """Positions of the positioners, with the limits, the setup and the calibration that follow from them."""

    positioners: tuple[PositionerState, ...]
    limits: RigLimits
    setup: OpticalSetup
    calibration: Calibration | None


@dataclass(frozen=True, slots=True)
class Jogging:
    """A jog has begun or ended."""

    jogging: bool


@dataclass(frozen=True, slots=True)
class LiveFailed:
    """The live view ended because a device failed."""

    why: str


@dataclass(frozen=True, slots=True)
class Paused:
    """The scan was paused or resumed."""

    paused: bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameTaken:
    """Scan progress after a frame; `latest` is set a few times a second."""

    progress: ScanProgress
    position: Position
    latest: LatestFrame | None


@dataclass(frozen=True, slots=True, eq=False)
class ProcedureProgress:
    """Progress of the procedure with this number."""

    number: int
    step: ProcedureStep


@dataclass(frozen=True, slots=True)
class FieldComplete:
    """The last frame of a field is stored."""

    number: int


@dataclass(frozen=True, slots=True)
class ScanFault:
    """Fault of the running scan that the operator should see."""

    what: str


@dataclass(frozen=True, slots=True)
class ScanEnded:
    """The scan is over and its dataset closed. `error` is the reason if it did not end normally."""

    path: Path
    stopped: bool
    n_missing: int
    error: str | None
