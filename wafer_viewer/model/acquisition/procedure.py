"""Procedures: work with the devices of a rig other than a scan, and the exposure that one of them finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from wafer_viewer.model.acquisition.devices import CameraImage, Rig

# ------------------------------------------------------------------------------------------------------------- exposure


@dataclass(frozen=True, slots=True)
class ExposureLevels:
    """Brightness in focus at an exposure; a pixel counts by its brightest frame over z, as a fraction of white.

    level: of the brightest pixels; clipped_fraction: share of pixels at white; dark_fraction: share of pixels too dark
    to measure heights from; dark_level: median of those, 0 without any; brightest_field: number of the field that has
    the brightest pixels.
    """

    exposure_us: float
    level: float
    clipped_fraction: float
    dark_fraction: float
    dark_level: float
    brightest_field: int


@dataclass(frozen=True, slots=True)
class FoundExposure:
    """Exposure that suits the brightest of some fields over their z range, and what it was found from.

    single: at the exposure found; bracket: proposed where a single exposure leaves too much in the dark, shortest
    first, else empty; fields: numbers; z_um: positions above the start of each field's sweep; n_frames: frames taken.
    """

    single: ExposureLevels
    bracket: tuple[ExposureLevels, ...]
    fields: tuple[int, ...]
    z_um: tuple[float, ...]
    n_frames: int

    @property
    def single_us(self) -> tuple[float, ...]:
        """The exposure found, as exposures of a plan."""
        return (self.single.exposure_us,)

    @property
    def bracket_us(self) -> tuple[float, ...]:
        """The proposed bracket, as exposures of a plan."""
        return tuple(levels.exposure_us for levels in self.bracket)


# ------------------------------------------------------------------------------------------------------------ procedure


Result = TypeVar("Result", covariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class ProcedureStep:
    """Progress of a procedure: completed fraction, the current step in words, and the latest image, if any."""

    fraction: float
    words: str = ""
    image: CameraImage | None = None


class ProcedureControl(Protocol):
    """Monitoring and control of a running procedure, which polls it between frames and during moves."""

    def should_stop(self) -> bool:
        """Return True to end the procedure; it then raises MotionStopped."""
        ...

    def report(self, step: ProcedureStep) -> None:
        """Report the progress."""
        ...


class Procedure(Protocol[Result]):
    """Work with the devices of a rig that ends in a result.

    An implementation is a frozen dataclass of its parameters: it is sent to the process that owns the rig, and its
    result is sent back.
    """

    @property
    def title(self) -> str:
        """Title in the list of running work, such as "Find the exposure"."""
        ...

    def run(self, rig: Rig, control: ProcedureControl) -> Result:
        """Carry the procedure out and return its result; the rig is brought to rest afterwards.

        Raises RigError if a device fails or the sample does not allow a result, MotionStopped if stopped.
        """
        ...
