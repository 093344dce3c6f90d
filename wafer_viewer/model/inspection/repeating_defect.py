"""Repeating defect: several dies have a defect at the same position, from the mask or the process."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectClass
from wafer_viewer.model.region import Point
from wafer_viewer.model.spec import NonNegative, Spec, Within

LEAST_DIES = 3
"""Smallest number of dies with a defect at the same position; fewer are coincidence."""


class RepeatedPlace(Spec, frozen=True, kw_only=True):
    """A position on the die where defects of several dies coincide.

    in_die: their median position, um from the die's lower left corner; reach_um: largest distance from it; dies: names
    of the dies; of_dies: number of dies scanned completely; numbers: of the defects, die by die; kind: most frequent
    class.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    in_die: Point
    reach_um: NonNegative = 0.0
    dies: tuple[str, ...]
    of_dies: Annotated[int, Within(0)] = 0
    numbers: tuple[int, ...]
    kind: DefectClass

    @property
    def words(self) -> str:
        """Text with the number of dies."""
        return f"in {len(self.dies)} of {self.of_dies} whole dies" if self.of_dies else f"in {len(self.dies)} dies"
