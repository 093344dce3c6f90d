"""Defects of a patterned wafer: what they are, how they are looked for, and what one inspection found."""

from __future__ import annotations

import itertools
import math
from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.class_rules import ClassRules
from wafer_viewer.model.inspection.defect_limits import DefectLimits
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Count, Fraction, NonNegative, Spec

DefectClass = Literal[
    "particle", "pit", "scratch", "residue", "missing die", "tilted die", "edge chip", "unmeasured", "pattern"
]
Evidence = Literal["height", "picture", "both"]
Judgement = Literal["open", "real", "nuisance"]
Reference = Literal["dies", "golden", "form"]
RESOLVED_FROM_PX = 20.0
"""Smaller defects are detected, but their size is not resolved."""
DULLEST_SIGMA, KEENEST_SIGMA = 8.0, 2.0


class DefectRecipe(Spec, frozen=True, kw_only=True):
    """How defects are looked for; recipes are saved by product.

    sensitivity: the one dial, 0 finds only clear defects, 1 everything that may be one; scales_px: standard deviations
    of the Gaussian filters through which heights are looked at, 0 is unfiltered, and of what is wide and faint in the
    picture, in which discs of 4 to 14 px are sought besides; golden: name of the stored golden die to compare with,
    none: the median of the dies of the wafer itself; form_order: of the polynomial that is taken off first; excluded:
    areas of every die where nothing is sought, um from its lower left corner; limits: how many of them a die and a
    wafer may have.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str = "standard"
    product: str = ""
    sensitivity: Fraction = 0.4
    scales_px: tuple[NonNegative, ...] = (0.0, 1.5, 4.0, 10.0)
    min_area_px: Count = 4
    evidence: Evidence = "both"
    golden: str = ""
    form_order: Literal[1, 2] = 2
    excluded: tuple[Region, ...] = ()
    rules: ClassRules = ClassRules()
    limits: DefectLimits = DefectLimits()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.scales_px or max(self.scales_px) > 40:
            self.refuse("scales_px", "at least one scale, each at most 40 px")
        if not all(region.area_um2 > 0 for region in self.excluded):
            self.refuse(
                "excluded", "rectangles, circles or polygons: lines, points and what has no area leave nothing out"
            )

    @property
    def threshold_sigma(self) -> float:
        """How far over the local noise a defect's peak must lie."""
        return threshold_of(self.sensitivity)


def threshold_of(sensitivity: float) -> float:
    """The dial in sigma: 8 at 0, 5 in the middle, 2 at 1."""
    return DULLEST_SIGMA + sensitivity * (KEENEST_SIGMA - DULLEST_SIGMA)


def sensitivity_of(threshold_sigma: float) -> float:
    """Where the dial stands for a threshold, within its ends."""
    return min(1.0, max(0.0, (DULLEST_SIGMA - threshold_sigma) / (DULLEST_SIGMA - KEENEST_SIGMA)))


class Defect(MeasurementResult, frozen=True, kw_only=True, tag="defect"):
    """A place that differs from its reference: where, how large, of what class and why, how it was judged.

    center and outline in stage um; die: "col,row", empty outside of dies; in_die: um from the die's lower left corner;
    height: the peak over (pits: under, negative) the reference, mean_height_um over its area; score: peak signal over
    the local noise; scale_px: of the filter that showed it best, of a disc its diameter; size_resolved: False under
    20 px, "detected, size not resolved". judged_kind: the operator's word, which overrides `kind`, judged_at its time
    (ISO 8601).
    """

    center: Point
    outline: Region
    kind: DefectClass
    die: str = ""
    in_die: Point | None = None
    reasons: tuple[str, ...] = ()
    major: Length
    minor: Length
    angle_deg: float = 0.0
    height: Length
    mean_height_um: float = 0.0
    area: Quantity
    volume: Quantity
    score: float
    confidence: Fraction = 0.0
    scale_px: NonNegative = 0.0
    evidence: Evidence = "height"
    size_resolved: bool = True
    repeats: bool = False
    judgement: Judgement = "open"
    judged_kind: DefectClass | None = None
    note: str = ""
    judged_by: str = ""
    judged_at: str = ""

    @property
    def main(self) -> Quantity:
        """The height."""
        return self.height.quantity

    @property
    def seen_as(self) -> DefectClass:
        """The class that counts: the operator's where there is one."""
        return self.judged_kind or self.kind


class FalseCounts(Spec, frozen=True, kw_only=True):
    """How many false defects per mm2 are to be expected, by threshold: from the data, for every setting of the dial.

    threshold_sigma rises; per_mm2 belongs to it, point by point.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    threshold_sigma: tuple[float, ...] = ()
    per_mm2: tuple[NonNegative, ...] = ()

    def at(self, threshold_sigma: float) -> float | None:
        """By straight lines of the logarithm between the points; None where the data said nothing."""
        if not self.threshold_sigma:
            return None
        points = list(zip(self.threshold_sigma, self.per_mm2, strict=True))
        if threshold_sigma <= points[0][0]:
            return points[0][1]
        for (a, low), (b, high) in itertools.pairwise(points):
            if threshold_sigma <= b:
                part = (threshold_sigma - a) / (b - a)
                return math.exp((1 - part) * math.log(max(low, 1e-9)) + part * math.log(max(high, 1e-9)))
        return points[-1][1]


class Inspection(Spec, frozen=True, kw_only=True):
    """What one inspection looked at and found: the file ``results/NAME/defects.json``.

    reference: what the surface was compared with; inspected_mm2: measured and compared, where a list without defects
    means that there are none; unmeasured_mm2: where nothing can be said; not_scanned_mm2: of the surface's rectangle,
    without dies, whose states say it. A die that is not or only partly scanned is
    never clean.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    recipe: DefectRecipe = DefectRecipe()
    reference: Reference = "form"
    grid: DieGrid | None = None
    dies: tuple[DieStatus, ...] = ()
    defects: tuple[Defect, ...] = ()
    inspected_mm2: NonNegative = 0.0
    unmeasured_mm2: NonNegative = 0.0
    not_scanned_mm2: NonNegative = 0.0
    threshold_sigma: NonNegative = 5.0
    expected_false_per_mm2: NonNegative | None = None
    false_counts: FalseCounts = FalseCounts()
    surface: Literal["unsmoothed", "smoothed", "filled"] = "unsmoothed"
    mark: str = ""
    product: str = ""
    simulated: bool = False
    notes: tuple[str, ...] = ()

    @property
    def found(self) -> tuple[Defect, ...]:
        """The defects proper: unmeasured areas are missing data, not defects; the operator's word counts here too."""
        return tuple(defect for defect in self.defects if defect.seen_as != "unmeasured")

    def expected_false_at(self, sensitivity: float) -> float | None:
        """The expected false count per mm2 with another setting of the dial, without a new run."""
        return self.false_counts.at(threshold_of(sensitivity))
