"""State of the instrument: live view, focus, marked places, and the calibrations of the rig."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import KINDS, CalibrationKind, CalibrationRecord, CalibrationResult
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.focus_stack import Image

# ---------------------------------------------------------------------------------------------------- calibration state


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


# ----------------------------------------------------------------------------------------------------------- live state


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """Live frame, full size.

    taken_s: clock time in s since 1970; score: focus of the frame; brightest: largest grey value; saturated: fraction
    of pixels at the limit; histogram: number of pixels in each of 64 equal classes of grey.
    """

    image: Image
    position: Position
    taken_s: float
    exposure_us: float
    score: float
    brightest: int
    saturated: float
    histogram: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class FocusTrace:
    """Focus scores over z since the last change of place: (z, score) by z, in um, the best one, and the fitted peak.

    x_um, y_um: the place; peak_um, u_um: peak found by the search for the focus, with its standard uncertainty.
    """

    x_um: float = 0.0
    y_um: float = 0.0
    points: tuple[tuple[float, float], ...] = ()
    peak_um: float | None = None
    u_um: float | None = None

    @property
    def best(self) -> tuple[float, float] | None:
        """Position and score of the best frame; None before the first."""
        return max(self.points, key=lambda point: point[1], default=None)

    @property
    def best_um(self) -> float | None:
        """Position of the focus: the fitted peak, else the best frame."""
        return self.peak_um if self.peak_um is not None or self.best is None else self.best[0]


@dataclass(frozen=True, slots=True)
class LivePlace:
    """Named position of the stage, um."""

    name: str
    x_um: float
    y_um: float
    z_um: float


@dataclass(frozen=True, slots=True)
class LiveState:
    """Settings and marks of the live view.

    exposure_us: None for that of the plan. problem: reason why the view ended. corners: two opposite corners of the
    area to scan. lowest_um, highest_um: z range to scan. places: kept ones. found_um: highest z at which the search
    found the focus. began_um: z at which the view began. goal_um: x, y of the drive under way, with its expected
    duration `goal_s`.
    """

    exposure_us: float | None = None
    problem: str = ""
    corners: tuple[LivePlace | None, LivePlace | None] = (None, None)
    lowest_um: float | None = None
    highest_um: float | None = None
    places: tuple[LivePlace, ...] = ()
    found_um: float | None = None
    began_um: float | None = None
    goal_um: tuple[float, float] | None = None
    goal_s: float = 0.0

    @property
    def area_um(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """x, y of both corners; None until both are marked."""
        first, second = self.corners
        return None if first is None or second is None else ((first.x_um, first.y_um), (second.x_um, second.y_um))

    @property
    def range_um(self) -> tuple[float, float] | None:
        """Lowest and highest z to scan; None until both are marked."""
        return None if self.lowest_um is None or self.highest_um is None else (self.lowest_um, self.highest_um)
