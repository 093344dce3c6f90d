"""Protocols for consumers and controllers of a running scan."""

from __future__ import annotations

from typing import Protocol

from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import Leg, ScanPlan, Shot


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
