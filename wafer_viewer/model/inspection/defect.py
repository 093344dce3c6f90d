"""Defects of a patterned wafer: recipes, limits, defects and inspection results."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect_classes import (
    ClassRules,
    ClassTable,
    DefectClass,
    FabClasses,
    class_table,
    require_distinct,
)
from wafer_viewer.model.inspection.die_grid import DIE_UNITS, LEAST_KNOWN, DieGrid, DieNumber, DieStatus
from wafer_viewer.model.inspection.learned_classes import ClassesLearned, LearnedClass
from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.quantity import Length, Quantity, Word
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Count, Fraction, NonNegative, Spec, Within, replace
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic

# --------------------------------------------------------------------------------------------------------------- defect


class DefectLimits(Spec, frozen=True, kw_only=True):
    """Largest number of defects on one die and per inspected mm2, and how far a die may lie off; None: no limit.

    max_tilt_mrad, max_offset_um, max_bow_um: of every die, as an absolute value, relative to the others.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    max_per_die: Annotated[int, Within(0)] | None = None
    max_per_mm2: NonNegative | None = None
    max_tilt_mrad: NonNegative | None = None
    max_offset_um: NonNegative | None = None
    max_bow_um: NonNegative | None = None

    @property
    def are_set(self) -> bool:
        """True if any limit is set."""
        return self != DefectLimits()

    @property
    def of_dies(self) -> dict[DieNumber, float]:
        """The limits that are set for the numbers of every die."""
        limits: dict[DieNumber, float | None] = {
            "tilt": self.max_tilt_mrad,
            "offset": self.max_offset_um,
            "bow": self.max_bow_um,
        }
        return {name: limit for name, limit in limits.items() if limit is not None}

    def over(self, others: DefectLimits) -> DefectLimits:
        """Return these limits, completed by those of `others`."""
        own = {name: getattr(self, name) for name in self.__struct_fields__}
        return replace(others, **{name: limit for name, limit in own.items() if limit is not None})


Evidence = Literal["height", "picture", "both"]
Judgement = Literal["open", "real", "nuisance"]
Reference = Literal["dies", "golden", "form"]
Against = Literal["dies", "form"]
"""Reference of the comparison: the other dies or a golden die, or a form fitted to the surface."""
RESOLVED_FROM_PX = 20.0
"""Size in pixels below which defects are detected but not resolved."""
DULLEST_SIGMA, KEENEST_SIGMA = 8.0, 2.0


class DefectRecipe(Spec, frozen=True, kw_only=True):
    """Settings of the defect inspection, saved per product.

    sensitivity: from 0, clear defects only, to 1, everything that may be a defect; scales_px: standard deviations of
    the Gaussian filters for heights, 0 for unfiltered, and for wide and faint features of the picture, in which discs
    of 4 to 14 px are also searched; golden: name of the stored golden die to compare with, empty for the median of the
    dies of the wafer; form_order: order of the polynomial removed first; excluded: areas of every die that are not
    inspected, um from its lower left corner; limits: permitted numbers of defects of a die and a wafer; classes: the
    fab's own, instead of the built-in table.
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
    classes: FabClasses = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        require_distinct(self.classes)
        if not self.scales_px or max(self.scales_px) > 40:
            self.refuse("scales_px", "at least one scale, each at most 40 px")
        if not all(region.area_um2 > 0 for region in self.excluded):
            self.refuse(
                "excluded", "rectangles, circles or polygons: lines, points and what has no area leave nothing out"
            )

    @property
    def class_table(self) -> ClassTable:
        """Classes by name, with title, colour, symbol, key and KLARF number."""
        return class_table(self.classes)

    @property
    def threshold_sigma(self) -> float:
        """Detection threshold of a defect's peak, in multiples of the local noise."""
        return threshold_of(self.sensitivity)


def threshold_of(sensitivity: float) -> float:
    """Return the threshold in sigma: 8 at sensitivity 0, 5 at 0.5, 2 at 1."""
    return DULLEST_SIGMA + sensitivity * (KEENEST_SIGMA - DULLEST_SIGMA)


class Defect(MeasurementResult, frozen=True, kw_only=True, tag="defect"):
    """A difference from the reference: position, size, class with reasons, and judgement.

    center and outline in stage um; die: "col,row", empty outside of dies; in_die: um from the die's lower left corner;
    height: peak difference from the reference, negative for pits; mean_height_um: mean over its area; score: peak
    signal over the local noise; scale_px: of the filter with the best score, for a disc its diameter; size_resolved:
    False under 20 px ("detected, size not resolved"). judged_kind: the operator's class, which overrides `kind`;
    judged_at: its time (ISO 8601). learned: the class that judgements of other defects propose.
    """

    center: Point
    outline: Region
    input_fields: ClassVar[tuple[str, ...]] = ("outline",)
    main_fields: ClassVar[tuple[str, ...]] = ("height",)
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
    judged_kind: str | None = None
    note: str = ""
    judged_by: str = ""
    judged_at: str = ""
    learned: LearnedClass | None = None

    @property
    def seen_as(self) -> str:
        """Effective class: the operator's if set, which may be one of the fab's table."""
        return self.judged_kind or self.kind


MARGIN, LEAST_PX, MOST_PX = 1.0, 32, 512
"""Margin around a defect as a share of its length; least and greatest side of the crop in px."""


def crop(surface: Mosaic, defect: Defect) -> HeightMap:
    """Return the square about a defect of twice its longer extent, at least 32 and at most 512 px."""
    x0, y0, x1, y1 = defect.outline.bounds_um
    px = surface.pixel_um
    across = (1 + MARGIN) * max(x1 - x0, y1 - y0)
    half = min(max(across, LEAST_PX * px), MOST_PX * px) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return surface.window(Region.rectangle(x - half, y - half, x + half, y + half))


class FalseCounts(Spec, frozen=True, kw_only=True):
    """Expected number of false defects per mm2 as a function of the threshold, estimated from the data.

    threshold_sigma rises; per_mm2 has one value for each threshold.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    threshold_sigma: tuple[float, ...] = ()
    per_mm2: tuple[NonNegative, ...] = ()

    def at(self, threshold_sigma: float) -> float | None:
        """Return the false count by log-linear interpolation between the points; None without points."""
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
    """Result of one inspection: the file ``results/NAME/defects.json``.

    reference: what the surface was compared with; inspected_mm2: area measured and compared, where an empty list means
    no defects; unmeasured_mm2: area without heights; not_scanned_mm2: unscanned part of the surface's rectangle, for
    inspections without dies; learned: what proposals of classes stand on. A die that is not or only partly scanned is
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
    learned: ClassesLearned | None = None

    @property
    def inspected_fraction(self) -> float:
        """Inspected part of the area that was to be inspected; excluded areas do not count."""
        asked_mm2 = self.inspected_mm2 + self.unmeasured_mm2 + self.not_scanned_mm2
        return self.inspected_mm2 / asked_mm2 if asked_mm2 else 0.0

    @property
    def found(self) -> tuple[Defect, ...]:
        """Defects without unmeasured areas, which are missing data; the operator's class takes precedence."""
        return tuple(defect for defect in self.defects if defect.seen_as != "unmeasured")

    def expected_false_at(self, sensitivity: float) -> float | None:
        """Return the expected false count per mm2 at another sensitivity, without a new run."""
        return self.false_counts.at(threshold_of(sensitivity))


LEAST_DIES = 3
"""Smallest number of dies with a defect at the same position; fewer are coincidence."""


class RepeatedPlace(Spec, frozen=True, kw_only=True):
    """A position on the die where defects of several dies coincide.

    in_die: their median position, um from the die's lower left corner; reach_um: largest distance from it; dies: names
    of the dies; of_dies: number of dies scanned completely; numbers: of the defects, die by die; kind: most frequent
    class; by_chance: upper bound of the probability that the same defects, placed at random on their dies, share any
    place in as many dies.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    in_die: Point
    reach_um: NonNegative = 0.0
    dies: tuple[str, ...]
    of_dies: Annotated[int, Within(0)] = 0
    numbers: tuple[int, ...]
    kind: str
    by_chance: Fraction | None = None

    @property
    def words(self) -> str:
        """Text with the number of dies."""
        return f"in {len(self.dies)} of {self.of_dies} whole dies" if self.of_dies else f"in {len(self.dies)} dies"

    @property
    def chance_words(self) -> str:
        """Text with the probability of chance; empty if it is not evaluated."""
        if self.by_chance is None:
            return ""
        percent = 100 * self.by_chance
        return (
            f"by chance {percent:.2g} %" if 0.1 <= percent < 99.5 else f"by chance {'<0.1' if percent < 1 else 100} %"
        )


# ------------------------------------------------------------------------------------------------------- defect verdict


REFERENCES: dict[Reference, str] = {
    "dies": "the median of the dies",
    "golden": "the golden die",
    "form": "the fitted form",
}
"""References in words."""
FORM_SEES = (
    "Only what stands out of the fitted form is seen: no missing, tilted or discoloured die, nothing that is missing "
    "from a pattern, no stain on one."
)
"""Limitation of a comparison with the fitted form."""
LEAST_INSPECTED = 0.5
"""Smallest inspected fraction for a verdict; a die of which less is measured counts as partly scanned."""
LEAST_GAP = 0.02
"""Fraction of a surface; unscanned area at a ragged border of the fields is smaller."""


class DefectVerdict(Spec, frozen=True, kw_only=True):
    """Verdict on an inspected wafer, with the reasons for any word but pass.

    word: fail where a limit is exceeded, no verdict where anything that the limits cover was not inspected, else pass;
    within: True for pass alone; inspected_fraction: of the area that was to be inspected; counted: defects without
    those judged a nuisance; failing: dies with more defects than permitted; not_inspected: dies that are not or not
    fully scanned, which are never clean.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    word: Word
    within: bool
    inspected_fraction: Fraction = 0.0
    counted: int
    per_mm2: NonNegative | None
    failing: tuple[str, ...] = ()
    not_inspected: tuple[str, ...] = ()
    why: tuple[str, ...] = ()


def verdict_of(inspection: Inspection, limits: DefectLimits | None = None) -> DefectVerdict:
    """Compare the defects of an inspection with limits.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection.
    limits : DefectLimits, optional
        Largest number of defects on one die, and per inspected mm2. Default: the limits of the inspection's recipe.

    Returns
    -------
    DefectVerdict
        The word and whether the wafer is within the limits, with the counted defects, their number per mm2 (None if
        nothing was inspected), the inspected fraction, the failing dies, the dies that were not inspected, and the
        reasons.

    Notes
    -----
    Defects judged a nuisance, and unmeasured areas, are not counted. An open limit is never exceeded. A wafer on which
    less than half was inspected has no verdict, nor has one with dies that were not or only partly scanned or not
    compared, or one without known dies under a limit per die. Without dies, a surface whose unscanned area is over 2 %
    of its scanned area has no verdict. A limit that is exceeded on what was inspected fails the wafer all the same.
    """
    limits = inspection.recipe.limits if limits is None else limits
    counted = [defect for defect in inspection.found if defect.judgement != "nuisance"]
    area_mm2 = inspection.inspected_mm2
    per_mm2 = len(counted) / area_mm2 if area_mm2 else None
    failing = _failing((defect.die for defect in counted), limits)
    lacking = tuple(die.name for die in inspection.dies if _lacks_area(die, inspection))
    lying = _lying_badly(inspection, limits)
    exceeded = (*_too_many(failing, limits), *_too_dense(per_mm2, limits), *(sentence for sentence, _ in lying))
    undecided = (*_not_inspected(lacking, inspection), *_gaps(inspection), *_not_countable(inspection, limits))
    word: Word = "fail" if exceeded else "no verdict" if undecided else "pass"
    return DefectVerdict(
        word=word,
        within=word == "pass",
        inspected_fraction=inspection.inspected_fraction,
        counted=len(counted),
        per_mm2=per_mm2,
        failing=tuple(dict.fromkeys((*failing, *(name for _, names in lying for name in names)))),
        not_inspected=lacking,
        why=(*exceeded, *undecided),
    )


def headline(inspection: Inspection, limits: DefectLimits | None = None) -> str:
    """Return the first line of a result: the share inspected, the reference, the defects and the verdict."""
    verdict = verdict_of(inspection, limits)
    counted = "1 defect" if verdict.counted == 1 else f"{verdict.counted} defects"
    set_limits = inspection.recipe.limits if limits is None else limits
    outcome = verdict.word if set_limits.are_set or verdict.word == "no verdict" else "no limits set"
    area = f"{_percent(verdict.inspected_fraction)} of {_asked_mm2(inspection):.3g} mm2 inspected"
    return f"{area}, compared with {REFERENCES[inspection.reference]}: {counted}, {outcome}."


def _asked_mm2(inspection: Inspection) -> float:
    return inspection.inspected_mm2 + inspection.unmeasured_mm2 + inspection.not_scanned_mm2


def _percent(fraction: float) -> str:
    """Return a percentage that is 100 % only if nothing is missing, and 0 % only if all is."""
    percent = 100 * fraction
    return f"{percent:.0f} %" if percent in (0.0, 100.0) else f"{min(max(percent, 0.1), 99.9):.3g} %"


DieBin = Literal["pass", "fail", "missing", "not inspected"]


def die_bins(inspection: Inspection, limits: DefectLimits | None = None) -> dict[tuple[int, int], DieBin]:
    """Sort the dies of an inspection by their defects.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection with dies.
    limits : DefectLimits, optional
        Largest number of defects on one die. Default: the limits of the inspection's recipe.

    Returns
    -------
    dict
        (column, row) of each die and its bin: "missing" where no die was seen, "fail" for more defects than permitted,
        "not inspected" for dies that were not scanned completely or not inspected, else "pass".

    Raises
    ------
    MeasureError
        When no limit of defects per die is set.

    Notes
    -----
    Defects judged a nuisance, and unmeasured areas, are not counted. A die with too many defects fails even if it was
    only partly scanned.
    """
    limits = inspection.recipe.limits if limits is None else limits
    require_die_limit(limits)
    return bins_of(inspection.dies, (d.die for d in inspection.found if d.judgement != "nuisance"), limits)


def bins_of(dies: Iterable[DieStatus], on: Iterable[str], limits: DefectLimits) -> dict[tuple[int, int], DieBin]:
    """Return (column, row) and bin of dies, as `die_bins`; on: name of the die of each counted defect."""
    failing = _failing(on, limits)
    return {(die.col, die.row): _bin(die, failing) for die in dies}


def require_die_limit(limits: DefectLimits) -> None:
    """Raise MeasureError without a limit of defects per die."""
    if limits.max_per_die is None:
        raise MeasureError(
            "A wafer map needs the largest number of defects of a good die: set max_per_die (--max-per-die), such as 0."
        )


def _bin(die: DieStatus, failing: tuple[str, ...]) -> DieBin:
    if die.state == "missing":
        return "missing"
    if die.name in failing:
        return "fail"
    return "pass" if die.state == "whole" and die.defects is not None else "not inspected"


def _lacks_area(die: DieStatus, inspection: Inspection) -> bool:
    """Return whether a part of a die was not scanned; the rim of a lattice that names no dies may cut them."""
    named = inspection.grid is not None and inspection.grid.named
    beyond = named and die.state == "cut" and die.measured_fraction < LEAST_KNOWN
    not_compared = die.state == "whole" and die.defects is None
    return beyond or not_compared or die.state in ("partly scanned", "not scanned")


def _failing(on: Iterable[str], limits: DefectLimits) -> tuple[str, ...]:
    if (most := limits.max_per_die) is None:
        return ()
    return tuple(name for name, n in Counter(filter(None, on)).items() if n > most)


def _too_many(failing: tuple[str, ...], limits: DefectLimits) -> tuple[str, ...]:
    if not failing:
        return ()
    dies = "1 die" if len(failing) == 1 else f"{len(failing)} dies"
    most = "1 defect" if limits.max_per_die == 1 else f"{limits.max_per_die} defects"
    return (f"More than {most} on {dies}: {_listed(failing)}.",)


def _lying_badly(inspection: Inspection, limits: DefectLimits) -> list[tuple[str, tuple[str, ...]]]:
    """Return a sentence for each limit of the dies that some exceed, and their names."""
    found: list[tuple[str, tuple[str, ...]]] = []
    measured = [(die.name, die.measured) for die in inspection.dies if die.measured is not None]
    for name, limit in limits.of_dies.items():
        off = [(die, abs(at.value(name))) for die, at in measured if abs(at.value(name)) > limit]
        if off:
            farthest = sorted(off, key=lambda one: -one[1])
            names = tuple(f"{die} ({value:.3g})" for die, value in farthest)
            sentence = f"{name.capitalize()} over {limit:g} {DIE_UNITS[name]}: {_listed(names)}."
            found.append((sentence, tuple(die for die, _ in farthest)))
    return found


def _too_dense(per_mm2: float | None, limits: DefectLimits) -> tuple[str, ...]:
    if limits.max_per_mm2 is None or per_mm2 is None or per_mm2 <= limits.max_per_mm2:
        return ()
    return (f"{per_mm2:.3g} defects per mm2, and {limits.max_per_mm2:g} are allowed.",)


def _not_inspected(lacking: tuple[str, ...], inspection: Inspection) -> tuple[str, ...]:
    if not inspection.inspected_mm2:
        return ("Nothing was inspected.",)
    dies = (f"Not or only partly scanned, so not clean: {_listed(lacking)}.",) if lacking else ()
    if inspection.inspected_fraction >= LEAST_INSPECTED:
        return dies
    return (*dies, f"Only {_percent(inspection.inspected_fraction)} was inspected, so the rest is not clean.")


def require_dies_for(limits: DefectLimits, dies: bool) -> None:
    """Raise MeasureError for a limit of defects per die, or of the dies themselves, where no die is known."""
    if (limits.max_per_die is not None or limits.of_dies) and not dies:
        raise MeasureError(NO_DIE_TO_COUNT_ON)


NO_DIE_TO_COUNT_ON = (
    "No die is known, so nothing per die can be judged: give the pitch and a corner of the dies, or limit the "
    "defects per mm2 instead."
)


def _not_countable(inspection: Inspection, limits: DefectLimits) -> tuple[str, ...]:
    """Return a sentence on a limit per die where no die is known."""
    if limits.max_per_die is None or inspection.dies:
        return ()
    return (NO_DIE_TO_COUNT_ON,)


def _gaps(inspection: Inspection) -> tuple[str, ...]:
    """Return a sentence on unscanned area of a surface without known dies."""
    whole_mm2 = inspection.inspected_mm2 + inspection.unmeasured_mm2
    if inspection.dies or inspection.not_scanned_mm2 <= LEAST_GAP * whole_mm2:
        return ()
    return (f"{inspection.not_scanned_mm2:.3g} mm2 of the surface were not scanned, so it is not clean.",)


def _listed(names: tuple[str, ...], most: int = 12) -> str:
    """Return the first names and the number of further ones, separated by semicolons: die names contain commas."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return "; ".join(names[:most]) + more
