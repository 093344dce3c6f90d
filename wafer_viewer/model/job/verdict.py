"""Whether a wafer is good: each feature against its limits, the dies they lie on, and all of them together."""

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
"""The word of a die or a wafer is the first of these that any of its features has."""


class FeatureVerdict(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """One feature: what was measured of it, the word, and the sentence that says why. Nothing measured: None.

    die: the name of the die that it was measured on, where the feature is repeated over dies; not_evaluated: what the
    uncertainty leaves out. `height` is how `measured` was written before other things than heights were judged.
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
        """The feature's name, with the die that it was measured on."""
        return f"{self.feature.name}, die {self.die}" if self.die else self.feature.name


class JudgedDie(Spec, frozen=True, kw_only=True):
    """A die with its word: its lower left corner on the wafer, and its size."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    x_um: float
    y_um: float
    width_um: float
    height_um: float
    word: Word


class WaferVerdict(Spec, frozen=True, kw_only=True):
    """The file ``verdict.json`` of a reconstruction: the word for the wafer, what to do next, every feature and die.

    job: product and revision; surface: the mark of the surface it was measured on.
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
        """How many dies have each word, the gravest first; words that none has are left out."""
        counts = Counter(die.word for die in self.dies)
        return {word: counts[word] for word in GRAVEST if counts[word]}
