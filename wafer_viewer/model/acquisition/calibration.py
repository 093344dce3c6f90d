"""Calibration: pixel size and z scale with their uncertainties, and the optical settings."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import math
import re
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Count, NonNegative, Positive, Spec, encode

# ----------------------------------------------------------------------------------------------------------- flat field


Blocks = tuple[tuple[float, ...], ...]
"""Values over blocks of the image, [row][col]."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageShading:
    """Shading of every pixel, float32 [row, col]: sensitivity, 1 on average, and dark level in counts."""

    sensitivity: NDArray[np.float32]
    dark_counts: NDArray[np.float32]

    def part(self, rows: slice, cols: slice) -> ImageShading:
        """Return the pixels [rows, cols]."""
        return dataclasses.replace(
            self, sensitivity=self.sensitivity[rows, cols], dark_counts=self.dark_counts[rows, cols]
        )


class FlatField(Spec, frozen=True, kw_only=True):
    """Relative sensitivity and dark level over blocks of the image, with standard uncertainties (k = 1).

    Parameters
    ----------
    rows, cols : pixels of the image that the blocks divide evenly.
    sensitivity : counts above dark over their mean, [row][col] of the blocks.
    u_sensitivity : its standard uncertainty.
    dark_counts : counts without light.
    u_dark_counts : its standard uncertainty.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    rows: Count
    cols: Count
    sensitivity: Blocks
    u_sensitivity: Blocks
    dark_counts: Blocks
    u_dark_counts: Blocks

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = {
            (len(blocks), *{len(row) for row in blocks})
            for blocks in (self.sensitivity, self.u_sensitivity, self.dark_counts, self.u_dark_counts)
        }
        if len(shapes) != 1 or len(next(iter(shapes))) != 2 or 0 in next(iter(shapes)):
            self.refuse("sensitivity", "a table with as many rows and columns as those of the uncertainties and dark")
        if not min(value for row in self.sensitivity for value in row) > 0:
            self.refuse("sensitivity", "over 0 everywhere")

    @property
    def digest(self) -> str:
        """SHA-256 of the content, which a calibration names."""
        return hashlib.sha256(encode(self, "json").encode()).hexdigest()

    def shading(self) -> ImageShading:
        """Return the shading of every pixel, linear between the centres of the blocks and beyond the outer ones."""
        sensitivity, dark_counts = (np.asarray(blocks, np.float64) for blocks in (self.sensitivity, self.dark_counts))
        down, right = (_linear(n, of) for n, of in zip((self.rows, self.cols), sensitivity.shape, strict=True))
        return ImageShading(*((down @ blocks @ right.T).astype(np.float32) for blocks in (sensitivity, dark_counts)))


def _linear(n_pixels: int, n_blocks: int) -> NDArray[np.float64]:
    """Return the weights [pixel, block] of a linear interpolation between the centres of equal blocks."""
    if n_blocks == 1:
        return np.ones((n_pixels, 1))
    at = (np.arange(n_pixels) + 0.5) * n_blocks / n_pixels - 0.5
    lower = np.clip(np.floor(at).astype(int), 0, n_blocks - 2)
    out = np.zeros((n_pixels, n_blocks))
    pixel = np.arange(n_pixels)
    out[pixel, lower], out[pixel, lower + 1] = 1 - (at - lower), at - lower
    return out


# ---------------------------------------------------------------------------------------------------------- calibration


UNKNOWN_OBJECTIVE = "unknown"
"""Objective of a setup while a nosepiece is at none of its positions, or the zoom is not homed."""


class OpticalSetup(Spec, frozen=True, kw_only=True):
    """Optical setup of a calibration. Another objective, zoom, camera or binning needs another calibration."""

    error: ClassVar[type[WaferViewerError]] = RigError
    objective: str = ""
    zoom: Positive = 1.0
    camera: str = ""
    binning: Positive = 1


class Calibration(Spec, frozen=True, kw_only=True):
    """Pixel size and z scale with standard uncertainties (k = 1), for one optical setup.

    z_scale multiplies the counts of the stage; u_z_scale is relative. u_z_linearity_um: uncertainty of a height
    difference from the nonlinearity of the z axis; u_abbe_um: the same from the pitch of the stage; None if unknown.
    camera_rotation_rad: from the x axis of the stage to the rows of the camera, anticlockwise. u_flatness_um:
    uncertainty of a height difference within a field from the flatness deviation; u_mapping_um: uncertainty of a
    lateral length from the x-y mapping deviation; None if unknown. flat_field: digest of the flat field of the camera,
    empty without one. against: the standard used. Dates are ISO 8601 days.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    pixel_um: Positive
    u_pixel_um: NonNegative
    z_scale: Positive = 1.0
    u_z_scale: NonNegative
    u_z_linearity_um: NonNegative | None = None
    u_abbe_um: NonNegative | None = None
    u_flatness_um: NonNegative | None = None
    u_mapping_um: NonNegative | None = None
    camera_rotation_rad: float = 0.0
    u_camera_rotation_rad: NonNegative | None = None
    trigger_delay_us: NonNegative = 0.0
    u_trigger_delay_us: NonNegative | None = None
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

    @property
    def flat_field_digest(self) -> str | None:
        """Digest of the flat field, None without one."""
        return self.flat_field if _DIGEST.fullmatch(self.flat_field) else None

    def problem(self, setup: OpticalSetup, today: str) -> str | None:
        """Return why lengths are uncalibrated under this calibration, or None when it is valid."""
        if setup != self.setup:
            return f"the calibration is of {self.setup}, the rig has {setup}"
        if today > self.due:
            return f"the calibration was due on {self.due}"
        return None


PIXEL_STEP_FRACTION = 0.75
"""Distance of the fields whose borders a calibration of the pixel size compares, as a fraction of a field."""

WAVELENGTH_UM = 0.55
"""Green light, the default."""

USUAL_APERTURE, LARGEST_APERTURE = 0.28, 0.95
"""Numerical apertures in air: of the 10x objective of the paper, and of the strongest ones."""

_DIGEST = re.compile(r"[0-9a-f]{64}")
_ENGRAVED = re.compile(r"(?:\d\s*[xX×]?\s*/|\bNA:?)\s*([01]\.\d+)")


def depth_of_field_um(numerical_aperture: float, pixel_um: float, wavelength_um: float = WAVELENGTH_UM) -> float:
    """Return the depth of field, wavelength / NA^2 + pixel on the sample / NA, in um."""
    return wavelength_um / numerical_aperture**2 + pixel_um / numerical_aperture


def engraved_aperture(objective: str) -> float | None:
    """Return the numerical aperture engraved in an objective's name, as in ``10x/0.28`` or ``NA 0.28``, or None."""
    found = _ENGRAVED.search(objective)
    return float(found.group(1)) if found is not None else None


def shaded_um(height_um: float, calibration: Calibration | None) -> float:
    """Return how far from its foot a wall hides part of the aperture, in um.

    The aperture is that engraved in the objective of the calibration, 0.28 where it is unknown.
    """
    aperture = (calibration and engraved_aperture(calibration.setup.objective)) or USUAL_APERTURE
    return abs(height_um) * math.tan(math.asin(min(aperture, LARGEST_APERTURE)))
