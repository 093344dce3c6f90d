"""User annotations of a surface: saved views, and judgements on its results and features."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import ClassVar, Literal

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.job.verdict import WaferVerdict
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.spec import Positive, Spec

Verdict = Literal["open", "accepted", "rejected"]
Place = tuple[float, float, float]


class SavedView(Spec, frozen=True, kw_only=True):
    """A saved view of the surface: camera position and target in mm of the scene, and display settings.

    number: its position in the list, from 1. look, colour_by and colours are the page's names for these settings.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    number: int = 0
    name: str = ""
    position_mm: Place
    look_at_mm: Place
    look: str = "surface"
    colour_by: str = "height"
    colours: str = "mako"
    range_um: tuple[float, float] | None = None
    exaggeration: Positive = 3.0
    hillshade: float = 0.8
    all_in_focus: float = 0.0
    show: int = 0
    levelling: Levelling = Levelling()


class Judgement(Spec, frozen=True, kw_only=True):
    """A user's judgement on an item under review; `key` names the item, ``result 3`` or ``feature pad``."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    key: str
    verdict: Verdict = "open"
    note: str = ""


def key_of_result(number: int) -> str:
    """Return the key of the result with a number."""
    return f"result {number}"


def keys_of_features(verdict: WaferVerdict | None) -> tuple[str, ...]:
    """Return the keys of the features of a verdict, in its order; repeated names are numbered."""
    seen: Counter[str] = Counter()
    keys: list[str] = []
    for name in (item.name for item in (verdict.items if verdict is not None else ())):
        seen[name] += 1
        keys.append(f"feature {name}" if seen[name] == 1 else f"feature {name} ({seen[name]})")
    return tuple(keys)


def keys_under_review(verdict: WaferVerdict | None, findings: Iterable[AnyResult]) -> tuple[str, ...]:
    """Return the keys of everything under review: the features of the verdict and the stored results."""
    return (*keys_of_features(verdict), *(key_of_result(finding.number) for finding in findings))


class Notebook(Spec, frozen=True, kw_only=True):
    """The file ``notebook.json`` of one reconstruction."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    views: tuple[SavedView, ...] = ()
    judgements: tuple[Judgement, ...] = ()

    def view(self, number: int) -> SavedView | None:
        """Return the saved view with a number, or None."""
        return next((view for view in self.views if view.number == number), None)

    def judgement(self, key: str) -> Judgement:
        """Return the judgement on an item; open if there is none."""
        return next((j for j in self.judgements if j.key == key), Judgement(key=key))

    def judged(self, keys: Iterable[str]) -> int:
        """Return how many of the keys are accepted or rejected."""
        return sum(self.judgement(key).verdict != "open" for key in keys)
