"""What the class of a defect is decided by: its shape, and the limits between the classes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec, Within


@dataclass(frozen=True, slots=True, kw_only=True)
class DefectShape:
    """The features of one place that differs from its reference, as the rules ask for them.

    height_um: signed, the largest difference from the reference; pits negative; mean_height_um: over its area, 0 where
    it is not known. score: the peak over the local noise. major_um, minor_um: lengths of the axes of its outline.
    roughness_ratio: roughness of the residual inside, its own slow shape taken off, over the local noise; near 1 is
    smooth. steepness: the median slope across its outline over |height_um| / (minor_um / 2), 1 for a cone, large for a
    wall; 0 where it is not known. on_edge_fraction: share of its border on a die's edge. die_fraction: share of the
    die's area that it covers. die_tilt_mrad: tilt of the die's residual plane. unmeasured_fraction: share of its area
    without a height. height_score, picture_score: how far it stands out of the noise in each, detail_score: in what is
    fine of the picture; 0 where not known. picture_ratio: length over width of what shows in the picture, 0 of nothing.
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
        """Length over width, 1 for what is round, in the evidence that shows it more clearly: the focus window blurs
        heights. What is narrower than a pixel counts as a pixel wide.
        """
        if self.picture_ratio and self.picture_score >= self.height_score:
            return self.picture_ratio
        return max(self.major_um, self.pixel_um) / max(self.minor_um, self.pixel_um)

    @property
    def aspect(self) -> float:
        """Height over width: how upright it stands."""
        return abs(self.height_um) / max(self.minor_um, self.pixel_um)


class ClassRules(Spec, frozen=True, kw_only=True):
    """The limits between the classes of defects; a recipe may change any of them.

    unmeasured_fraction: with more of its area unmeasured there is nothing to classify. die_fraction: what covers more
    of its die is the die's own: tilted beyond tilt_mrad, else missing where it lies lower by more than
    missing_height_um.
    edge_fraction: with more of its border on a die's edge and material lacking, an edge chip. scratch_ratio: longer
    than so many widths, and than scratch_length_um; 0 is any length. residue_*: smooth and wide is wider than
    residue_width_um, lower than residue_aspect of its width, no rougher than residue_roughness, no steeper at its
    outline than residue_steepness, and what is fine in the picture shows it at most residue_picture times as clearly as
    the heights do: it has no sharp outline. What shows in the picture only, and in the heights by less than
    pattern_height_score, has no height to go by.
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
