"""The thing under the objective: its names, how it lies on the stage, what is to be measured on it."""

from __future__ import annotations

from typing import Annotated, Literal

from wafer_viewer.model.alignment import Notch
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import NonNegative, Spec, Within

DecisionRule = Literal["guard_band", "simple_acceptance"]


class Sample(Spec, frozen=True, kw_only=True):
    """Asked for before a real scan, filled in for the virtual rig. Width and height are those of its outline, in um."""

    name: str = ""
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    slot: Annotated[int, Within(0, 99)] = 0
    notch: Notch = "none"
    mount: str = ""
    operator: str = ""
    width_um: NonNegative = 0.0
    height_um: NonNegative = 0.0


class Feature(Spec, frozen=True, kw_only=True):
    """A step height to be measured on every sample of a product, with its limits and how a verdict is reached.

    upper, lower: where, in wafer um where the job has marks to align by, else in stage um; without them the feature is
    not measured by itself.
    """

    name: str
    nominal_um: float
    lower_limit_um: float
    upper_limit_um: float
    decision_rule: DecisionRule = "guard_band"
    upper: Region | None = None
    lower: Region | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.upper_limit_um <= self.lower_limit_um:
            self.refuse("upper_limit_um", f"over the lower limit {self.lower_limit_um:g} um")
        if (self.upper is None) != (self.lower is None):
            self.refuse("lower" if self.lower is None else "upper", "a region, as the other one is")

    @property
    def has_place(self) -> bool:
        """Whether it is known where to measure it."""
        return self.upper is not None
