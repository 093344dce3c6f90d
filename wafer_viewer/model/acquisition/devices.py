"""The roles that devices play. A real rig and the simulated one fulfil the same protocols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.focus_stack import FrameStatus, Image
from wafer_viewer.model.acquisition.plan import Axis, PulseTrain, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.progress import ShouldStop


@dataclass(frozen=True, slots=True)
class Position:
    """Where the stage is, in um."""

    x_um: float
    y_um: float
    z_um: float


@dataclass(frozen=True, slots=True)
class Pulse:
    """One pulse as the box recorded it: its number in the run from 0, scale count, box time, flags."""

    number: int
    count: int
    time_us: int
    flags: int = 0


@dataclass(frozen=True, slots=True)
class PulseSummary:
    """What the box says at the end of a run."""

    emitted: int
    suppressed: int
    quadrature_errors: int
    exposures: int


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """What a camera hands over: the image, its own trigger counter where it has one, its own clock, the status.

    trigger_count counts edges from 0 at `start`, ignored ones too. Images are paired with pulses by device_time_us, the
    time of the trigger or a fixed delay after it; the counter is held against that, and may be wrong, wrap or miss.
    """

    image: Image | None
    trigger_count: int | None
    device_time_us: int
    status: FrameStatus


class Clock(Protocol):
    """Time as the rig lives it; the simulated rig has its own."""

    def now_s(self) -> float:
        """Seconds since the rig was switched on."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        ...


class SerialPort(Protocol):
    """The part of pyserial's ``Serial`` that protocol clients use."""

    timeout: float | None

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Up to `size` bytes; fewer when the timeout passes."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        ...

    def close(self) -> None:
        """Let the port go."""
        ...


class Stage(Protocol):
    """Three axes with scales, in um; a move that leaves the range raises RigError before anything moves."""

    def position(self) -> Position:
        """Where the stage is now."""
        ...

    def move_to(
        self,
        *,
        x_um: float | None = None,
        y_um: float | None = None,
        z_um: float | None = None,
        should_stop: ShouldStop | None = None,
    ) -> None:
        """Go there at full speed and wait until it has settled; None leaves an axis where it is.

        `should_stop` is asked before, and every few ms on the way, so a driver starts the axes and polls them instead
        of waiting for one long answer. Where it says True the stage is stopped, and MotionStopped comes once it stands.
        The scan sets its deadline by that question: a driver that does not ask it can hang.
        """
        ...

    def start(self, axis: Axis, to_um: float, speed_um_s: float) -> None:
        """Begin a motion of one axis at a given speed, and return at once."""
        ...

    def homed(self) -> bool:
        """Whether every axis knows where it is; one that does not has to look for its reference before a move.

        A search that was broken off leaves it not homed.
        """
        ...

    def moving(self) -> bool:
        """Whether any axis is in motion."""
        ...

    def wait(self) -> None:
        """Wait until every axis stands and has settled. Raises RigTimeout when it does not report so in time."""
        ...

    def stop(self) -> None:
        """Decelerate every axis to a halt. This is no emergency stop."""
        ...


class PulseBox(Protocol):
    """Counts scale pulses, divides them and triggers the camera (WPC/1)."""

    def arm(self, train: PulseTrain, *, on_command: bool = False) -> None:
        """Be ready for one pass; pulses of an earlier run are forgotten. Raises RigError on refusal.

        on_command: pulses come from `fire` alone, not from the scale: stop and shoot.
        """
        ...

    def fire(self) -> None:
        """Send one pulse of the armed run now: for stop and shoot."""
        ...

    def count(self, axis: Axis) -> int:
        """The count of an axis now, as the box has it. It may send a pulse for that: let no camera wait for one."""
        ...

    def correct_count(self, axis: Axis, off: int) -> None:
        """Leave out, from here on, the counts that the box has too many on an axis: the way to mend a slip."""
        ...

    def pulses(self) -> list[Pulse]:
        """The pulses sent since the last call, in order; beats the heart of the box as well."""
        ...

    def disarm(self) -> PulseSummary:
        """End the run. Raises RigError when the box was started anew meanwhile."""
        ...

    def halt(self) -> None:
        """Stop pulses at once."""
        ...


class Camera(Protocol):
    """A triggered camera."""

    def start(self, exposure_us: float) -> None:
        """Wait for triggers, at a given exposure; the trigger counter starts at 0."""
        ...

    def next_image(self, timeout_s: float) -> CameraImage | None:
        """The next image, or None when none came in time."""
        ...

    def stop(self) -> None:
        """Wait for triggers no more; images not fetched are dropped."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """A picture of the whole sample, where the rig has one, and what is known of its layout.

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
    """All devices of an instrument together."""

    @property
    def name(self) -> str:
        """What the operator calls it."""
        ...

    @property
    def simulated(self) -> bool:
        """Whether any of it is simulated."""
        ...

    @property
    def limits(self) -> RigLimits:
        """What it can do."""
        ...

    @property
    def setup(self) -> OpticalSetup:
        """Its optics as they are now."""
        ...

    @property
    def calibration(self) -> Calibration | None:
        """The calibration it was configured with, valid or not."""
        ...

    @property
    def clock(self) -> Clock:
        """Its time."""
        ...

    @property
    def stage(self) -> Stage:
        """Its stage."""
        ...

    @property
    def box(self) -> PulseBox:
        """Its pulse box."""
        ...

    @property
    def camera(self) -> Camera:
        """Its camera."""
        ...

    def overview(self) -> Overview | None:
        """A picture of the sample, where there is one."""
        ...

    def prepare(self, plan: ScanPlan, should_stop: ShouldStop) -> None:
        """Get ready for a plan where that takes time of its own, before the scan's time begins."""
        ...

    def close(self) -> None:
        """Stop motion, disarm the box, let the ports go."""
        ...


@runtime_checkable
class SampleChanger(Protocol):
    """A rig that puts samples on its stage by itself, as the virtual one does."""

    def load_sample(self, sample: Sample | None) -> bool:
        """Load a sample, where the rig has it, else the one that it starts with; True where it is another one now."""
        ...
