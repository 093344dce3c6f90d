"""Table of the drivers of motion controllers: a driver is entered here, and nowhere else."""

from __future__ import annotations

from wafer_viewer.rigs.stages import grbl, pi_gcs2, zaber
from wafer_viewer.rigs.stages.motion_controller import ControllerDriver

CONTROLLERS: dict[str, ControllerDriver] = {row.name: row for row in (zaber.DRIVER, grbl.DRIVER, pi_gcs2.DRIVER)}
