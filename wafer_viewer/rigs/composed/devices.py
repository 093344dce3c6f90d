"""Devices of a rig by role, as in the table ``[devices]`` of its file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import msgspec

from wafer_viewer.model.acquisition.calibration import UNKNOWN_OBJECTIVE, Calibration, OpticalSetup
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.positioners import ROLES, PositionerLimits, Role
from wafer_viewer.model.acquisition.rig_limits import CameraLimits, ObjectiveLimits, RigLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Positive, Spec, Within, replace
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.rigs.stages.motion_controller import AxisConfig

# ---------------------------------------------------------------------------------------------------------- positioners


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


# -------------------------------------------------------------------------------------------------------------- devices


SIMULATED = "simulated"
"""Port at whose far end a simulated device answers."""
ZOOM_DIGITS = 3
"""Decimals of a zoom factor; a calibration belongs to one of them."""
Baud = Annotated[int, Within(0, 12_000_000)]


class ControllerConfig(Spec, frozen=True, kw_only=True):
    """Motion controller, a table ``[devices.controllers.NAME]``; baud 0: as usual for its driver."""

    error: ClassVar[type[WaferViewerError]] = RigError
    driver: str
    port: str
    baud: Baud = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.driver not in CONTROLLERS:
            self.refuse("driver", f"one of {', '.join(CONTROLLERS)}")


class AxesConfig(Spec, frozen=True, kw_only=True):
    """Axes of the stage, the tables ``[devices.axes.x]``, y and z. z grows towards the objective."""

    error: ClassVar[type[WaferViewerError]] = RigError
    x: AxisConfig
    y: AxisConfig
    z: AxisConfig

    def by_name(self) -> dict[Axis, AxisConfig]:
        """Return the axes by name."""
        return {"x": self.x, "y": self.y, "z": self.z}


class PulseBoxConfig(Spec, frozen=True, kw_only=True):
    """Pulse box, the table ``[devices.pulse_box]``; strobe_us: length of the flash, 0 for steady light."""

    error: ClassVar[type[WaferViewerError]] = RigError
    port: str
    baud: Baud = 115_200
    strobe_us: NonNegative = 0.0


class CameraConfig(Spec, frozen=True, kw_only=True):
    """Camera, the table ``[devices.camera]``; options: settings of its driver."""

    error: ClassVar[type[WaferViewerError]] = RigError
    driver: str
    name: str = ""
    options: dict[str, Any] = msgspec.field(default_factory=dict)


class DevicesConfig(Spec, frozen=True, kw_only=True):
    """All devices of a rig, the table ``[devices]`` of its file.

    objective: left out where a positioner names the objectives; calibrations: one for each optical setup that is
    calibrated, beside or in place of `calibration`.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    controllers: dict[str, ControllerConfig]
    axes: AxesConfig
    pulse_box: PulseBoxConfig
    camera: CameraConfig
    objective: ObjectiveConfig | None = None
    positioners: dict[str, PositionerConfig] = msgspec.field(default_factory=dict)
    calibration: Calibration | None = None
    calibrations: tuple[Calibration, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positioners(self.positioners)
        self._require_objective()
        for place, config in self._placed.items():
            self._require_place(place, config)
        self._require_own_places()
        self._require_safe_mark()
        simulated = {port == SIMULATED for port in self.ports}
        if len(simulated) > 1:
            raise RigError(f"devices: the ports are {', '.join(self.ports)}: they must be '{SIMULATED}' all, or none.")

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of all devices on serial lines."""
        return (*(controller.port for controller in self.controllers.values()), self.pulse_box.port)

    @property
    def simulated(self) -> bool:
        """True if all ports are simulated."""
        return self.pulse_box.port == SIMULATED

    def optics(self, positions: Mapping[str, float | None]) -> ObjectiveConfig:
        """Return the objective and the zoom in the light path.

        positions: of the positioners; None where one is not homed. Between the positions of a nosepiece, and at an
        unknown zoom, the objective has no name, and its limits suit all of them.
        """
        objective = self.objective or unknown_objective(self.objectives)
        zoom: float | None = None
        for name, config in self.positioners.items():
            at = positions.get(name)
            named = "" if at is None else config.limits.name_at(at)
            if config.role == "objective":
                objective = config.objectives.get(named, objective)
            elif config.role == "zoom" and at is None:
                objective = replace(objective, name="")
            elif config.role == "zoom" and at is not None:
                zoom = config.limits.named.get(named, round(at, ZOOM_DIGITS))
        return objective if zoom is None else objective.zoomed(zoom)

    def setup(self, optics: ObjectiveConfig) -> OpticalSetup:
        """Return the optical setup with an objective and its zoom."""
        return OpticalSetup(
            objective=optics.name or UNKNOWN_OBJECTIVE,
            zoom=optics.zoom,
            camera=self.camera.name or self.camera.driver,
        )

    def calibration_of(self, setup: OpticalSetup) -> Calibration | None:
        """Return the calibration of an optical setup, None without one.

        On a rig whose optics do not change, that of another setup is returned, which says why it is not valid.
        """
        calibrations = (*self.calibrations, *(() if self.calibration is None else (self.calibration,)))
        fitting = next((one for one in calibrations if one.setup == setup), None)
        changes = any(config.role in ("objective", "zoom") for config in self.positioners.values())
        return fitting if fitting is not None or changes else self.calibration

    @property
    def objectives(self) -> tuple[ObjectiveConfig, ...]:
        """All objectives."""
        on_nosepiece = (one for config in self.positioners.values() for one in config.objectives.values())
        return (*(() if self.objective is None else (self.objective,)), *on_nosepiece)

    def axes_of(self, controller: str) -> dict[str, AxisConfig]:
        """Return the axes on a controller, those of positioners by their names."""
        axes = {**self.axes.by_name(), **{name: config.axis for name, config in self.positioners.items()}}
        return {name: config for name, config in axes.items() if config.controller == controller}

    def limits(self, camera: CameraLimits, optics: ObjectiveConfig) -> RigLimits:
        """Return the limits of the rig with a camera and an objective."""
        return RigLimits(
            x=self.axes.x.limits,
            y=self.axes.y.limits,
            z=self.axes.z.limits,
            camera=camera,
            objective=optics.limits,
            pixel_um=optics.pixel_um,
            strobe_us=self.pulse_box.strobe_us,
        )

    @property
    def _placed(self) -> dict[str, AxisConfig | PositionerConfig]:
        """All that is on a controller, by its table."""
        axes = {f"axes.{axis}": config for axis, config in self.axes.by_name().items()}
        return {**axes, **{f"positioners.{name}": config for name, config in self.positioners.items()}}

    def _require_objective(self) -> None:
        turrets = [name for name, config in self.positioners.items() if config.role == "objective"]
        if self.objective is None and not turrets:
            raise RigError(
                "devices.objective is missing: give it, or a positioner with the role 'objective' and its positions."
            )
        if self.objective is not None and turrets:
            raise RigError(
                f"devices.objective and devices.positioners.{turrets[0]} both name objectives: leave the first out."
            )

    def _require_place(self, table: str, config: AxisConfig | PositionerConfig) -> None:
        if config.controller not in self.controllers:
            raise RigError(
                f"devices.{table}.controller is '{config.controller}': it must be one of the tables in "
                f"devices.controllers: {', '.join(self.controllers)}."
            )
        driver = CONTROLLERS[self.controllers[config.controller].driver]
        if re.fullmatch(driver.address, config.address) is None:
            raise RigError(
                f"devices.{table}.address is '{config.address}': it must be {driver.address_words}, for {driver.title}."
            )

    def _require_safe_mark(self) -> None:
        index_um, z = self.axes.z.index_um, self.axes.z
        for objective in self.objectives:
            if index_um is not None and index_um >= objective.safe_z_um:
                raise RigError(
                    f"devices.axes.z.index_um is {index_um:g}: it must be below devices.objective.safe_z_um, which is "
                    f"{objective.safe_z_um:g}."
                )
            if self.positioners and objective.safe_z_um > z.high_um:
                raise RigError(
                    f"safe_z_um of the objective '{objective.name}' is {objective.safe_z_um:g}: it must be at most "
                    f"devices.axes.z.high_um, which is {z.high_um:g}, as z goes there before a positioner turns."
                )

    def _require_own_places(self) -> None:
        """Raise RigError where two axes share an address or two devices a port, or a controller has no axis."""
        placed = self._placed
        places = {table: _place(config) for table, config in placed.items()}
        for table, place in places.items():
            other = next((one for one in places if one != table and places[one] == place), None)
            if other is not None:
                of_stage = table.startswith("axes.") and other.startswith("axes.")
                both = "axes: two axes" if of_stage else f"{table} and devices.{other} both"
                raise RigError(
                    f"devices.{both} have the address '{placed[table].address}' of '{place[0]}': give each its own."
                )
        for port in self.ports:
            if port != SIMULATED and self.ports.count(port) > 1:
                raise RigError(f"devices: two devices have the port {port}: give each its own.")
        for name in self.controllers:
            if not self.axes_of(name):
                raise RigError(
                    f"devices.controllers.{name} has no axis: name it as the controller of one, or leave it out."
                )


def _place(config: AxisConfig | PositionerConfig) -> tuple[str, str]:
    """Return controller and address; the first axis of a device has the address of the device too."""
    return config.controller, config.address.removesuffix(" 1")
