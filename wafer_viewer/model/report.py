"""What a report is made of: its parts as one orders them, and its contents as they are printed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec

Part = Literal["results", "pictures", "surface", "plan", "recipe", "calibration", "warnings"]
PARTS: tuple[Part, ...] = get_args(Part)
PART_TITLES: dict[Part, str] = {
    "results": "Results",
    "pictures": "Pictures",
    "surface": "Surface",
    "plan": "Plan",
    "recipe": "Recipe",
    "calibration": "Calibration",
    "warnings": "Warnings",
}


@dataclass(frozen=True, slots=True)
class Holds:
    """What a part would hold, in a few words; `nothing`: it has nothing to show, and the words say why."""

    words: str
    nothing: bool = False


Contents = dict[Part, Holds]


class ReportOrder(Spec, frozen=True, kw_only=True):
    """What goes into a report; without a title the dataset's name stands over it."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    title: str = ""
    parts: tuple[Part, ...] = PARTS


@dataclass(frozen=True, slots=True)
class Table:
    """Heads and rows of plain text; `right` has an 'n' for every column that holds numbers."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture as a data URL, with its caption; small ones stand side by side."""

    url: str
    caption: str
    small: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """A head, and what stands under it: names with values, a table, pictures, sentences. `empty`: why nothing does."""

    title: str
    pairs: tuple[tuple[str, str], ...] = ()
    table: Table | None = None
    figures: tuple[Figure, ...] = ()
    sentences: tuple[str, ...] = ()
    empty: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether nothing stands under the head."""
        return not (self.pairs or (self.table and self.table.rows) or self.figures or self.sentences)

    @property
    def summary(self) -> str:
        """What stands under it, in a few words."""
        counts = (
            (len(self.table.rows) if self.table else 0, "row"),
            (len(self.figures), "picture"),
            (len(self.pairs), "number"),
            (len(self.sentences), "sentence"),
        )
        said = [f"{n} {word}{'' if n == 1 else 's'}" for n, word in counts if n]
        return ", ".join(said) or self.empty


@dataclass(frozen=True, slots=True)
class Report:
    """Everything on it, as text and pictures."""

    title: str
    below: str
    simulated: bool
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
