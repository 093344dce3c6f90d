"""Focus curve of a pixel: peak, competing maxima, and score and outcome of every gate."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.spec import Spec


class Verdict(Spec, frozen=True, kw_only=True):
    """Outcome of one gate: score of the pixel, limit, and whether it passed.

    A disabled gate has no limit and a reason in `note`; unit is that of score and limit.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    gate: str
    question: str
    score: float | None
    limit: float | None
    unit: str
    passed: bool
    note: str = ""


class Rival(Spec, frozen=True, kw_only=True):
    """A competing maximum of the focus curve: its position, and its focus measure as a fraction of the peak's."""

    error: ClassVar[type[WaferViewerError]] = ComputeError
    z_um: float
    share: float


class FocusCurve(Spec, frozen=True, kw_only=True):
    """Focus curve of one pixel and its evaluation.

    z_um, focus and grey have one entry per frame in use, z rising; focus is the focus measure as a fraction of its
    maximum. peak_z_um: position of the peak, even if a gate rejects it; height_um: height in the map before smoothing,
    None if unmeasured for the reason in `origin`; u_um: its standard uncertainty (k = 1), None if it is not known.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    field: int
    row: int
    col: int
    x_um: float
    y_um: float
    focus_measure: str
    window: int
    z_um: tuple[float, ...]
    focus: tuple[float, ...]
    grey: tuple[int, ...]
    peak_z_um: float
    height_um: float | None
    origin: str
    confidence: float
    rivals: tuple[Rival, ...]
    verdicts: tuple[Verdict, ...]
    simulated: bool = False
    u_um: float | None = None
