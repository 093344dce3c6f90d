"""A place on the die at which several dies have a defect: a systematic one, of the mask or the process."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectClass
from wafer_viewer.model.region import Point
from wafer_viewer.model.spec import NonNegative, Spec, Within

LEAST_DIES = 3
"""Fewer dies with a defect at the same place are chance."""


class RepeatedPlace(Spec, frozen=True, kw_only=True):
    """Where defects of several dies lie on each other.

    in_die: their middle, um from the die's lower left corner; reach_um: how far the furthest lies from it; dies: the
    names of theirs; of_dies: how many dies were scanned whole; numbers: of the defects, die by die; kind: what most of
    them are seen as.
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
        """In how many dies."""
        return f"in {len(self.dies)} of {self.of_dies} whole dies" if self.of_dies else f"in {len(self.dies)} dies"
