"""Limits of a rig, from which the planner prices strategies."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from wafer_viewer.model.acquisition.calibration import depth_of_field_um
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Count, NonNegative, Positive, Spec, Within

RUN_UP_SPARE_S = 0.005
"""Time in s that an axis runs at constant speed before the first pulse, so that vibration of the ramp has decayed."""

MARK_APPROACH_UM = 200.0
"""Distance before and behind an index mark from which and to which its axis moves, in um."""
MARK_SPEED_UM_S = 1_000.0
"""Greatest speed over an index mark in um/s."""
MARK_RATE_FRACTION = 0.25
"""Greatest count rate over an index mark as a fraction of that of the pulse box, so that it latches within a count."""


class AxisLimits(Spec, frozen=True, kw_only=True):
    """Limits of one axis: range, speed, acceleration, settling time and resolution of its scale.

    index_um: position of its index mark, by which the pulse box is referenced; None to reference it by the position of
    the stage.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    low_um: float
    high_um: float
    speed_um_s: Positive
    acceleration_um_s2: Positive
    settle_s: NonNegative
    counts_per_um: Positive
    index_um: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.high_um <= self.low_um:
            self.refuse("high_um", f"over low_um, which is {self.low_um:g}")
        if self.index_um is not None and not self.low_um < self.index_um < self.high_um:
            self.refuse("index_um", f"between {self.low_um:g} and {self.high_um:g}, within the range of the axis")

    def require_reachable(self, axis: str, to_um: float) -> None:
        """Raise RigError when a position is out of range."""
        if not self.low_um <= to_um <= self.high_um:
            raise RigError(
                f"The {axis} axis cannot go to {to_um:.2f} um: its range is {self.low_um:g} to {self.high_um:g} um."
            )

    def require_speed(self, axis: str, speed_um_s: float) -> None:
        """Raise RigError when the axis cannot move at a speed."""
        if not 0 < speed_um_s <= self.speed_um_s:
            raise RigError(f"The {axis} axis cannot go at {speed_um_s:g} um/s: its limit is {self.speed_um_s:g} um/s.")

    def counts(self, position_um: float) -> int:
        """Return the scale count at a position."""
        return round(position_um * self.counts_per_um)

    def position_um(self, counts: float) -> float:
        """Return the position at a scale count."""
        return counts / self.counts_per_um

    def over_index_um(self, highest_um: float | None = None) -> tuple[float, float] | None:
        """Return start and end of the motion over the index mark, up to a highest position; None without a mark."""
        if self.index_um is None:
            return None
        end_um = min(self.high_um, self.index_um + MARK_APPROACH_UM)
        end_um = end_um if highest_um is None else min(end_um, highest_um)
        return max(self.low_um, self.index_um - MARK_APPROACH_UM), end_um

    def index_speed_um_s(self, count_rate_hz: float) -> float:
        """Return the speed over the index mark, for a pulse box that follows a count rate; 0 for no limit."""
        followed_um_s = self.position_um(count_rate_hz) if count_rate_hz else self.speed_um_s
        return min(MARK_SPEED_UM_S, MARK_RATE_FRACTION * min(followed_um_s, self.speed_um_s))

    def ramp_um(self, speed_um_s: float) -> float:
        """Return the distance needed to reach a speed, or to halt from it."""
        return speed_um_s**2 / (2 * self.acceleration_um_s2)

    def run_up_um(self, speed_um_s: float) -> float:
        """Return the run-up of a pass: the ramp and RUN_UP_SPARE_S at full speed. The run-out is as long.

        It is a whole number of counts: before and after a pass the axis rests on a count, where pulse box and stage
        agree exactly.
        """
        return self.position_um(
            math.ceil((self.ramp_um(speed_um_s) + speed_um_s * RUN_UP_SPARE_S) * self.counts_per_um)
        )

    def move_s(self, distance_um: float, speed_um_s: float | None = None) -> float:
        """Return the duration of a move in s, with settling, at full speed or a given speed."""
        travel_um, speed = abs(distance_um), speed_um_s or self.speed_um_s
        top = min(speed, math.sqrt(travel_um * self.acceleration_um_s2))
        return (travel_um / top + top / self.acceleration_um_s2 if top > 0 else 0.0) + self.settle_s


class CameraLimits(Spec, frozen=True, kw_only=True):
    """Limits of the camera: frame rate, exposure range, size, frames its driver can queue, bit depth.

    readout_us: dead time after an exposure; a trigger during it is ignored. exposure_sequence: the exposure can change
    from frame to frame, by an `ExposureSequencer`.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    frame_rate_hz: Positive
    exposure_min_us: Positive
    exposure_max_us: Positive
    readout_us: NonNegative = 0.0
    rows: Annotated[int, Within(16)]
    cols: Annotated[int, Within(16)]
    queue_frames: Count = 16
    bits: Annotated[int, Within(8, 16)] = 8
    exposure_sequence: bool = False

    def period_s(self, exposure_us: float) -> float:
        """Return the shortest time between two triggers at an exposure."""
        return max(1 / self.frame_rate_hz, (exposure_us + self.readout_us) * 1e-6)


class ObjectiveLimits(Spec, frozen=True, kw_only=True):
    """Optics and clearance of the objective."""

    error: ClassVar[type[WaferViewerError]] = RigError
    numerical_aperture: Positive
    wavelength_um: Positive
    magnification: Positive
    working_distance_um: Positive
    clearance_um: NonNegative
    safe_z_um: float


class RigLimits(Spec, frozen=True, kw_only=True):
    """All limits of a rig.

    pixel_um: nominal size of a pixel on the sample; count_rate_hz: greatest count rate that the pulse box follows, 0
    for no limit. It holds for passes only: a count lost in a move between them is set again from the stage.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    x: AxisLimits
    y: AxisLimits
    z: AxisLimits
    camera: CameraLimits
    objective: ObjectiveLimits
    pixel_um: Positive
    strobe_us: NonNegative = 0.0
    count_rate_hz: NonNegative = 0.0

    def axis(self, name: Axis) -> AxisLimits:
        """Return the limits of one axis."""
        return {"x": self.x, "y": self.y, "z": self.z}[name]

    def pass_speed_um_s(self, name: Axis) -> float:
        """Return the greatest speed of an axis at which the pulse box follows its scale."""
        axis = self.axis(name)
        return min(axis.speed_um_s, axis.position_um(self.count_rate_hz)) if self.count_rate_hz else axis.speed_um_s

    def lowest_z_um(self, highest_um: float | None) -> float:
        """Return the lowest z at which the objective keeps its clearance above the highest known z of the sample.

        None, nothing is known: the lowest z of the axis.
        """
        if highest_um is None:
            return self.z.low_um
        return max(self.z.low_um, highest_um - (self.objective.working_distance_um - self.objective.clearance_um))

    @property
    def field_width_um(self) -> float:
        """Width of a frame on the sample."""
        return self.camera.cols * self.pixel_um

    @property
    def field_height_um(self) -> float:
        """Height of a frame on the sample."""
        return self.camera.rows * self.pixel_um

    @property
    def depth_of_field_um(self) -> float:
        """Depth of field of the objective, in air."""
        o = self.objective
        return depth_of_field_um(o.numerical_aperture, self.pixel_um, o.wavelength_um)
