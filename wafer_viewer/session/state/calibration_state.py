"""State of the calibrations of the rig: signed ones by kind, the running one, and a result to be accepted."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import KINDS, CalibrationKind, CalibrationRecord, CalibrationResult


@dataclass(frozen=True, slots=True)
class CalibrationHistory:
    """Signed calibrations of one kind, oldest first; is_due: there is none, or the newest is no longer valid."""

    kind: CalibrationKind
    records: tuple[CalibrationRecord, ...] = ()
    is_due: bool = True

    @property
    def newest(self) -> CalibrationRecord | None:
        """Newest signed calibration; None before the first."""
        return self.records[-1] if self.records else None


@dataclass(frozen=True, slots=True)
class RunningCalibration:
    """Calibration that runs on the rig: title of its work item, completed fraction, and the present step in words."""

    kind: CalibrationKind
    title: str
    fraction: float = 0.0
    words: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PendingCalibration:
    """Result that nobody has accepted yet, the calibration it started from, and whether its data are simulated."""

    result: CalibrationResult
    base: Calibration
    simulated: bool


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """Calibrations of the rig.

    histories: one for each kind. problem: why the records cannot be read. running, pending: the running calibration and
    the result to be kept or discarded; None if there is none.
    """

    histories: tuple[CalibrationHistory, ...] = ()
    problem: str = ""
    running: RunningCalibration | None = None
    pending: PendingCalibration | None = None

    def history(self, kind: CalibrationKind) -> CalibrationHistory:
        """Return the signed calibrations of a kind."""
        return next((one for one in self.histories if one.kind == kind), CalibrationHistory(kind))

    @property
    def n_due(self) -> int:
        """Number of kinds that are due or were never measured."""
        return sum(self.history(kind).is_due for kind in KINDS)
