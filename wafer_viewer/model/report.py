"""What a report is made of: its parts as one orders them, and its contents as they are printed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec

Part = Literal[
    "verdict",
    "results",
    "defects",
    "profiles",
    "gauge",
    "pictures",
    "surface",
    "plan",
    "recipe",
    "calibration",
    "warnings",
    "checksums",
    "signatures",
]
PARTS: tuple[Part, ...] = get_args(Part)
PART_TITLES: dict[Part, str] = {
    "verdict": "Verdict",
    "results": "Results",
    "defects": "Defects",
    "profiles": "Profiles",
    "gauge": "Gauge checks",
    "pictures": "Pictures",
    "surface": "Surface",
    "plan": "Plan",
    "recipe": "Recipe",
    "calibration": "Calibration",
    "warnings": "Warnings",
    "checksums": "Checksums",
    "signatures": "Signatures",
}


@dataclass(frozen=True, slots=True)
class Holds:
    """What a part would hold, in a few words; `nothing`: it has nothing to show, and the words say why."""

    words: str
    nothing: bool = False


Contents = dict[Part, Holds]
Pairs = tuple[tuple[str, str], ...]


class ReportOrder(Spec, frozen=True, kw_only=True):
    """Contentsto a report; without a title the dataset's name stands over it."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    title: str = ""
    parts: tuple[Part, ...] = PARTS


@dataclass(frozen=True, slots=True)
class Table:
    """Heads and rows of plain text; `right` has an 'n' for a column of numbers, a 'w' for one that breaks no word."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture as a data URL, or a drawing as SVG of our own, with its caption; small ones stand side by side."""

    url: str
    caption: str
    small: bool = False
    svg: str = ""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One result with all it holds: its main number, the place it was measured at, the others, the budget.

    missing: what its uncertainty leaves out.
    """

    number: str
    title: str
    below: str
    value: str
    picture: str = ""
    pairs: Pairs = ()
    budget: Table | None = None
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportSection:
    """A head, and what stands under it: names with values, a table, pictures, sentences. `empty`: why nothing does.

    word: in large type before all else, with the sentence beside it; lines: what is signed.
    """

    title: str
    pairs: Pairs = ()
    table: Table | None = None
    figures: tuple[Figure, ...] = ()
    sheets: tuple[Sheet, ...] = ()
    sentences: tuple[str, ...] = ()
    word: Word | None = None
    beside: str = ""
    lines: tuple[str, ...] = ()
    empty: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether nothing stands under the head."""
        held = self.pairs, self.figures, self.sheets, self.sentences, self.word, self.lines
        return not (any(held) or (self.table and self.table.rows))


@dataclass(frozen=True, slots=True)
class Report:
    """Everything on it, as text and pictures."""

    title: str
    below: str
    simulated: bool
    facts: Pairs
    sections: tuple[ReportSection, ...]
