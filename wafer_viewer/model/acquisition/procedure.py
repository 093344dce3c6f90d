"""Procedures: work with the devices of a rig other than a scan, such as finding the focus or the exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from wafer_viewer.model.acquisition.devices import CameraImage, Rig

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
