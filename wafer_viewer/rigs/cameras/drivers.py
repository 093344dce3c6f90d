"""Table of the camera drivers, one descriptor each, by the name in a rig file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.cameras import aravis, gentl, micro_manager
from wafer_viewer.rigs.cameras.base import CameraOptions, ConnectedCamera


@dataclass(frozen=True, slots=True)
class CameraDriver:
    """Driver of a family of cameras.

    open: connects to a camera with `options`, or raises RigError; require: raises RigError unless everything is
    installed; mend: command that installs it.
    """

    name: str
    title: str
    options: type[CameraOptions]
    open: Callable[[Any], ConnectedCamera]
    require: Callable[[], object]
    mend: str

    @property
    def missing(self) -> str:
        """Reason why the driver cannot be used on this computer; empty if it can."""
        try:
            self.require()
        except RigError as fault:
            return str(fault)
        return ""

    def connect(self, settings: Mapping[str, Any]) -> ConnectedCamera:
        """Connect to a camera by its settings in a rig file. Raises RigError where they are wrong or it refuses."""
        try:
            options = msgspec.convert(settings, self.options)
        except msgspec.ValidationError as fault:
            raise RigError(
                f"The settings of the {self.name} camera are wrong ({fault}): correct the rig file."
            ) from fault
        return self.open(options)


CAMERAS: dict[str, CameraDriver] = {
    driver.name: driver
    for driver in (
        CameraDriver(
            name="aravis",
            title="GigE Vision and USB3 Vision, by Aravis",
            options=aravis.AravisOptions,
            open=aravis.AravisCamera,
            require=aravis.import_aravis,
            mend=aravis.MEND,
        ),
        CameraDriver(
            name="micro_manager",
            title="Micro-Manager device adapter",
            options=micro_manager.MicroManagerOptions,
            open=micro_manager.MicroManagerCamera,
            require=micro_manager.import_core,
            mend=micro_manager.MEND,
        ),
        CameraDriver(
            name="gentl",
            title="GenTL producer of the camera's maker, by Harvesters",
            options=gentl.GenTLOptions,
            open=gentl.GenTLCamera,
            require=gentl.import_harvesters,
            mend=gentl.MEND,
        ),
    )
}
