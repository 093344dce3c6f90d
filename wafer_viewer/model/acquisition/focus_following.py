"""Settings of a scan that follows the focus, and the findings of the coarse look before it."""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec, Within

FOLLOW_FOCUS = "follow_focus"
"""Name of the strategy."""
FOLLOW_TITLE = "Follow the focus"


class FollowFocus(Spec, frozen=True, kw_only=True):
    """Section ``follow_focus`` of a plan: the sweep is the range in which the focus is searched.

    The window of a field reaches from below_um under the lowest to above_um over the highest height that is expected
    in focus, both by the coverage factor times the standard uncertainty of the prediction.
    """

    below_um: NonNegative = 5.0
    above_um: NonNegative = 5.0
    coverage_factor: Annotated[float, Within(1, 4)] = 2.0


class FocusCell(msgspec.Struct, frozen=True, array_like=True):
    """Lowest and highest z in focus of a part of a field, with the centre of the part."""

    x_um: float
    y_um: float
    low_um: float
    high_um: float


class FocusPlace(Spec, frozen=True, kw_only=True):
    """A field of the coarse look, by its parts in focus; without any, no focus was found.

    u_um: standard uncertainty of its heights in focus.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    field: int
    x_um: float
    y_um: float
    cells: tuple[FocusCell, ...] = ()
    u_um: NonNegative = 0.0

    @property
    def found(self) -> bool:
        """True if a focus was found."""
        return bool(self.cells)

    @property
    def low_um(self) -> float:
        """Lowest z in focus."""
        return min(cell.low_um for cell in self.cells)

    @property
    def high_um(self) -> float:
        """Highest z in focus."""
        return max(cell.high_um for cell in self.cells)


class FieldFocus(msgspec.Struct, frozen=True):
    """Range in focus of a field, found or predicted, with the larger standard uncertainty of its ends."""

    field: int
    low_um: float
    high_um: float
    u_um: float

    @property
    def middle_um(self) -> float:
        """Middle of the range."""
        return (self.low_um + self.high_um) / 2


class CoarseLook(Spec, frozen=True, kw_only=True):
    """Findings of a coarse look: its places, and the duration of its motion."""

    error: ClassVar[type[WaferViewerError]] = RigError
    places: tuple[FocusPlace, ...]
    duration_s: NonNegative

    @property
    def found(self) -> tuple[FocusPlace, ...]:
        """Places with a focus."""
        return tuple(place for place in self.places if place.found)
