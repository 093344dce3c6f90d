"""Stages to hold the role against: the virtual one, and each driver on a simulated controller."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import pytest

from wafer_viewer.model.acquisition.devices import Clock, Stage
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.rigs.stages.controller_stage import ControllerStage
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.rigs.stages.motion_controller import AxisConfig, ControllerAxis
from wafer_viewer.rigs.stages.simulated.axis import SimulatedController
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.rigs.virtual.serial_port import VirtualPort
from wafer_viewer.rigs.virtual.stage import VirtualStage, standing

MICROSTEPS_PER_UM = 20.997375
UNITS_PER_UM = {"zaber": MICROSTEPS_PER_UM, "grbl": 0.001, "pi_gcs2": 0.001}
ADDRESSES = {"zaber": ("1", "2 1", "2 2"), "grbl": ("X", "Y", "Z"), "pi_gcs2": ("1", "2", "3")}
POWER_UP_UM = {"x": 1_234.0, "y": 4_321.0, "z": 567.0}
"""Where a stage stands when it is switched on: from the middle of its travel on PI's, else from its low end."""
DRIVERS = {name: dict.fromkeys("xyz", name) for name in CONTROLLERS}
DRIVERS["zaber and pi_gcs2"] = {"x": "zaber", "y": "zaber", "z": "pi_gcs2"}


@dataclass
class Cable:
    """Implementation of SerialPort between a driver and a simulated controller, with faults."""

    port: VirtualPort
    timeout: float | None = None
    written: bytes = b""
    deaf: bool = False
    unplugged: bool = False
    ahead: list[bytes] = field(default_factory=list)
    """What arrives before the answers to the next writings."""

    @property
    def in_waiting(self) -> int:
        self._check()
        return self.port.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        self._check()
        self.port.timeout = self.timeout
        return self.port.read(size)

    def write(self, data: bytes, /) -> int:
        self._check()
        self.written += data
        if self.ahead:
            self.port.deliver(self.ahead.pop(0), self.port._clock.now_s() - 0.001)
        return len(data) if self.deaf else self.port.write(data)

    def close(self) -> None:
        self._check()
        self.port.close()

    def _check(self) -> None:
        if self.unplugged:
            raise OSError(5, "Input/output error")


@dataclass
class Bench:
    """A stage with what moves it."""

    stage: Stage
    clock: Clock
    limits: RigLimits
    true_stage: VirtualStage
    axes: dict[Axis, AxisConfig] = field(default_factory=dict)
    cables: dict[str, Cable] = field(default_factory=dict)
    controllers: dict[str, SimulatedController] = field(default_factory=dict)


def axis_config(driver: str, axis: str, limits: RigLimits, **changes) -> AxisConfig:
    """The axis of a limit on a controller; every second one counts the other way, and zero lies somewhere."""
    plain = {
        **msgspec.structs.asdict(limits.axis(axis)),
        "controller": driver,
        "address": ADDRESSES[driver]["xyz".index(axis)],
        "units_per_um": UNITS_PER_UM[driver] * (-1 if axis == "y" else 1),
        "zero_units": 12.0,
    }
    return AxisConfig(**{**plain, **changes})


def small_limits() -> RigLimits:
    """The virtual limits with a shorter way, so that a search ends soon."""
    limits = virtual_limits(16, 24)
    way = {"low_um": -40_000.0, "high_um": 40_000.0}
    return msgspec.structs.replace(limits, **{x: msgspec.structs.replace(limits.axis(x), **way) for x in ("x", "y")})


def switch_on(drivers: dict[str, str], *, homed: bool = True, limits: RigLimits | None = None, **changes) -> Bench:
    """A stage of simulated controllers; `changes` go into the axes of the rig's file, not into the controllers."""
    clock, limits = VirtualClock(), limits or small_limits()
    true_stage = VirtualStage(clock, limits)
    for axis, um in POWER_UP_UM.items():
        low_um = 0.0 if drivers[axis] == "pi_gcs2" else limits.axis(axis).low_um
        true_stage.axes[axis].profile = standing(low_um + um)
    true_axes = {axis: axis_config(drivers[axis], axis, limits) for axis in drivers}
    axes = {axis: axis_config(drivers[axis], axis, limits, **changes) for axis in drivers}
    bench = Bench(None, clock, limits, true_stage, axes)
    opened = {}
    for name in sorted(set(drivers.values())):
        its = {axis: true_axes[axis] for axis in drivers if drivers[axis] == name}
        simulated = bench.controllers[name] = CONTROLLERS[name].simulate(clock, true_stage, its)
        port = VirtualPort(clock, simulated)
        simulated.connect(port.deliver)
        cable = bench.cables[name] = Cable(port)
        opened[name] = CONTROLLERS[name].connect(cable, clock, {axis: ControllerAxis.of(axes[axis]) for axis in its})
    bench.stage = ControllerStage(opened, axes, clock)
    if homed:
        bench.stage.move_to(x_um=0.0, y_um=0.0, z_um=0.0)
    return bench


def virtual(*, real_time: bool = False) -> Bench:
    clock, limits = VirtualClock(real_time=real_time), small_limits()
    stage = VirtualStage(clock, limits)
    return Bench(stage, clock, limits, stage)


BENCHES = {
    "virtual": virtual,
    "virtual, real time": lambda: virtual(real_time=True),
    **{name: lambda drivers=drivers: switch_on(drivers) for name, drivers in DRIVERS.items()},
}


@pytest.fixture(params=BENCHES)
def rig(request) -> Bench:
    """Every kind of stage in turn, homed and at zero."""
    return BENCHES[request.param]()


@pytest.fixture(params=DRIVERS)
def bench(request) -> Bench:
    """Every driver in turn, homed and at zero."""
    return switch_on(DRIVERS[request.param])


@pytest.fixture(params=DRIVERS)
def cold(request) -> Bench:
    """Every driver in turn, just switched on."""
    return switch_on(DRIVERS[request.param], homed=False)
