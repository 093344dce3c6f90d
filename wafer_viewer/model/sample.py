"""The thing under the objective: its names, how it lies on the stage, what is to be measured on it."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from wafer_viewer.model.spec import NonNegative, Spec, Within


class Sample(Spec, frozen=True, kw_only=True):
    """Asked for before a real scan, filled in for the virtual rig. Width and height are those of its outline, in um."""

    name: str = ""
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    slot: Annotated[int, Within(0, 99)] = 0
    notch: Literal["down", "left", "up", "right", "none"] = "none"
    mount: str = ""
    operator: str = ""
    width_um: NonNegative = 0.0
    height_um: NonNegative = 0.0


class Alignment(Spec, frozen=True, kw_only=True):
    """Stage to wafer coordinates: a turn about the stage's origin, then a shift; with the residual of its fit."""

    rotation_rad: float = 0.0
    shift_x_um: float = 0.0
    shift_y_um: float = 0.0
    residual_um: NonNegative = 0.0

    def to_wafer(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Wafer coordinates of a stage position."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        return c * x_um - s * y_um + self.shift_x_um, s * x_um + c * y_um + self.shift_y_um

    def to_stage(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Stage coordinates of a place on the wafer."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        dx, dy = x_um - self.shift_x_um, y_um - self.shift_y_um
        return c * dx + s * dy, -s * dx + c * dy


class Feature(Spec, frozen=True, kw_only=True):
    """A height to be measured on every sample of a product, with its limits and how a verdict is reached."""

    name: str
    nominal_um: float
    lower_limit_um: float
    upper_limit_um: float
    decision_rule: Literal["guard_band", "simple_acceptance"] = "guard_band"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.upper_limit_um <= self.lower_limit_um:
            self.refuse("upper_limit_um", f"over the lower limit {self.lower_limit_um:g} um")
