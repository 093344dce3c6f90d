"""How a wafer lies on the stage: which places of it are marked, and the transform that the marks give."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from wafer_viewer.model.spec import NonNegative, Positive, Spec, Within

Notch = Literal["down", "left", "up", "right", "none"]
QUARTER_TURNS: dict[Notch, int] = {"down": 0, "left": -1, "up": 2, "right": 1, "none": 0}
"""Anticlockwise quarter turns from a wafer with its notch down to one with its notch there, seen from above."""


class AlignmentMark(Spec, frozen=True, kw_only=True):
    """A place that is easy to find, a corner of a die as a rule: its name, and where it is on the wafer."""

    name: str
    x_um: float
    y_um: float


class Marks(Spec, frozen=True, kw_only=True):
    """What the wafers of a product are aligned by: at least two places far apart, in wafer um.

    limit_um: a scan begins only when no mark is further from where the alignment puts it.
    """

    places: tuple[AlignmentMark, ...]
    limit_um: Positive = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.places) < 2:
            self.refuse("places", "at least 2 corners of dies, far apart")


class Alignment(Spec, frozen=True, kw_only=True):
    """Stage to wafer coordinates: a turn about the stage's origin, then a shift; with the residual of its fit.

    residual_um: how far the worst mark is from where the transform puts it; n_marks: how many it was fitted to.
    """

    rotation_rad: float = 0.0
    shift_x_um: float = 0.0
    shift_y_um: float = 0.0
    residual_um: NonNegative = 0.0
    n_marks: Annotated[int, Within(0)] = 0

    def to_wafer(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Wafer coordinates of a stage position."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        return c * x_um - s * y_um + self.shift_x_um, s * x_um + c * y_um + self.shift_y_um

    def to_stage(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Stage coordinates of a place on the wafer."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        dx, dy = x_um - self.shift_x_um, y_um - self.shift_y_um
        return c * dx + s * dy, -s * dx + c * dy

    @classmethod
    def by_notch(cls, notch: Notch) -> Alignment:
        """Where a wafer is expected before anything is marked: centred on the stage, turned as its notch points."""
        return cls(rotation_rad=-QUARTER_TURNS[notch] * math.pi / 2)
