"""Objectives and positioners of a rig, as in the tables ``[devices.positioners.NAME]`` of its file."""

from __future__ import annotations

import re
from typing import ClassVar

import msgspec

from wafer_viewer.model.acquisition.positioners import ROLES, PositionerLimits, Role
from wafer_viewer.model.acquisition.rig_limits import ObjectiveLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Positive, Spec, replace
from wafer_viewer.rigs.stages.motion_controller import AxisConfig

NAME = re.compile("[a-z][a-z0-9_]*")
TAKEN = ("x", "y", "z")
"""Names of the axes of the stage."""


class ObjectiveConfig(ObjectiveLimits, frozen=True, kw_only=True):
    """Objective: the table ``[devices.objective]``, or the one of a named position of a nosepiece.

    pixel_um: size of a camera pixel on the sample at the given zoom.
    """

    name: str
    zoom: Positive = 1.0
    pixel_um: Positive

    @property
    def limits(self) -> ObjectiveLimits:
        """Optics and clearance, for the planner."""
        return ObjectiveLimits(**{name: getattr(self, name) for name in ObjectiveLimits.__struct_fields__})

    def zoomed(self, zoom: float) -> ObjectiveConfig:
        """Return the objective at another zoom, which changes magnification and pixel size."""
        if zoom == self.zoom:
            return self
        factor = zoom / self.zoom
        return replace(self, zoom=zoom, pixel_um=self.pixel_um / factor, magnification=self.magnification * factor)


class NamedPosition(Spec, frozen=True, kw_only=True):
    """Named position of a positioner, a table ``[devices.positioners.NAME.positions.POSITION]``.

    at: position in the unit of the role; objective: the one that is in the light path there, on a nosepiece.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    at: float
    objective: ObjectiveConfig | None = None


class PositionerConfig(Spec, frozen=True, kw_only=True):
    """Positioner: its role, range, and place on a controller. A table ``[devices.positioners.NAME]``.

    Parameters
    ----------
    role : light, objective, zoom, tilt_a, tilt_b or rotation. It settles the unit of all positions: % for the light,
        x for the zoom, deg for the others.
    controller, address : as of an axis of the stage.
    units_per_unit : units of the controller in one unit of the role; negative where the controller counts the other
        way.
    zero_units : position of the controller at 0.
    low, high : range in which it may move.
    speed, acceleration : in units/s and units/s^2 of the role.
    settle_s : time after a motion until it stands still.
    positions : named positions; an objective has no others.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    role: Role
    controller: str
    address: str
    units_per_unit: float
    zero_units: float = 0.0
    low: float
    high: float
    speed: Positive
    acceleration: Positive
    settle_s: NonNegative = 0.1
    positions: dict[str, NamedPosition] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        role = ROLES[self.role]
        if self.units_per_unit == 0:
            self.refuse("units_per_unit", "over 0, or below 0 where the controller counts the other way")
        if self.high <= self.low:
            self.refuse("high", f"over low, which is {self.low:g}")
        if role.lowest is not None and self.low < role.lowest:
            self.refuse("low", f"at least {role.lowest:g} {role.unit} for the role '{self.role}'")
        if role.highest is not None and self.high > role.highest:
            self.refuse("high", f"at most {role.highest:g} {role.unit} for the role '{self.role}'")
        if role.only_named and not self.positions:
            self.refuse("positions", f"given for the role '{self.role}', one table for each objective")
        for name, position in self.positions.items():
            if not self.low <= position.at <= self.high:
                raise RigError(
                    f"positions.{name}.at is {position.at:g}: it must be between {self.low:g} and {self.high:g}."
                )
            if (position.objective is None) == (self.role == "objective"):
                wanted = "given for" if position.objective is None else "left out but for"
                raise RigError(f"positions.{name}.objective must be {wanted} the role 'objective'.")

    @property
    def axis(self) -> AxisConfig:
        """Axis on the controller, with the unit of the role in place of um."""
        return AxisConfig(
            controller=self.controller,
            address=self.address,
            units_per_um=self.units_per_unit,
            zero_units=self.zero_units,
            low_um=self.low,
            high_um=self.high,
            speed_um_s=self.speed,
            acceleration_um_s2=self.acceleration,
            settle_s=self.settle_s,
            counts_per_um=1.0,
        )

    @property
    def objectives(self) -> dict[str, ObjectiveConfig]:
        """Objectives by the names of their positions."""
        return {name: one.objective for name, one in self.positions.items() if one.objective is not None}

    @property
    def limits(self) -> PositionerLimits:
        """Role, range and named positions; a nosepiece turns above the safe z of all its objectives."""
        return PositionerLimits(
            role=self.role,
            low=self.low,
            high=self.high,
            named={name: position.at for name, position in self.positions.items()},
            lift_z_um=max((one.safe_z_um for one in self.objectives.values()), default=None),
        )


def require_positioners(positioners: dict[str, PositionerConfig]) -> None:
    """Raise RigError for a name that an axis has or that is no word, and for two positioners of one role.

    There may be several lights.
    """
    for name, config in positioners.items():
        if NAME.fullmatch(name) is None or name in TAKEN:
            raise RigError(
                f"devices.positioners.{name}: the name must be lower-case letters, digits and _, and not x, y or z."
            )
        others = [other for other, its in positioners.items() if its.role == config.role != "light" and other != name]
        if others:
            raise RigError(
                f"devices.positioners: {name} and {others[0]} both have the role '{config.role}': give it to one."
            )


def unknown_objective(objectives: tuple[ObjectiveConfig, ...]) -> ObjectiveConfig:
    """Return the limits that suit each of several objectives, for a nosepiece that is at none of its positions."""
    nearest = min(objectives, key=lambda one: one.working_distance_um - one.clearance_um)
    return replace(nearest, name="", safe_z_um=max(one.safe_z_um for one in objectives))
