"""Contents of a report: its selectable parts and its printed sections."""

from __future__ import annotations

import zoneinfo
from dataclasses import dataclass
from datetime import UTC, tzinfo
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
    "dies",
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
    "dies": "Dies",
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


PAGE, PRINTED, DIGITAL, TRANSFER = ".html", ".pdf", ".xml", ".dfq"
"""Endings of the files that a report may be written to; the last two have the results alone, for other programs."""
Contents = dict[Part, Holds]
Pairs = tuple[tuple[str, str], ...]


Paper = Literal["A4", "letter"]
Language = Literal["en", "de"]
LANGUAGES: dict[Language, str] = {"en": "English", "de": "Deutsch"}


class ReportOrder(Spec, frozen=True, kw_only=True):
    """Selection of a report's parts, its number, the customer, the size of its paper and its language.

    Without a title the dataset's name is used, without a number that name with the day of the scan, and without a
    language that of the laboratory.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    title: str = ""
    number: str = ""
    customer: str = ""
    paper: Paper = "A4"
    language: Language | None = None
    parts: tuple[Part, ...] = PARTS


class Laboratory(Spec, frozen=True, kw_only=True):
    """The laboratory that reports: the file ``laboratory.toml`` of a data folder.

    accreditation: such as a body and its number; logo: name of a PNG or JPEG file in the data folder; zone: IANA name
    of its time zone, such as ``Europe/Berlin``, for the times in its reports; country: its two
    letters by ISO 3166-1, and its e-mail address, for results as XML.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    name: str
    address: str = ""
    accreditation: str = ""
    logo: str = ""
    language: Language = "en"
    zone: str = "UTC"
    country: str = ""
    email: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            zone_of(self.zone)
        except (zoneinfo.ZoneInfoNotFoundError, ValueError):
            self.refuse("zone", "the name of a time zone that this machine knows, such as 'Europe/Berlin'")


def zone_of(name: str) -> tzinfo:
    """Return a time zone by its IANA name; UTC needs no data of the machine."""
    return UTC if name == "UTC" else zoneinfo.ZoneInfo(name)


@dataclass(frozen=True, slots=True)
class Table:
    """Header and rows of plain text; `right` has an 'n' for a column of numbers, a 'w' for one without word breaks.

    drawn: generated SVG drawings, one for each row, in a last column with the head `drawn_head`.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: str = ""
    drawn: tuple[str, ...] = ()
    drawn_head: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture as a data URL or a generated SVG drawing, with its caption; small ones are placed side by side."""

    url: str
    caption: str
    small: bool = False
    svg: str = ""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One result in full: main value, its place and the profile across it, further values, budget.

    picture, profile: generated SVG drawings. missing: contributions not in its uncertainty; notes: on its value.
    word: verdict on it.
    """

    number: str
    title: str
    below: str
    value: str
    picture: str = ""
    profile: str = ""
    pairs: Pairs = ()
    budget: Table | None = None
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    word: str = ""


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
    """A complete report, as text and pictures; number: repeated on every page; scope: what it holds for.

    language: of the page; the texts are English until it is written. names: texts that are not translated.
    """

    title: str
    below: str
    simulated: bool
    facts: Pairs
    sections: tuple[ReportSection, ...]
    number: str = ""
    scope: str = ""
    letterhead: Letterhead | None = None
    paper: Paper = "A4"
    language: Language = "en"
    names: frozenset[str] = frozenset()
