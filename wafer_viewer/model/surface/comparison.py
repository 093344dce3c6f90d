"""Two surfaces compared: which they are, how the second was laid over the first, and what is different."""

from __future__ import annotations

from enum import IntEnum
from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import Count, Fraction, NonNegative, Positive, Spec

Heights = Literal["both", "raw", "cleaned"]
"""Of which of its two maps a surface gives heights: each of both, or one of them for both."""
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
    """Where a surface lies: the stitched one (field 0) or a field's, of a result of a dataset; or a file's."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    path: str
    result: str = "default"
    field: int = 0
    heights: Heights = "both"

    @property
    def words(self) -> str:
        """How people call it."""
        name = self.path.replace("\\", "/").rpartition("/")[2].removesuffix(".wafer")
        parts = [name, *([] if self.result == "default" else [self.result])]
        parts += [f"field {self.field}"] if self.field else []
        parts += [] if self.heights == "both" else [self.heights]
        return " · ".join(parts)


class Registration(Spec, frozen=True, kw_only=True):
    """The rigid motion that lays the second surface over the first; each U is expanded (k = 2), None where not known.

    A place of the second is turned by turn_mrad about (about_x_um, about_y_um) and then shifted by (x_um, y_um); its
    height is changed by z_um + (tilt_x_mrad (x - about x) + tilt_y_mrad (y - about y)) / 1000.
    residual_um: root mean square of what is left, without what has changed; overlap_fraction: of the first's measured
    places, those at which the second is measured as well.
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

    @property
    def moves_places(self) -> bool:
        """Whether places of the second lie elsewhere on the first."""
        return bool(self.x_um or self.y_um or self.turn_mrad)


class Change(Spec, frozen=True, kw_only=True):
    """What is different, in numbers.

    mean_um, sq_um: of all differences, sq_um about their mean; limit_um: three robust deviations of the differences:
    what lies further from their median counts as changed; gained_um3, lost_um3: volume of what has changed, above and
    below the median; n_points: places at which both are measured.
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
    """The second surface minus the first: which they are, how they were aligned, and what is different.

    number: by which it is told from the other comparisons of its dataset; 0 where it is not kept with one.
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
    """What of a comparison can be looked at."""

    DIFFERENCE = 1
    FIRST = 2
    SECOND = 3
    BESIDE = 4


_FACES = 10


def show_of(number: int, face: ComparisonFace) -> int:
    """What of a comparison, numbered from 1, is shown, as one number below 0: fields have theirs above 0."""
    return -(_FACES * number + face)


def comparison_of(show: int) -> tuple[int, ComparisonFace] | None:
    """The number of the comparison and what of it is shown; None where `show` is a field or the stitched surface."""
    return (-show // _FACES, ComparisonFace(-show % _FACES)) if show < 0 else None
