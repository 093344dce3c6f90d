"""Why a pixel has its height, or none: its focus curve, the peak and its rivals, every gate's score and verdict."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.spec import Spec


class Verdict(Spec, frozen=True, kw_only=True):
    """What one gate found: the score of the pixel, the limit it is held to, and whether it passed.

    A gate that is off has no limit and says why in `note`; unit is that of score and limit.
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
    """Another maximum of the focus curve: where it is, and its focus measure as a share of the peak's."""

    error: ClassVar[type[WaferViewerError]] = ComputeError
    z_um: float
    share: float


class FocusCurve(Spec, frozen=True, kw_only=True):
    """The focus curve of one pixel and what was made of it.

    z_um, focus and grey have one entry for each frame in use, z rising; focus is the focus measure as a share of its
    largest value. peak_z_um is where the peak is, whether the gates believe it or not; height_um is the height in the
    map before smoothing, None where it is unmeasured for the reason that `origin` names.
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
