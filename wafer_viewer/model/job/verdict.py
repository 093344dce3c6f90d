"""Verdict on a wafer: features against their limits, dies, and the wafer as a whole."""

from __future__ import annotations

from collections import Counter
from typing import ClassVar

import msgspec

from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.spec import Spec

GRAVEST: tuple[Word, ...] = ("fail", "no verdict", "inconclusive", "pass")
"""Verdicts by severity: a die or wafer gets the first of these that any of its features has."""


class FeatureVerdict(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """Verdict on one feature: measured value, outcome and the sentence with the reason. measured: None if not measured.

    die: name of the die that it was measured on, for a feature repeated over dies; not_evaluated: contributions missing
    from the uncertainty. `height` is the name of `measured` in older files, when only heights were judged.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: Feature
    die: str = ""
    measured: Quantity | None = None
    not_evaluated: tuple[str, ...] = ()
    word: Word
    why: str
    height: Length | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.height is not None:
            msgspec.structs.force_setattr(self, "measured", self.height.quantity)
            msgspec.structs.force_setattr(self, "height", None)

    @property
    def name(self) -> str:
        """Name of the feature, with the die that it was measured on."""
        return f"{self.feature.name}, die {self.die}" if self.die else self.feature.name


class JudgedDie(Spec, frozen=True, kw_only=True):
    """A die with its verdict, its lower left corner on the wafer and its size."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    x_um: float
    y_um: float
    width_um: float
    height_um: float
    word: Word


class WaferVerdict(Spec, frozen=True, kw_only=True):
    """Verdict on a wafer, the next action, and every feature and die: the file ``verdict.json`` of a reconstruction.

    job: product and revision; surface: mark of the surface that was measured.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    word: Word
    next: str
    items: tuple[FeatureVerdict, ...] = ()
    dies: tuple[JudgedDie, ...] = ()
    job: str = ""
    lot: str = ""
    wafer_id: str = ""
    released: bool = False
    simulated: bool = False
    residual_um: float | None = None
    surface: str = ""

    @property
    def die_counts(self) -> dict[Word, int]:
        """Number of dies per verdict, the most severe first; without verdicts that no die has."""
        counts = Counter(die.word for die in self.dies)
        return {word: counts[word] for word in GRAVEST if counts[word]}
