"""Devices of a rig by role, as in the table ``[devices]`` of its file."""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar

import msgspec

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.rig_limits import CameraLimits, ObjectiveLimits, RigLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Positive, Spec, Within
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.rigs.stages.motion_controller import AxisConfig

SIMULATED = "simulated"
"""Port at whose far end a simulated device answers."""
AXES: tuple[Axis, ...] = ("x", "y", "z")
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


class ObjectiveConfig(ObjectiveLimits, frozen=True, kw_only=True):
    """Objective and zoom, the table ``[devices.objective]``; pixel_um: size of a camera pixel on the sample."""

    name: str
    zoom: Positive = 1.0
    pixel_um: Positive

    @property
    def limits(self) -> ObjectiveLimits:
        """Optics and clearance, for the planner."""
        return ObjectiveLimits(**{name: getattr(self, name) for name in ObjectiveLimits.__struct_fields__})


class DevicesConfig(Spec, frozen=True, kw_only=True):
    """All devices of a rig, the table ``[devices]`` of its file."""

    error: ClassVar[type[WaferViewerError]] = RigError
    controllers: dict[str, ControllerConfig]
    axes: AxesConfig
    pulse_box: PulseBoxConfig
    camera: CameraConfig
    objective: ObjectiveConfig
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for axis, config in self.axes.by_name().items():
            self._require_place(axis, config)
        self._require_own_places()
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

    @property
    def setup(self) -> OpticalSetup:
        """Optical setup."""
        return OpticalSetup(
            objective=self.objective.name, zoom=self.objective.zoom, camera=self.camera.name or self.camera.driver
        )

    def axes_of(self, controller: str) -> dict[Axis, AxisConfig]:
        """Return the axes on a controller."""
        return {axis: config for axis, config in self.axes.by_name().items() if config.controller == controller}

    def limits(self, camera: CameraLimits) -> RigLimits:
        """Return the limits of the rig with a camera."""
        return RigLimits(
            x=self.axes.x.limits,
            y=self.axes.y.limits,
            z=self.axes.z.limits,
            camera=camera,
            objective=self.objective.limits,
            pixel_um=self.objective.pixel_um,
            strobe_us=self.pulse_box.strobe_us,
        )

    def _require_place(self, axis: Axis, config: AxisConfig) -> None:
        if config.controller not in self.controllers:
            raise RigError(
                f"devices.axes.{axis}.controller is '{config.controller}': it must be one of the tables in "
                f"devices.controllers: {', '.join(self.controllers)}."
            )
        driver = CONTROLLERS[self.controllers[config.controller].driver]
        if re.fullmatch(driver.address, config.address) is None:
            raise RigError(
                f"devices.axes.{axis}.address is '{config.address}': it must be {driver.address_words}, for "
                f"{driver.title}."
            )

    def _require_own_places(self) -> None:
        """Raise RigError where two axes share an address or two devices a port, or a controller has no axis."""
        places = [(config.controller, config.address) for config in self.axes.by_name().values()]
        for place in places:
            if places.count(place) > 1:
                raise RigError(
                    f"devices.axes: two axes have the address '{place[1]}' of '{place[0]}': give each its own."
                )
        for port in self.ports:
            if port != SIMULATED and self.ports.count(port) > 1:
                raise RigError(f"devices: two devices have the port {port}: give each its own.")
        for name in self.controllers:
            if not self.axes_of(name):
                raise RigError(
                    f"devices.controllers.{name} has no axis: name it as the controller of one, or leave it out."
                )
