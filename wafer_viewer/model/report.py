"""Contents of a report: its selectable parts and its printed sections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.quantity import Word
from wafer_viewer.model.spec import Spec

Part = Literal[
    "verdict",
    "signatures",
    "warnings",
    "surface",
    "features",
    "results",
    "defects",
    "profiles",
    "gauge",
    "pictures",
    "plan",
    "recipe",
    "calibration",
    "audit",
    "checksums",
]
PARTS: tuple[Part, ...] = get_args(Part)
PART_TITLES: dict[Part, str] = {
    "verdict": "Verdict",
    "signatures": "Signatures",
    "warnings": "Warnings",
    "surface": "Surface",
    "features": "Features",
    "results": "Results",
    "defects": "Defects",
    "profiles": "Profiles",
    "gauge": "Gauge checks",
    "pictures": "Pictures",
    "plan": "Plan",
    "recipe": "Recipe",
    "calibration": "Traceability",
    "audit": "Audit log",
    "checksums": "Checksums",
}


@dataclass(frozen=True, slots=True)
class Holds:
    """Short description of a part's contents; `nothing`: the part is empty, and `words` give the reason."""

    words: str
    nothing: bool = False


PAGE, PRINTED = ".html", ".pdf"
"""Endings of the files that a report may be written to."""
Contents = dict[Part, Holds]
Pairs = tuple[tuple[str, str], ...]


Paper = Literal["A4", "letter"]


class ReportOrder(Spec, frozen=True, kw_only=True):
    """Selection of a report's parts, its number, the customer and the size of its paper.

    Without a title the dataset's name is used, without a number that name with the day of the scan.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    title: str = ""
    number: str = ""
    customer: str = ""
    paper: Paper = "A4"
    parts: tuple[Part, ...] = PARTS


class Laboratory(Spec, frozen=True, kw_only=True):
    """The laboratory that reports: the file ``laboratory.toml`` of a data folder.

    accreditation: such as a body and its number; logo: name of a PNG or JPEG file in the data folder.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    name: str
    address: str = ""
    accreditation: str = ""
    logo: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Header and rows of plain text; `right` has an 'n' for a column of numbers, a 'w' for one without word breaks.

    drawn: generated SVG drawings, one for each row, in a last column that has a head only.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: str = ""
    drawn: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture as a data URL or a generated SVG drawing, with its caption; small ones are placed side by side."""

    url: str
    caption: str
    small: bool = False
    svg: str = ""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One result in full: main value, region it was measured on, further values, budget.

    missing: contributions not in its uncertainty. svg: generated drawing of its profile.
    """

    number: str
    title: str
    below: str
    value: str
    picture: str = ""
    svg: str = ""
    pairs: Pairs = ()
    budget: Table | None = None
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportSection:
    """A section with its title: named values, table, figures, sentences. `empty`: reason for an empty section.

    word: verdict in large type at the start, with the sentence `beside`; lines: signature lines.
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
        """True if the section has no contents."""
        held = self.pairs, self.figures, self.sheets, self.sentences, self.word, self.lines
        return not (any(held) or (self.table and self.table.rows))


@dataclass(frozen=True, slots=True)
class Letterhead:
    """Head of a laboratory: its name, further lines and its logo as a data URL."""

    name: str
    lines: tuple[str, ...] = ()
    logo: str = ""


@dataclass(frozen=True, slots=True)
class Report:
    """A complete report, as text and pictures; number: repeated on every page; scope: what it holds for."""

    title: str
    below: str
    simulated: bool
    facts: Pairs
    sections: tuple[ReportSection, ...]
    number: str = ""
    scope: str = ""
    letterhead: Letterhead | None = None
    paper: Paper = "A4"
