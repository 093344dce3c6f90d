"""How many defects a die and a wafer may have."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec, Within


class DefectLimits(Spec, frozen=True, kw_only=True):
    """The most defects on one die, and on one mm2 of what was inspected; None: no limit."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    max_per_die: Annotated[int, Within(0)] | None = None
    max_per_mm2: NonNegative | None = None

    @property
    def are_set(self) -> bool:
        """Whether there is a limit at all."""
        return self.max_per_die is not None or self.max_per_mm2 is not None

    def over(self, others: DefectLimits) -> DefectLimits:
        """These limits, and those of others where there are none here."""
        per_die = others.max_per_die if self.max_per_die is None else self.max_per_die
        per_mm2 = others.max_per_mm2 if self.max_per_mm2 is None else self.max_per_mm2
        return DefectLimits(max_per_die=per_die, max_per_mm2=per_mm2)
