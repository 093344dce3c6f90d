"""Defect inspection of the open dataset, as in the snapshot."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.inspection.defect import Defect, Inspection


@dataclass(frozen=True, slots=True, eq=False)
class InspectionState:
    """Inspection of the displayed surface; None if it was not inspected.

    stale: the surface has been recomputed since. problem: why the last inspection failed, or cannot be read. work: id
    of the running one. Equality is identity, because lists of thousands of defects are not compared.
    """

    inspection: Inspection | None = None
    stale: bool = False
    problem: str = ""
    work: str = ""
    can_undo: bool = False
    can_redo: bool = False

    @property
    def defects(self) -> tuple[Defect, ...]:
        """All detected defects."""
        return self.inspection.defects if self.inspection is not None else ()

    def defect(self, number: int) -> Defect | None:
        """Return the defect with a number; None if there is none."""
        return next((defect for defect in self.defects if defect.number == number), None)
