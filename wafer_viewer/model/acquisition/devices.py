"""Protocols of devices, implemented by real and simulated rigs, and of the consumers of a running scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.plan import Axis, Leg, PulseTrain, ScanPlan, Shot
from wafer_viewer.model.acquisition.positioners import Positioner
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.model.spec import Spec


@dataclass(frozen=True, slots=True)
class Position:
    """Stage position in um."""

    x_um: float
    y_um: float
    z_um: float


@dataclass(frozen=True, slots=True)
class Pulse:
    """One pulse recorded by the box: its number in the run from 0, scale count and box time."""

    number: int
    count: int
    time_us: int


@dataclass(frozen=True, slots=True)
class PulseSummary:
    """Summary of a run, reported by the pulse box."""

    emitted: int
    suppressed: int
    quadrature_errors: int
    exposures: int


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """Image from the camera, with its trigger counter if it has one, its device time and its status.

    trigger_count counts trigger edges from 0 at `start`, including ignored ones. Images are paired with pulses by
    device_time_us, the time of the trigger or a fixed delay after it. The counter is only a cross-check: it may be
    wrong, wrap around or be missing. exposure_us: as reported with the image; None if the camera does not report it.
    """

    image: Image | None
    trigger_count: int | None
    device_time_us: int
    status: FrameStatus
    exposure_us: float | None = None


@dataclass(frozen=True, slots=True)
class BoxIdentity:
    """Name and capacity of a pulse box, as it reports them.

    ring: number of pulse records kept by the box; count_rate_hz: greatest count rate of a scale that it follows;
    width_us: shortest and longest pulse; has_index: it has inputs for the index marks of the scales; boot: another
    number after each start.
    """

    name: str
    ring: int
    count_rate_hz: int
    width_us: tuple[int, int]
    has_index: bool
    boot: int


class DeviceIdentity(Spec, frozen=True, kw_only=True):
    """One device of a rig: its role, the name of its driver, and what it says that it is, with its firmware."""

    error: ClassVar[type[WaferViewerError]] = RigError
    role: str
    driver: str
    identity: str


class Clock(Protocol):
    """Clock of the rig; the simulated rig has its own."""

    def now_s(self) -> float:
        """Return the seconds since the rig was switched on."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for a number of seconds."""
        ...


class SerialPort(Protocol):
    """The subset of pyserial's ``Serial`` that protocol clients use."""

    timeout: float | None

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read without waiting."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes; fewer if the timeout expires."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


class Stage(Protocol):
    """Three axes with scales, in um. A move beyond the range raises RigError before anything moves."""

    def position(self) -> Position:
        """Return the current position."""
        ...

    def move_to(
        self,
        *,
        x_um: float | None = None,
        y_um: float | None = None,
        z_um: float | None = None,
        should_stop: ShouldStop | None = None,
    ) -> None:
        """Move at full speed and wait until the stage has settled; None leaves an axis unchanged.

        A driver calls `should_stop` before the move and every few ms during it, so it starts the axes and polls them
        instead of waiting for one long reply. If it returns True, the driver stops the stage and raises MotionStopped
        once it is at rest. The scan enforces its deadline through this callback: a driver that does not call it can
        hang.
        """
        ...

    def start(self, axis: Axis, to_um: float, speed_um_s: float) -> None:
        """Start a motion of one axis at a given speed and return at once."""
        ...

    def homed(self) -> bool:
        """Return whether every axis is homed. An axis that is not homed must find its reference before a move.

        An interrupted search leaves the axis not homed.
        """
        ...

    def moving(self) -> bool:
        """Return whether any axis is moving."""
        ...

    def wait(self) -> None:
        """Wait until every axis is at rest and has settled. Raises RigTimeout if that is not reported in time."""
        ...

    def stop(self) -> None:
        """Decelerate every axis to a halt. Not an emergency stop."""
        ...


class PulseBox(Protocol):
    """Counts scale pulses, divides them and triggers the camera (WPC/2).

    After power-up its counts are 0 wherever the stage stands. Every call raises PulseBoxRestarted, once, if the box
    restarted since the last one: its counts must then be set again by `reference` or `reference_by_index`.
    """

    def hello(self) -> BoxIdentity:
        """Ask the box for its name, its capacity and the number of its starts."""
        ...

    def referenced(self, axis: Axis) -> bool:
        """Return whether the count of an axis was set since the box started."""
        ...

    def reference(self, axis: Axis, count: int) -> None:
        """Set the box's count of an axis at rest. Raises RigError while the box is armed."""
        ...

    def reference_by_index(self, axis: Axis, count: int) -> None:
        """Let the box set its count of an axis when the axis next meets its index mark; arming is refused before.

        Raises RigError while the box is armed, and if it has no inputs for index marks.
        """
        ...

    def latched(self, axis: Axis) -> int | None:
        """Return the count at which the index mark set a new one since the last reference; None if it has not yet."""
        ...

    def arm(self, train: PulseTrain, *, min_gap_us: float = 0.0, on_command: bool = False) -> None:
        """Arm the box for one pass and discard pulses of earlier runs.

        Raises RigError on refusal, as for an axis that was not referenced since the box started.
        min_gap_us: least time between two pulses of the scale; the box suppresses and counts nearer ones.
        on_command: pulses are triggered only by `fire`, not by the scale (stop and shoot).
        """
        ...

    def fire(self) -> None:
        """Send one pulse of the armed run now (stop and shoot)."""
        ...

    def count(self, axis: Axis) -> int:
        """Return the box's current count of an axis."""
        ...

    def pulses(self) -> list[Pulse]:
        """Return the pulses sent since the last call, in order; also sends the heartbeat to the box."""
        ...

    def disarm(self) -> PulseSummary:
        """End the run and return its summary."""
        ...

    def halt(self) -> None:
        """Stop sending pulses immediately."""
        ...


class Camera(Protocol):
    """A triggered camera."""

    def start(self, exposure_us: float) -> None:
        """Start waiting for triggers at a given exposure; the trigger counter starts at 0."""
        ...

    def next_image(self, timeout_s: float) -> CameraImage | None:
        """Return the next image, or None if none arrived within the timeout."""
        ...

    def stop(self) -> None:
        """Stop waiting for triggers; images not fetched are dropped."""
        ...


@runtime_checkable
class ExposureSequencer(Protocol):
    """A camera that changes its exposure from frame to frame, as `CameraLimits.exposure_sequence` says.

    Its images report their exposure, because a trigger that it ignores or an extra edge shifts the sequence. Its device
    time is that of the trigger or of the start of the exposure, whatever the exposure.
    """

    def start_sequence(self, exposures_us: tuple[float, ...]) -> None:
        """Start waiting for triggers; the exposures follow each other in turn from the first one on."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """Overview picture of the sample, if the rig has one, and its known layout.

    image: uint8 [row, col] or None; x0_um, y0_um: the centre of its pixel (0, 0);
    outline_um, dies_um: corners of polygons in stage um, (x, y) each.
    """

    image: NDArray[np.uint8] | None
    pixel_um: float
    x0_um: float
    y0_um: float
    outline_um: tuple[tuple[float, float], ...]
    dies_um: tuple[tuple[tuple[float, float], ...], ...]
    title: str


class Rig(Protocol):
    """All devices of an instrument."""

    @property
    def name(self) -> str:
        """Display name of the rig."""
        ...

    @property
    def simulated(self) -> bool:
        """True if any device is simulated."""
        ...

    @property
    def limits(self) -> RigLimits:
        """Limits of the rig; those of the objective and its pixel are of the one in the light path."""
        ...

    @property
    def setup(self) -> OpticalSetup:
        """Current optical setup."""
        ...

    @property
    def calibration(self) -> Calibration | None:
        """Calibration from the configuration, valid or not."""
        ...

    @property
    def clock(self) -> Clock:
        """Clock of the rig."""
        ...

    @property
    def stage(self) -> Stage:
        """Stage of the rig."""
        ...

    @property
    def box(self) -> PulseBox:
        """Pulse box of the rig."""
        ...

    @property
    def camera(self) -> Camera:
        """Camera of the rig."""
        ...

    @property
    def positioners(self) -> Mapping[str, Positioner]:
        """Light, objective, zoom, tilts and rotation by the names of the rig's file, as far as they are motorised."""
        ...

    def identities(self) -> tuple[DeviceIdentity, ...]:
        """Return all devices with their drivers and what they say that they are."""
        ...

    def overview(self) -> Overview | None:
        """Return a picture of the sample, or None."""
        ...

    def prepare(self, plan: ScanPlan, should_stop: ShouldStop) -> None:
        """Prepare for a plan, if that takes time of its own, before the duration of the scan is counted."""
        ...

    def close(self) -> None:
        """Stop motion, disarm the box and close the ports."""
        ...


@runtime_checkable
class SampleChanger(Protocol):
    """A rig that loads samples onto its stage by itself, such as the virtual rig."""

    def load_sample(self, sample: Sample | None) -> bool:
        """Load a sample if the rig has it, else its initial one; return True if the sample has changed."""
        ...


class ScanSink(Protocol):
    """Receiver of a scan's frames and events, such as the dataset writer.

    Every call returns once the data is stored.
    """

    def pass_begun(self, number: int, leg: Leg) -> None:
        """Record the start of a leg."""
        ...

    def frame(self, frame: Frame) -> None:
        """Store a frame, which is valid once its pass has ended; a slot that is already stored is not written again."""
        ...

    def missed(self, shot: Shot, pulse_count: int, why: str) -> None:
        """Record that a slot is empty, or that its frame of the current pass is to be discarded."""
        ...

    def repaired(self, shot: Shot) -> None:
        """Record that a previously empty slot now has its frame."""
        ...

    def pass_ended(self, number: int, summary: PulseSummary) -> None:
        """Record the end of a leg: its frames are valid."""
        ...

    def fault(self, what: str) -> None:
        """Report a fault to the user."""
        ...


class ScanControl(Protocol):
    """Monitoring and control of a running scan; the runner polls it between frames."""

    def should_stop(self) -> bool:
        """Return True to end the scan and leave the rig at rest."""
        ...

    def should_pause(self) -> bool:
        """Return True to pause at the end of the current leg."""
        ...

    def wait_while_paused(self) -> None:
        """Block until the pause is over or the scan is to stop."""
        ...

    def progress(self, plan: ScanPlan, frame: Frame) -> None:
        """Report a stored frame."""
        ...
