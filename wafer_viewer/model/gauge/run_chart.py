"""Run chart of the errors of successive checks, and capability of the gauge."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import NonNegative, Positive, Spec


class ChartPoint(Spec, frozen=True, kw_only=True):
    """One signed check: time (ISO 8601), error with U, verdict and the chart rules that it violates."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    at: str
    value: Length
    verdict: Word
    signed_by: str = ""
    breaks: tuple[str, ...] = ()


class RunChart(Spec, frozen=True, kw_only=True):
    """Individuals chart of the errors of one pair of blocks, oldest first; lengths in um.

    s_um: from moving ranges (mean range / 1.128); low_um, high_um: control limits, mean -+ 3 s; all None with too few
    points. drift_um_per_day: with U. due: day of the next check, ISO 8601. warnings, notes: sentences.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    points: tuple[ChartPoint, ...]
    mean_um: float
    s_um: NonNegative | None = None
    low_um: float | None = None
    high_um: float | None = None
    limit_um: Positive | None = None
    drift_um_per_day: Length | None = None
    due: str = ""
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class Capability(Spec, frozen=True, kw_only=True):
    """Cg and Cgk of the repeats of one pair of blocks; None with too few repeats. variant: the formulas used."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    n: int
    tolerance_um: Positive
    mean_um: float
    s_um: NonNegative | None
    cg: float | None
    cgk: float | None
    capable: bool | None
    why: str
    variant: str = ""
