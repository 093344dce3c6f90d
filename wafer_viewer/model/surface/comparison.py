"""Comparison of two surfaces: their names, the registration and the change."""

from __future__ import annotations

from enum import IntEnum
from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.spec import Count, Fraction, NonNegative, Positive, Spec

Heights = Literal["both", "raw", "cleaned"]
"""Height layers compared: both of each surface, or one of them used as both."""
Align = Literal["auto", "images", "stage", "none"]
ALIGN_TITLES: dict[Align, str] = {
    "auto": "As it fits",
    "images": "By their images",
    "stage": "By the stage",
    "none": "Not at all",
}
FoundBy = Literal["images", "heights", "stage", "same"]
FOUND_BY: dict[FoundBy, str] = {
    "images": "by the images of both, then by their heights (ICP)",
    "heights": "by the relief of both, then by their heights (ICP)",
    "stage": "by the stage",
    "same": "not needed: both are of the same frames",
}


class SurfaceName(Spec, frozen=True, kw_only=True):
    """Location of a surface: stitched (field 0) or of a field, in a result of a dataset; or a file."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    path: str
    result: str = "default"
    field: int = 0
    heights: Heights = "both"

    @property
    def words(self) -> str:
        """Display name."""
        name = self.path.replace("\\", "/").rpartition("/")[2].removesuffix(DATASET_ENDING)
        parts = [name, *([] if self.result == "default" else [self.result])]
        parts += [f"field {self.field}"] if self.field else []
        parts += [] if self.heights == "both" else [self.heights]
        return " · ".join(parts)


class Registration(Spec, frozen=True, kw_only=True):
    """Rigid motion that registers the second surface to the first; each U is expanded (k = 2), None if unknown.

    A point of the second is rotated by turn_mrad about (about_x_um, about_y_um) and then shifted by (x_um, y_um); its
    height changes by z_um + (tilt_x_mrad (x - about x) + tilt_y_mrad (y - about y)) / 1000.
    residual_um: root mean square residual of the unchanged points; overlap_fraction: fraction of the first surface's
    measured points where the second is measured too.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    by: FoundBy = "same"
    about_x_um: float = 0.0
    about_y_um: float = 0.0
    x_um: float = 0.0
    y_um: float = 0.0
    turn_mrad: float = 0.0
    z_um: float = 0.0
    tilt_x_mrad: float = 0.0
    tilt_y_mrad: float = 0.0
    u_xy_um: NonNegative | None = None
    u_turn_mrad: NonNegative | None = None
    u_z_um: NonNegative | None = None
    u_tilt_mrad: NonNegative | None = None
    levelled: bool = False
    residual_um: NonNegative = 0.0
    overlap_fraction: Fraction = 1.0


class Change(Spec, frozen=True, kw_only=True):
    """Statistics of the difference.

    mean_um, sq_um: of all differences, sq_um about their mean; limit_um: three robust standard deviations of the
    differences; those further from the median count as changed; gained_um3, lost_um3: changed volume above and below
    the median; n_points: number of points measured in both.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    n_points: Count
    mean_um: float
    median_um: float
    sq_um: NonNegative
    lowest_um: float
    highest_um: float
    limit_um: Positive
    changed_fraction: Fraction
    gained_um3: NonNegative
    lost_um3: NonNegative


class Comparison(Spec, frozen=True, kw_only=True):
    """The second surface minus the first: names, registration and change.

    number: identifies the comparison in its dataset; 0 if it is not stored with one.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    number: int = 0
    first: SurfaceName
    second: SurfaceName
    registration: Registration
    change: Change
    simulated: bool = False
    calibrated: bool = False
    notes: tuple[str, ...] = ()


class ComparisonFace(IntEnum):
    """Displayable surfaces of a comparison."""

    DIFFERENCE = 1
    FIRST = 2
    SECOND = 3
    BESIDE = 4


FACE_TITLES: dict[ComparisonFace, tuple[str, str]] = {
    ComparisonFace.DIFFERENCE: ("Difference", "Second − first"),
    ComparisonFace.FIRST: ("First", "First surface"),
    ComparisonFace.SECOND: ("Second", "Second surface"),
    ComparisonFace.BESIDE: ("Both", "Both surfaces"),
}
"""Title of the choice of a face, and name of what it shows."""


_FACES = 10


def show_of(number: int, face: ComparisonFace) -> int:
    """Encode the displayed part of comparison `number` (from 1) as a negative number; fields have positive ones."""
    return -(_FACES * number + face)


def comparison_of(show: int) -> tuple[int, ComparisonFace] | None:
    """Decode `show` to comparison number and part; None for a field or the stitched surface."""
    return (-show // _FACES, ComparisonFace(-show % _FACES)) if show < 0 else None
