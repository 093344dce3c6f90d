"""Rig configuration: a small TOML file, and the table of available rigs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import MOST_TOML_BYTES, Spec, Within, decode
from wafer_viewer.rigs.composed.devices import DevicesConfig
from wafer_viewer.rigs.virtual.faults import CalibrationErrors, Faults

if TYPE_CHECKING:
    from wafer_viewer.rigs.composed.rig import DeviceOpener


class RigConfig(Spec, frozen=True, kw_only=True):
    """Configuration of a rig in FILE.toml; the default is the virtual wafer with a small camera.

    scene, size, faults: of the virtual rig, with simulated faults to test the scan's response; calibration_errors: of
    the virtual rig, hidden, for calibrations to find; devices: by role, of a composed rig; real_time: time of simulated
    devices follows the wall clock; seed: of the camera noise and the scale errors of simulated devices, so that a scan
    can be reproduced. Without it the noise differs in every scan.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    kind: str = "virtual"
    name: str = "Virtual rig"
    scene: str = "wafer"
    size: Literal["small", "full"] = "small"
    real_time: bool = False
    seed: Annotated[int, Within(0, 2**31)] | None = None
    faults: Faults = Faults()
    calibration_errors: CalibrationErrors = CalibrationErrors()
    devices: DevicesConfig | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in RIGS:
            self.refuse("kind", f"one of {', '.join(RIGS)}")
        if (self.devices is not None) != (self.kind == "composed"):
            raise RigError("RigConfig.devices is for kind 'composed', which needs it: give both, or leave both out.")


def open_virtual(config: RigConfig) -> Rig:
    """Open the simulated rig."""
    from wafer_viewer.rigs.virtual.rig import VirtualRig

    return VirtualRig(
        config.scene,
        config.size,
        name=config.name,
        real_time=config.real_time,
        seed=config.seed,
        faults=config.faults,
        errors=config.calibration_errors,
    )


def device_opener(config: RigConfig) -> DeviceOpener | None:
    """Return the opener of the devices of a composed rig, None for other kinds."""
    from wafer_viewer.rigs.composed.rig import DeviceOpener

    return config.devices and DeviceOpener(config.name, config.devices, real_time=config.real_time, seed=config.seed)


def open_composed(config: RigConfig) -> Rig:
    """Open the rig of the devices that its file names."""
    from wafer_viewer.rigs.composed.rig import ComposedRig

    opener = device_opener(config)
    if opener is None:
        raise RigError("RigConfig.devices is missing: a composed rig needs it.")
    return ComposedRig(opener)


RIGS: dict[str, Callable[[RigConfig], Rig]] = {"virtual": open_virtual, "composed": open_composed}


def read_config(path: Path) -> RigConfig:
    """Read the configuration from a TOML file. Raises RigError when it cannot be read."""
    try:
        with path.open("rb") as file:
            text = file.read(MOST_TOML_BYTES + 1)
    except OSError as fault:
        raise RigError(
            f"The rig's file {path} cannot be read ({fault}): check its name and that it is text."
        ) from fault
    return decode(text, RigConfig, path.name)


def open_rig(config: RigConfig) -> Rig:
    """Open a rig. Raises RigError when it is not available."""
    return RIGS[config.kind](config)
