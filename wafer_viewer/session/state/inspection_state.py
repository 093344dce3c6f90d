"""State of defect inspection, its resources, and of the gauge-block check, as in the snapshot."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from wafer_viewer.model.gauge import (
    Capability,
    Certificate,
    GaugeCheck,
    GaugeRecord,
    GaugeRepeat,
    GaugeTerms,
    RunChart,
    ScaleCorrection,
)
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.model.inspection.klarf import Klarf, KlarfDefect
from wafer_viewer.model.inspection.lot import WaferComparison
from wafer_viewer.model.job import Job
from wafer_viewer.model.region import Region


@dataclass(frozen=True, slots=True, eq=False)
class InspectionState:
    """Inspection of the displayed surface; None if it was not inspected.

    stale: the surface has been recomputed since. problem: why the last inspection failed, or cannot be read;
    dies_missing: because dies were not found. work: id of the running one. search: which inspection it is, counted
    since the program began; the numbers of defects are those of this one alone. Equality is identity, because lists of
    thousands of defects are not compared.
    """

    inspection: Inspection | None = None
    stale: bool = False
    problem: str = ""
    dies_missing: bool = False
    work: str = ""
    can_undo: bool = False
    can_redo: bool = False
    search: int = 0

    @property
    def defects(self) -> tuple[Defect, ...]:
        """All detected defects."""
        return self.inspection.defects if self.inspection is not None else ()

    def defect(self, number: int) -> Defect | None:
        """Return the defect with a number; None if there is none."""
        return next((defect for defect in self.defects if defect.number == number), None)


SAME_PLACE_UM = 25.0
"""Default maximum distance in um between the centres of the same defect in two inspections."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherTool:
    """KLARF file overlaid on the displayed surface: `places` are those of its defects, in its order, stage um.

    by: how its dies were located, as text; within_um: maximum distance of a matching defect; pictures: first image
    of its defects by number, as JPEG.
    """

    name: str
    klarf: Klarf
    grid: DieGrid
    by: str
    within_um: float = SAME_PLACE_UM
    pictures: dict[int, bytes] = field(default_factory=dict[int, bytes])

    @property
    def places(self) -> tuple[Region, ...]:
        """Circles of the size of the defects, stage um."""
        return self.klarf.outlines(self.grid)

    def matched(self, defects: tuple[Defect, ...]) -> dict[int, int]:
        """Return the numbers of matched defects: number in the file to number here."""
        return self.klarf.matched(defects, self.within_um, self.grid)

    def unmatched(self, defects: tuple[Defect, ...]) -> tuple[tuple[KlarfDefect, Region], ...]:
        """Return the defects of the file that were not found here, with their regions."""
        known = self.matched(defects)
        pairs = zip(self.klarf.defects, self.places, strict=True)
        return tuple((defect, place) for defect, place in pairs if defect.number not in known)

    def within(self, within_um: float) -> OtherTool:
        """Return a copy with another matching distance."""
        return replace(self, within_um=within_um)


@dataclass(frozen=True, slots=True)
class DefectFilesState:
    """Recipes, last saved first, and golden dies, newest version of each first.

    problems: invalid files. other: the overlay of another tool's defects, if there is one. earlier: the comparison with
    an earlier inspection, if there is one.
    """

    recipes: tuple[DefectRecipe, ...] = ()
    golden: tuple[GoldenHeader, ...] = ()
    problems: tuple[str, ...] = ()
    other: OtherTool | None = None
    earlier: WaferComparison | None = None

    def recipes_of(self, product: str) -> tuple[DefectRecipe, ...]:
        """Return the recipes of a product, last saved first; empty without a product."""
        return tuple(recipe for recipe in self.recipes if product and recipe.product == product)

    def recipe_of(self, product: str) -> DefectRecipe | None:
        """Return the default recipe of a product, which is the last saved one."""
        return next(iter(self.recipes_of(product)), None)


def product_of(job: Job) -> str:
    """Return the product of a job or of its sample; empty if neither has one."""
    return job.product or job.sample.product


Faces = tuple[Region, Region]
"""Upper and lower face."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Preparation step marked as done: ``clean``, ``warm``; at: ISO 8601."""

    point: str
    at: str


@dataclass(frozen=True, slots=True)
class GaugeState:
    """Running check: its certificate and terms, the repeats, their evaluation, and earlier signed checks.

    refusal: why the open dataset cannot be a repeat now, one sentence, or None. faces: those of the last repeat. check:
    the evaluation of the repeats so far, unsigned; None while there are none. records: signed checks of these very
    blocks, oldest first, from which chart and capability are computed. correction: what `correct_scale` would write,
    after a signed check. busy: a repeat is being measured.
    """

    certificate: Certificate | None = None
    terms: GaugeTerms = GaugeTerms()
    ticks: tuple[Tick, ...] = ()
    refusal: str | None = None
    faces: Faces | None = None
    repeats: tuple[GaugeRepeat, ...] = ()
    check: GaugeCheck | None = None
    signed: GaugeCheck | None = None
    records: tuple[GaugeRecord, ...] = ()
    chart: RunChart | None = None
    capability: Capability | None = None
    correction: ScaleCorrection | None = None
    busy: bool = False
