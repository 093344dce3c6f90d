"""Classes that are proposed from what people judged: the proposal, what it stands on, and the judged defects."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import Fraction, Spec, Within

NUISANCE = "nuisance"
"""Proposal for what people would judge to be no defect."""
LEAST_JUDGED = 8
"""Smallest number of judged defects, of at least two classes, from which classes are proposed."""


class LearnedClass(Spec, frozen=True, kw_only=True):
    """Class that the judgements of other defects propose for one.

    kind: a class, or "nuisance"; share: fraction of the votes for it.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    kind: str
    share: Fraction


class ClassesLearned(Spec, frozen=True, kw_only=True):
    """Judged defects that the proposals of an inspection stand on, and how often they would have been right.

    judged: number of judged defects; wafers: number of inspections that they are of. right_fraction: fraction of them
    for which the votes that did not see them propose the judged class; rules_right_fraction: the same for the rules.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    judged: Annotated[int, Within(0)]
    wafers: Annotated[int, Within(0)]
    right_fraction: Fraction
    rules_right_fraction: Fraction

    @property
    def words(self) -> str:
        """Sentence on the number of judgements and on how often they would have been proposed."""
        of = "this inspection" if self.wafers == 1 else f"{self.wafers} inspections"
        return (
            f"Proposed from {self.judged} judged defects of {of}; of these the others would have proposed "
            f"{100 * self.right_fraction:.0f} % right, and the rules {100 * self.rules_right_fraction:.0f} %."
        )


class JudgedDefect(Spec, frozen=True, kw_only=True):
    """A judged defect to learn from.

    wafer: name of its dataset; number: its own; kind: the class people gave, or "nuisance"; by_rules: that of the
    rules; numbers: its features, in the order of `JudgedDefects.features`.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    wafer: str = ""
    number: int
    kind: str
    by_rules: str
    numbers: tuple[float, ...]


class JudgedDefects(Spec, frozen=True, kw_only=True):
    """Judged defects of a product, over all of its inspected wafers; features: names of their numbers."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    product: str = ""
    features: tuple[str, ...] = ()
    defects: tuple[JudgedDefect, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(len(defect.numbers) != len(self.features) for defect in self.defects):
            self.refuse("defects", "one number for each feature")
