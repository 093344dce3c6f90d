"""Whether a wafer is good: each feature against its limits, and all of them together."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.findings import Length
from wafer_viewer.model.sample import Feature
from wafer_viewer.model.spec import Spec

Word = Literal["pass", "fail", "inconclusive", "no verdict"]


class Judged(Spec, frozen=True, kw_only=True):
    """One feature: what was measured of it, the word, and the sentence that says why. No height: not measured."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: Feature
    height: Length | None = None
    word: Word
    why: str


class WaferVerdict(Spec, frozen=True, kw_only=True):
    """The file ``verdict.json`` of a reconstruction: the word for the wafer, what to do next, every feature.

    job: product and revision; surface: the mark of the surface it was measured on.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    word: Word
    next: str
    items: tuple[Judged, ...] = ()
    job: str = ""
    lot: str = ""
    wafer_id: str = ""
    released: bool = False
    simulated: bool = False
    residual_um: float | None = None
    surface: str = ""
