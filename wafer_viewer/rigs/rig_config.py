"""Rig configuration: a small TOML file, and the table of available rigs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Spec, Within, decode
from wafer_viewer.rigs.virtual.faults import Faults


class RigConfig(Spec, frozen=True, kw_only=True):
    """Configuration of a rig in FILE.toml; the default is the virtual wafer with a small camera.

    faults: simulated faults of the virtual rig, to test the scan's response.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    kind: str = "virtual"
    name: str = "Virtual rig"
    scene: str = "wafer"
    size: Literal["small", "full"] = "small"
    real_time: bool = False
    seed: Annotated[int, Within(0, 2**31)] = 0
    faults: Faults = Faults()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in RIGS:
            self.refuse("kind", f"one of {', '.join(RIGS)}")


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
    )


RIGS: dict[str, Callable[[RigConfig], Rig]] = {"virtual": open_virtual}


def read_config(path: Path) -> RigConfig:
    """Read the configuration from a TOML file. Raises RigError when it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as fault:
        raise RigError(
            f"The rig's file {path} cannot be read ({fault}): check its name and that it is text."
        ) from fault
    return decode(text, RigConfig, path.name)


def open_rig(config: RigConfig) -> Rig:
    """Open a rig. Raises RigError when it is not available."""
    return RIGS[config.kind](config)
