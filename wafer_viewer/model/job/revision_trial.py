"""Trial of a job on wafers measured before: changed verdicts and their reasons."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.spec import Spec


class VerdictChange(Spec, frozen=True, kw_only=True):
    """A feature whose verdict changes. before: None if it was not judged; after: None if it is no longer judged."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: str
    before: Word | None = None
    after: Word | None = None
    measured_before: Quantity | None = None
    measured_after: Quantity | None = None
    why: tuple[str, ...]


class TriedWafer(Spec, frozen=True, kw_only=True):
    """Verdict on a wafer by the job, with its previous verdict.

    result: reconstruction that was judged; n_same: number of features with an unchanged verdict.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    dataset: str
    wafer_id: str = ""
    result: str
    before: Word | None = None
    after: Word
    changes: tuple[VerdictChange, ...] = ()
    n_same: int = 0


class NotTried(Spec, frozen=True, kw_only=True):
    """A dataset that could not be judged by the job, with the reason."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    dataset: str
    why: str


class Trial(Spec, frozen=True, kw_only=True):
    """Result of a trial of a job on stored datasets."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    job: str
    wafers: tuple[TriedWafer, ...] = ()
    not_tried: tuple[NotTried, ...] = ()

    @property
    def n_changes(self) -> int:
        """Number of changed verdicts on features, over all wafers."""
        return sum(len(wafer.changes) for wafer in self.wafers)

    @property
    def summary(self) -> str:
        """Summary in one sentence."""
        turned = sum(wafer.before != wafer.after for wafer in self.wafers)
        n_verdicts = self.n_changes + sum(wafer.n_same for wafer in self.wafers)
        verdicts = _changing(self.n_changes, n_verdicts, "verdict", "changes", "change")
        wafers = _changing(turned, len(self.wafers), "wafer", "gets another word", "get another word")
        not_judged = f", {_count(len(self.not_tried), 'dataset')} not judged" if self.not_tried else ""
        return f"{verdicts[:1].upper()}{verdicts[1:]}; {wafers}{not_judged}."


def _changing(n: int, total: int, noun: str, one: str, many: str) -> str:
    return f"{n} of {_count(total, noun)} {one if n == 1 else many}" if n else f"no {noun} of {total} {one}"


def _count(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"
