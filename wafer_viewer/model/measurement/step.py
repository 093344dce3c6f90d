"""Results for step heights between faces, and for grooves, ridges and steps in profiles."""

from __future__ import annotations

from typing import Literal

from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.measurement.tool_options import GrooveOptions, StepOptions
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import NonNegative


class StepHeight(MeasurementResult, frozen=True, kw_only=True, tag="step_height"):
    """Height of one face over another, with the definition of h.

    also_upper, also_lower: further regions of the two faces; at_joint: step of both faces extrapolated to the middle
    between the regions; tilt: of one face against the other, in mrad; not_evaluated: contributions missing from the
    budget.
    """

    upper: Region
    lower: Region
    also_upper: tuple[Region, ...] = ()
    also_lower: tuple[Region, ...] = ()
    height: Length
    definition: str
    options: StepOptions = StepOptions()
    at_joint: Length | None = None
    tilt: Quantity | None = None
    upper_mean_um: float
    lower_mean_um: float
    upper_sq_um: NonNegative
    lower_sq_um: NonNegative
    upper_points: int
    lower_points: int
    relative_tilt_mrad: NonNegative = 0.0
    not_evaluated: tuple[str, ...] = ()

    @property
    def main(self) -> Quantity:
        """The step height."""
        return self.height.quantity

    @property
    def regions(self) -> tuple[Region, ...]:
        """All regions of both faces, the first upper and the first lower one in front."""
        return (self.upper, self.lower, *self.also_upper, *self.also_lower)


class StepProfile(MeasurementResult, frozen=True, kw_only=True, tag="step_profile"):
    """A groove, ridge or single step across a line, after ISO 5436-1: z = a x + b + h delta.

    height: depth of a groove or height of a ridge, positive; for a step, the height behind its edge minus that before
    it. edges_um: positions of the edges along the line; zones: names with their ends along the line, in um; curve: the
    profile in a few hundred points, distance and height in um.
    """

    line: Region
    kind: Literal["groove", "ridge", "step"]
    height: Length
    definition: str
    options: GrooveOptions = GrooveOptions()
    width: Length | None = None
    edges_um: tuple[float, ...]
    zones: tuple[tuple[str, float, float], ...]
    curve: tuple[tuple[float, float], ...] = ()
    sq_um: NonNegative
    points: int
    measured_fraction: NonNegative
    not_evaluated: tuple[str, ...] = ()

    @property
    def main(self) -> Quantity:
        """The height or depth."""
        return self.height.quantity
