"""What makes a length a length: pixel size and z scale with their uncertainty, and what they hold for."""

from __future__ import annotations

import datetime
from typing import ClassVar

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Positive, Spec


class OpticalSetup(Spec, frozen=True, kw_only=True):
    """What a calibration is of: another objective, zoom, camera or binning needs another calibration."""

    error: ClassVar[type[WaferViewerError]] = RigError
    objective: str = ""
    zoom: Positive = 1.0
    camera: str = ""
    binning: Positive = 1


class Calibration(Spec, frozen=True, kw_only=True):
    """Pixel size and z scale with standard uncertainties (k = 1), of an optical setup, made against a standard.

    z_scale multiplies the counts of the stage; u_z_scale is relative. u_z_linearity_um: of a difference of heights,
    beside the scale; u_abbe_um: the same from the pitch of the stage; None: not known. Dates are ISO 8601 days.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    pixel_um: Positive
    u_pixel_um: NonNegative
    z_scale: Positive = 1.0
    u_z_scale: NonNegative
    u_z_linearity_um: NonNegative | None = None
    u_abbe_um: NonNegative | None = None
    camera_rotation_rad: float = 0.0
    trigger_delay_us: NonNegative = 0.0
    flat_field: str = ""
    setup: OpticalSetup = OpticalSetup()
    made: str
    due: str
    against: str
    z_against: tuple[str, ...] = ()
    simulated: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("made", "due"):
            try:
                datetime.date.fromisoformat(getattr(self, name))
            except ValueError:
                self.refuse(name, "a day such as 2026-03-14")

    def problem(self, setup: OpticalSetup, today: str) -> str | None:
        """Why lengths read 'uncalibrated' with this calibration, or None when it holds."""
        if setup != self.setup:
            return f"the calibration is of {self.setup}, the rig has {setup}"
        if today > self.due:
            return f"the calibration was due on {self.due}"
        return None
