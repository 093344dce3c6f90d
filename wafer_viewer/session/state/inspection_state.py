"""The inspection for defects of the open dataset as the snapshot shows it."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.inspection.defect import Defect, Inspection


@dataclass(frozen=True, slots=True, eq=False)
class InspectionState:
    """What was found on the surface on show; without an inspection nothing is known of its defects.

    stale: the surface was made again since. problem: why the last inspection failed, or what is kept of one
    cannot be read. work: the id of the one under way. Two states are equal where they are the same: lists of thousands
    of defects are not compared.
    """

    inspection: Inspection | None = None
    stale: bool = False
    problem: str = ""
    work: str = ""
    can_undo: bool = False
    can_redo: bool = False

    @property
    def defects(self) -> tuple[Defect, ...]:
        """All that was found."""
        return self.inspection.defects if self.inspection is not None else ()

    def defect(self, number: int) -> Defect | None:
        """The defect of a number, if there is one."""
        return next((defect for defect in self.defects if defect.number == number), None)
