"""State of the live view: frames, scores over z, marked places, and the highest known point of the sample."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.focus_stack import Image


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
