"""Shape features and limits that determine the class of a defect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec, Within


@dataclass(frozen=True, slots=True, kw_only=True)
class DefectShape:
    """Features of one defect candidate, as used by the class rules.

    height_um: signed, the largest difference from the reference, negative for pits; mean_height_um: mean over its area,
    0 if unknown. score: peak over the local noise. major_um, minor_um: axis lengths of its outline. roughness_ratio:
    roughness of the residual inside, after removal of its slow shape, over the local noise; near 1 is smooth.
    steepness: median slope across its outline over |height_um| / (minor_um / 2); 1 for a cone, large for a wall, 0 if
    unknown. on_edge_fraction: fraction of its border on the edge of a die. die_fraction: fraction of the die that it
    covers. die_tilt_mrad: tilt of the die's residual plane. unmeasured_fraction: fraction of its area without a height.
    height_score, picture_score: signal-to-noise in heights and in the picture; detail_score: in the fine detail of the
    picture; 0 if unknown. picture_ratio: aspect ratio of the outline in the picture, 0 if nothing shows there.
    """

    height_um: float
    mean_height_um: float = 0.0
    score: float
    area_um2: float
    major_um: float
    minor_um: float
    roughness_ratio: float = 1.0
    steepness: float = 0.0
    on_edge_fraction: float = 0.0
    die_fraction: float = 0.0
    die_tilt_mrad: float = 0.0
    unmeasured_fraction: float = 0.0
    evidence: Literal["height", "picture", "both"] = "height"
    height_score: float = 0.0
    picture_score: float = 0.0
    detail_score: float = 0.0
    picture_ratio: float = 0.0
    pixel_um: float = 1.0

    @property
    def ratio(self) -> float:
        """Length over width, 1 for a round shape, from the evidence with the higher score.

        The focus window blurs heights. Lengths under one pixel count as one pixel.
        """
        if self.picture_ratio and self.picture_score >= self.height_score:
            return self.picture_ratio
        return max(self.major_um, self.pixel_um) / max(self.minor_um, self.pixel_um)

    @property
    def aspect(self) -> float:
        """Height over width."""
        return abs(self.height_um) / max(self.minor_um, self.pixel_um)


class ClassRules(Spec, frozen=True, kw_only=True):
    """Limits between the classes of defects; a recipe may change any of them.

    unmeasured_fraction: above it there is nothing to classify. die_fraction: a candidate that covers more of its die is
    a property of the die: tilted above tilt_mrad, else missing if lower by more than missing_height_um. edge_fraction:
    an edge chip has more of its border on the edge of a die, and material missing. scratch_ratio: a scratch is longer
    than this multiple of its width, and longer than scratch_length_um (0 allows any length). residue_*: residue is
    wider than residue_width_um, lower than residue_aspect of its width, no rougher than residue_roughness, no steeper
    at its outline than residue_steepness, and its score in the fine detail of the picture is at most residue_picture
    times that in the heights: it has no sharp outline. pattern_height_score: a candidate that shows in the picture, and
    in the heights with a lower score than this, has no reliable height.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    unmeasured_fraction: Fraction = 0.5
    die_fraction: Fraction = 0.5
    missing_height_um: Positive = 1.0
    tilt_mrad: NonNegative = 3.0
    edge_fraction: Fraction = 0.03
    scratch_ratio: Annotated[float, Within(1)] = 2.5
    scratch_length_um: NonNegative = 0.0
    residue_width_um: NonNegative = 4.0
    residue_aspect: Positive = 0.25
    residue_roughness: Positive = 2.5
    residue_steepness: Positive = 2.0
    residue_picture: Positive = 0.85
    pattern_height_score: Positive = 2.0
