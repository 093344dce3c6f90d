"""The roles beside a running scan: where its frames go, and who watches and steers it."""

from __future__ import annotations

from typing import Protocol

from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import Leg, ScanPlan, Shot


class ScanSink(Protocol):
    """Where a scan's frames and events go; the dataset's writer is one. Every call returns once the thing is kept."""

    def pass_begun(self, number: int, leg: Leg) -> None:
        """A leg starts."""
        ...

    def frame(self, frame: Frame) -> None:
        """A frame for a slot, which counts once its pass has ended; a slot that is kept is not written again."""
        ...

    def missed(self, shot: Shot, pulse_count: int, why: str) -> None:
        """A slot stayed empty, or its frame of the pass under way is not to be kept."""
        ...

    def repaired(self, shot: Shot) -> None:
        """A slot that stayed empty has its frame now."""
        ...

    def pass_ended(self, number: int, summary: PulseSummary) -> None:
        """A leg is over: its frames count."""
        ...

    def fault(self, what: str) -> None:
        """Something a person should know."""
        ...


class ScanControl(Protocol):
    """How a running scan is watched and steered; the runner asks between frames."""

    def should_stop(self) -> bool:
        """True: end after putting the rig at rest."""
        ...

    def should_pause(self) -> bool:
        """True: halt at the end of this leg, and ask again."""
        ...

    def wait_while_paused(self) -> None:
        """Return when the pause is over or the scan is to stop."""
        ...

    def progress(self, plan: ScanPlan, frame: Frame) -> None:
        """A frame was kept."""
        ...
