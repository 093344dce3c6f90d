"""Reports in other languages: the texts of a report, translated by one table, ``report_texts.toml``."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from markupsafe import Markup

from wafer_viewer.model.report import Language, Report, ReportSection

TABLE = Path(__file__).with_name("report_texts.toml")
"""A table for each language: English texts, with {} for what is put in, and their translations in the same order."""
DECIMAL_SIGNS: dict[Language, str] = {"de": ","}
SEPARATORS = (" → ", " · ", ". ", "; ", ": ", ", ", " ± ")
"""Marks between parts of a text that are translated one by one, the strongest first."""
_AS_THEY_ARE = frozenset({"url", "logo", "right", "word", "paper", "language", "number", "names", "letterhead"})
_DRAWN = frozenset({"svg", "picture", "profile", "drawn"})
_DECIMAL = re.compile(r"(?<![\w.-])(\d[\d\u202f]*)\.(\d+)(?![\w]|\.\d)")
_TEXT = re.compile(r"(<text[^>]*>)([^<]+)(</text>)")
_LETTERS = re.compile(r"[A-Za-z]{2}")
_SAME = re.compile(
    r"[SRPV]\d*[a-zS]{1,2}m?\d?|En|FLT[a-z]|SHA-256|[0-9a-f]{64}|nl|pl|1/mm²?"
    r"|[\d .+−×\u202f-]+(deg|mrad|nl|pl|mm[²³]?|px|[kMGT]B)"
    r"|\d{4}-\d\d-\d\d[\d :+UTC-]*|[\w.]+\.\w{3,5}|Wafer Viewer [\w.]+"
)
"""Symbols of parameters, checksums, angles, dates, names of files."""
R = TypeVar("R")


def translated(report: Report) -> Report:
    """Return a report in its own language. Names and texts of people stay as they are."""
    return report if report.language == "en" else Translation(report.language, report.names).of(report)


def phrase(language: Language, text: str) -> str:
    """Return a fixed text of the page in a language."""
    return text if language == "en" else Translation(language).text(text)


@dataclasses.dataclass(frozen=True, slots=True)
class Translation:
    """Translation into one language. names: texts that stay as they are; unknown: parts without a translation."""

    language: Language
    names: frozenset[str] = frozenset()
    unknown: set[str] = dataclasses.field(default_factory=set[str])

    def of(self, item: R, field: str = "") -> R:
        """Return a text, or a part of a report with its texts, translated."""
        if field in _AS_THEY_ARE or item is None:
            return item
        if isinstance(item, str):
            return cast(R, self.drawing(item) if field in _DRAWN else self.text(item))
        if isinstance(item, tuple):
            return cast(R, tuple(self.of(part, field) for part in cast(tuple[Any, ...], item)))
        if dataclasses.is_dataclass(item):
            put = {one.name: self._field(item, one.name) for one in dataclasses.fields(item)}
            return cast(R, dataclasses.replace(cast(Any, item), **put))
        return item

    def _field(self, item: object, field: str) -> Any:
        """Return a field translated; a heading is translated also where somebody gave a name like it."""
        heading = field in ("heads", "drawn_head") or (field == "title" and isinstance(item, ReportSection))
        return (dataclasses.replace(self, names=frozenset()) if heading else self).of(getattr(item, field), field)

    def text(self, text: str) -> str:
        """Return a text translated whole, by a pattern, or part by part."""
        found = self._whole(text)
        if found is not None:
            return found
        for mark in SEPARATORS:
            if mark in text:
                return mark.join(map(self.text, text.split(mark)))
        self.unknown.add(text)
        return self._numbers(text)

    def drawing(self, svg: str) -> str:
        """Return a generated drawing with its texts translated."""

        def put(found: re.Match[str]) -> str:
            opened, words, closed = map(Markup, found.groups())
            return Markup("{}{}{}").format(opened, self.text(words.unescape()), closed)

        return Markup(_TEXT.sub(put, str(svg)))

    def _whole(self, text: str) -> str | None:
        if text in self.names:
            return text
        bare = text.strip().rstrip(".")
        exact, patterns = _table(self.language)
        lead, tail = text[: len(text) - len(text.lstrip())], text[len(text.rstrip().rstrip(".")) :]
        for written in (bare, f"{bare[:1].swapcase()}{bare[1:]}"):
            if written in exact:
                return f"{lead}{exact[written]}{tail}"
        if not _LETTERS.search(bare) or _SAME.fullmatch(bare):
            return self._numbers(text)
        for pattern, words in patterns:
            if found := pattern.fullmatch(bare):
                return f"{lead}{words.format(*map(self.text, found.groups()))}{tail}"
        return None

    def _numbers(self, text: str) -> str:
        return _DECIMAL.sub(rf"\1{DECIMAL_SIGNS[self.language]}\2", text)


@cache
def _table(language: Language) -> tuple[Mapping[str, str], tuple[tuple[re.Pattern[str], str], ...]]:
    """Return the texts without and those with something put in, of which the longest are tried first."""
    table: dict[str, str] = tomllib.loads(TABLE.read_text("utf-8"))[language]
    texts = {text.rstrip("."): words.rstrip(".") for text, words in table.items()}
    filled = sorted((text for text in texts if "{" in text), key=lambda text: -len(text))
    patterns = tuple((_pattern(text), texts[text]) for text in filled)
    return {text: words for text, words in texts.items() if "{" not in text}, patterns


def _pattern(text: str) -> re.Pattern[str]:
    """Return the pattern of a text with something put in, for either kind of space."""
    parts = re.split(r"(\{n?\})", text)
    return re.compile("".join(_PUT_IN.get(part) or re.escape(part).replace("\\ ", "[ \u202f]") for part in parts))


_PUT_IN = {"{}": "(.+?)", "{n}": "([<\\d\u202f.,+\u2212-]+)"}
"""What stands in a text for {}, and for {n}."""
