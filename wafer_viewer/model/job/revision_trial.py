"""A job tried on wafers that were measured before: which verdicts would change by it, and why."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.spec import Spec


class VerdictChange(Spec, frozen=True, kw_only=True):
    """A feature whose word changes. No word before: it was not judged; none after: it is not judged any more."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: str
    before: Word | None = None
    after: Word | None = None
    measured_before: Quantity | None = None
    measured_after: Quantity | None = None
    why: tuple[str, ...]


class TriedWafer(Spec, frozen=True, kw_only=True):
    """A wafer judged by the job, beside the word that it had.

    result: the reconstruction that was judged; n_same: how many features keep their word.
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
    """A dataset that could not be judged by the job, and why."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    dataset: str
    why: str


class Trial(Spec, frozen=True, kw_only=True):
    """What a job comes to on stored datasets."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    job: str
    wafers: tuple[TriedWafer, ...] = ()
    not_tried: tuple[NotTried, ...] = ()

    @property
    def n_changes(self) -> int:
        """How many verdicts on features change, over all wafers."""
        return sum(len(wafer.changes) for wafer in self.wafers)

    @property
    def summary(self) -> str:
        """All of it in one sentence."""
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
