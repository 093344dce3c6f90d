"""Camera frames and the focus stack of a field."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import Calibration, ImageShading, depth_of_field_um, engraved_aperture
from wafer_viewer.model.acquisition.plan import MIN_FRAMES, Field, Shot
from wafer_viewer.model.errors import DatasetError

Image = NDArray[np.uint8] | NDArray[np.uint16]


class FrameStatus(Enum):
    """Status of the frame of one pulse."""

    OK = "ok"
    INCOMPLETE = "incomplete"
    MISSING = "missing"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image with its shot, the pulse that triggered it and the stage position at mid-exposure.

    image: uint8 or uint16 [row, col]; None when the frame is missing.
    """

    shot: Shot
    pulse_count: int
    x_um: float
    y_um: float
    z_um: float
    exposure_us: float
    device_time_us: int
    status: FrameStatus
    image: Image | None


@dataclass(frozen=True, slots=True, eq=False)
class Bracket:
    """A further exposure of a stack's slots: images and present as there; exposure_us is NaN if unknown."""

    images: Image
    present: NDArray[np.bool_]
    exposure_us: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class FieldStack:
    """The focus stack of one field.

    images: [k, row, col], uint8 or uint16, may be memory-mapped; z_um: float64 [k], rising;
    present: bool [k], False for a missing frame (an empty slot is not a black frame);
    brackets: further exposures of the same slots, in any order: a reconstruction fuses them with `images`;
    exposure_z_um: z [k] of each exposure's own images, `images` first, where they differ from z_um; else empty;
    depth_of_field_um: of the objective; 0 if unknown;
    shading: of the camera, None without a flat field; the images are as the camera gave them;
    notes: one sentence each on what was found in the files of a stack that was taken elsewhere;
    positions_assumed: the position of the field was made up by an import, from an assumed overlap.

    Raises DatasetError when the shapes disagree or fewer than three frames are present.
    """

    field: Field
    images: Image
    z_um: NDArray[np.float64]
    present: NDArray[np.bool_]
    pixel_um: float
    calibration: Calibration | None = None
    simulated: bool = False
    checksum: str = ""
    source: str = ""
    exposure_us: float = np.nan
    brackets: tuple[Bracket, ...] = ()
    depth_of_field_um: float = 0.0
    exposure_z_um: tuple[NDArray[np.float64], ...] = ()
    shading: ImageShading | None = None
    notes: tuple[str, ...] = ()
    positions_assumed: bool = False

    def __post_init__(self) -> None:
        if self.images.ndim != 3 or len(self.z_um) != len(self.images) or len(self.present) != len(self.images):
            raise DatasetError(
                f"The stack of field {self.field.number} has images of shape {self.images.shape}, "
                f"{len(self.z_um)} z values and {len(self.present)} flags: all three need the same number of frames."
            )
        if int(np.count_nonzero(self.present)) < MIN_FRAMES:
            raise DatasetError(
                f"The stack of field {self.field.number} has {int(np.count_nonzero(self.present))} frames: "
                f"at least {MIN_FRAMES} are needed to find a focus peak."
            )
        for other in self.brackets:
            self._require_alike(other)

    @property
    def n_frames(self) -> int:
        """Number of slots, present or not."""
        return len(self.images)

    @property
    def exposures(self) -> tuple[Bracket, ...]:
        """All exposures of the slots, `images` first."""
        return (Bracket(self.images, self.present, self.exposure_us), *self.brackets)

    @property
    def z_step_um(self) -> float:
        """Mean distance between neighbouring frames."""
        return float(np.abs(self.z_um[-1] - self.z_um[0])) / max(1, len(self.z_um) - 1)

    @property
    def optical_depth_um(self) -> float:
        """Depth of field as planned, else of the objective that the calibration names; 0 if unknown."""
        setup = self.calibration.setup if self.calibration is not None else None
        aperture = engraved_aperture(setup.objective) if setup is not None else None
        if self.depth_of_field_um > 0 or aperture is None:
            return self.depth_of_field_um
        return depth_of_field_um(aperture, self.pixel_um)

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of pixel (0, 0)."""
        return self.field.x_um - (self.images.shape[2] - 1) / 2 * self.pixel_um

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of pixel (0, 0)."""
        return self.field.y_um + (self.images.shape[1] - 1) / 2 * self.pixel_um

    def part(self, rows: slice, cols: slice) -> FieldStack:
        """Return the stack restricted to the pixels [rows, cols], as views; the field keeps its position."""
        brackets = tuple(dataclasses.replace(b, images=b.images[:, rows, cols]) for b in self.brackets)
        shading = None if self.shading is None else self.shading.part(rows, cols)
        return dataclasses.replace(self, images=self.images[:, rows, cols], brackets=brackets, shading=shading)

    def _require_alike(self, other: Bracket) -> None:
        if other.images.shape != self.images.shape or other.images.dtype != self.images.dtype:
            raise DatasetError(
                f"The exposures of field {self.field.number} have images of shape {self.images.shape} and "
                f"{other.images.shape}, of {self.images.dtype} and {other.images.dtype}: they must be alike."
            )
