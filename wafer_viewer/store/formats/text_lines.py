"""Text files of numbers: encoding, header, separator, decimal comma, and words for gaps."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.store.formats.reader_support import ReadOptions

GAPS = frozenset(
    (
        *("", "-", "--", "---", "bad", "badpixel", "bad pixel", "nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan"),
        *("-1.#ind", "na", "n/a", "#n/a", "n.a.", "nil", "null", "none", "nodata", "no data", "no_data", "invalid"),
        *("missing", "void", "empty", "masked", "lost", "inf", "-inf", "+inf"),
    )
)
"""Words for an unmeasured height, in lower case; so is any run of stars or question marks."""
_DELIMITERS = ("\t", ";", ",", " ")
"""Separators in the order in which they are tried."""
_COMMENTS = ("#", "%", "//")
_LARGEST_HEADER = 16_000_000
_CHARACTERS_AT_A_TIME = 16_000_000
_SAMPLE = 200
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:e[-+]?\d+)?", re.IGNORECASE)
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Header lines of a text file, and the form of the lines of numbers below."""

    path: Path
    encoding: str
    header: tuple[str, ...]
    sample: tuple[str, ...]
    """First lines of numbers."""
    delimiter: str | None
    """None: blanks."""
    has_decimal_comma: bool
    ends_with_delimiter: bool

    @property
    def n_columns(self) -> int:
        """Values in the first line of numbers."""
        return len(self.cells(self.sample[0]))

    @property
    def comments(self) -> Iterator[str]:
        """Header lines without their comment marks."""
        return (line.lstrip("#%/ ").strip() for line in self.header)

    def cells(self, line: str) -> list[str]:
        """Return the values of a line as texts."""
        return _split(self._trimmed(line), self.delimiter)

    def numbers(self, lines: list[str], columns: list[int] | None, options: ReadOptions) -> NDArray[np.float64]:
        """Return lines as numbers [line, column], NaN for gaps; of all columns, or of those given.

        Raises DatasetError for other words, and for lines of different lengths.
        """
        n_columns = self.n_columns if columns is None else len(columns)
        lines = [self._trimmed(line) for line in lines if line.strip() and not line.lstrip().startswith(_COMMENTS)]
        if self.has_decimal_comma:
            lines = [line.replace(",", ".") for line in lines]
        if not lines:
            return np.empty((0, n_columns))
        with suppress(ValueError):
            found = np.loadtxt(lines, delimiter=self.delimiter, usecols=columns, ndmin=2, comments=None, quotechar='"')
            if found.shape[1] == n_columns:
                return found
        rows = [_split(line, self.delimiter) for line in lines]
        return np.array([self._row(row, columns, options) for row in rows]).reshape(len(rows), n_columns)

    def blocks(self, columns: list[int] | None, options: ReadOptions) -> Iterator[NDArray[np.float64]]:
        """Yield the numbers of the file, some megabytes of text at a time."""
        n_blocks = 1 + self.path.stat().st_size // _CHARACTERS_AT_A_TIME
        with self.path.open(encoding=self.encoding, errors="replace") as file:
            for _ in islice(file, len(self.header)):
                pass
            for _ in options.watch(list(range(n_blocks))):
                yield self.numbers(file.readlines(_CHARACTERS_AT_A_TIME), columns, options)

    def _row(self, cells: list[str], columns: list[int] | None, options: ReadOptions) -> list[float]:
        wanted = range(self.n_columns) if columns is None else columns
        if len(cells) <= max(wanted) or (columns is None and len(cells) != self.n_columns):
            raise options.refuse(
                f"has lines of {self.n_columns} and of {len(cells)} values: make them alike, or take the others out."
            )
        try:
            return [np.nan if is_gap(cells[column]) else float(cells[column]) for column in wanted]
        except ValueError as fault:
            word = next(cells[column] for column in wanted if not (is_gap(cells[column]) or is_number(cells[column])))
            raise options.refuse(
                f"has lines without numbers, such as '{word[:20]}', which is no word for a gap: take them out."
            ) from fault

    def _trimmed(self, line: str) -> str:
        """Return a line without its line break, and the delimiter before it where all lines have one."""
        line = line.rstrip("\r\n")
        return line.removesuffix(self.delimiter or "") if self.ends_with_delimiter else line


def text_layout(path: Path, options: ReadOptions, is_names: Callable[[str], bool]) -> TextLayout:
    """Return the layout of a text file; numbers begin below a line of column names, at the latest.

    Raises DatasetError if there is no line of numbers.
    """
    encoding = _encoding(path)
    header, n_characters = list[str](), 0
    with path.open(encoding=encoding, errors="replace") as file:
        while n_characters < _LARGEST_HEADER and (line := file.readline(_LARGEST_HEADER)):
            n_characters += len(line)
            is_comment = not line.strip() or line.lstrip().startswith(_COMMENTS)
            delimiter = None if is_comment else _delimiter(line)
            if not delimiter and not is_comment and header and is_names(header[-1]):
                delimiter = next(d for d in _DELIMITERS if d in header[-1])
            if delimiter:
                sample = (line, *islice((more for more in file if more.strip()), _SAMPLE))
                commas = delimiter != "," and any(_has_decimal_comma(more, delimiter) for more in sample)
                ends = delimiter != " " and all(more.rstrip("\r\n").endswith(delimiter) for more in sample)
                form = delimiter.strip(" ") or None, commas, ends
                return TextLayout(path, encoding, tuple(header), sample, *form)
            header.append(line)
    raise options.refuse("holds no points and no heights: give lines of numbers, such as the columns x, y and z.")


def is_gap(cell: str) -> bool:
    """Return whether a text stands for an unmeasured height."""
    return cell.lower() in GAPS or not cell.strip("*?")


def is_number(cell: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _delimiter(line: str) -> str:
    """Return the delimiter of a line of numbers and gaps; empty if it is none."""
    for delimiter in (d for d in _DELIMITERS if d in line.strip(" ")):
        has_commas = delimiter != "," and _has_decimal_comma(line, delimiter)
        cells = [cell.replace(",", ".") if has_commas else cell for cell in _split(line, delimiter)]
        gaps, numbers = [is_gap(cell) for cell in cells], [is_number(cell) for cell in cells]
        if len(cells) > 1 and all(map(max, gaps, numbers)) and not all(gaps):
            return delimiter
    return ""


def _has_decimal_comma(line: str, delimiter: str) -> bool:
    return any(map(_DECIMAL_COMMA.fullmatch, _split(line, delimiter)))


def _split(line: str, delimiter: str | None) -> list[str]:
    cells = line.strip("\r\n").split(delimiter) if delimiter and delimiter != " " else line.split()
    return [cell.strip().strip('"').strip() for cell in cells]


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(100_000)
    for mark, encoding in _BYTE_ORDER_MARKS:
        if head.startswith(mark):
            return encoding
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"
