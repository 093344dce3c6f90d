"""What lies ready for reviewing defects: kept recipes and golden dies, and what another tool found."""

from __future__ import annotations

from dataclasses import dataclass, replace

from wafer_viewer.model.inspection.defect import Defect, DefectRecipe
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.model.inspection.klarf import Klarf, KlarfDefect
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.region import Region

SAME_PLACE_UM = 25.0
"""Two tools mean the same place where their centres are no further apart, unless a person says otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherTool:
    """A KLARF file laid over the surface on show: places are those of its defects, in its order, stage um.

    by: how its dies were found here, for people; within_um: so near a defect found here is the same.
    """

    name: str
    klarf: Klarf
    grid: DieGrid
    by: str
    within_um: float = SAME_PLACE_UM

    @property
    def places(self) -> tuple[Region, ...]:
        """Circles as large as the defects, stage um."""
        return self.klarf.outlines(self.grid)

    def matched(self, defects: tuple[Defect, ...]) -> dict[int, int]:
        """Numbers in the file of those that were found here as well, with the numbers they have here."""
        return self.klarf.matched(defects, self.within_um, self.grid)

    def unmatched(self, defects: tuple[Defect, ...]) -> tuple[tuple[KlarfDefect, Region], ...]:
        """What is in the file and was not found here, with its place."""
        known = self.matched(defects)
        pairs = zip(self.klarf.defects, self.places, strict=True)
        return tuple((defect, place) for defect, place in pairs if defect.number not in known)

    def within(self, within_um: float) -> OtherTool:
        """The same, matched over another distance."""
        return replace(self, within_um=within_um)


@dataclass(frozen=True, slots=True)
class DefectShelf:
    """Recipes, saved last first, and golden dies, the newest version first of each; problems: files that are none.

    other: what another tool found, while it is laid over the surface.
    """

    recipes: tuple[DefectRecipe, ...] = ()
    golden: tuple[GoldenHeader, ...] = ()
    problems: tuple[str, ...] = ()
    other: OtherTool | None = None

    def recipes_of(self, product: str) -> tuple[DefectRecipe, ...]:
        """Those of a product, saved last first; without a product none."""
        return tuple(recipe for recipe in self.recipes if product and recipe.product == product)

    def recipe_of(self, product: str) -> DefectRecipe | None:
        """The one that is taken by itself: that saved last for the product."""
        return next(iter(self.recipes_of(product)), None)


def product_of(job: Job) -> str:
    """What is scanned, by the job's word or its sample's; empty where neither says."""
    return job.product or job.sample.product
