"""Permitted numbers of defects of a die and a wafer."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec, Within


class DefectLimits(Spec, frozen=True, kw_only=True):
    """Largest number of defects on one die, and per inspected mm2; None: no limit."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    max_per_die: Annotated[int, Within(0)] | None = None
    max_per_mm2: NonNegative | None = None

    @property
    def are_set(self) -> bool:
        """True if any limit is set."""
        return self.max_per_die is not None or self.max_per_mm2 is not None

    def over(self, others: DefectLimits) -> DefectLimits:
        """Return these limits, completed by those of `others`."""
        per_die = others.max_per_die if self.max_per_die is None else self.max_per_die
        per_mm2 = others.max_per_mm2 if self.max_per_mm2 is None else self.max_per_mm2
        return DefectLimits(max_per_die=per_die, max_per_mm2=per_mm2)
