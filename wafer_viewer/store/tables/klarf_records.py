"""Records of KLARF files: the flat syntax of versions 1.0 to 1.2 and the nested one of 1.8, under the keywords of 1.2.

Keywords and columns may be in any case. Line breaks count as blanks, and in the nested syntax commas too.

Flat: a record goes from its keyword to its semicolon. There may be several defect lists (one for each image or
inspection test), each with the last preceding column specification. Rows of a list may each end with a semicolon.

Nested: records hold fields, lists and records. A field of a wafer precedes that of its lot. Lengths are in nm.
"""

from __future__ import annotations

import codecs
import itertools
import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from wafer_viewer.model.errors import DatasetError

Words = tuple[str, ...]
FLAT_VERSIONS, NESTED_VERSIONS = ("1.0", "1.1", "1.2"), ("1.8",)
IMAGE_WORDS = 3
"""Greatest number of words per image of a defect, behind it or in the lines after it."""
LISTS = ("defectlist", "sampletestplan", "classlookup", "summarylist")
"""Records whose rows may each end with a semicolon."""
_NM_PER_MM = 1e6
_NESTED = re.compile(r"\s*Record\s+FileRecord\b", re.IGNORECASE)
_END = re.compile(r"(?:^|(?<=[\s;}]))EndOfFile\b[ \t]*;?", re.IGNORECASE)
_OTHER_FILE = re.compile(r"FileVersion|FileRecord", re.IGNORECASE)
_UNCLOSED = re.compile(r'^[^"\n]*"(?:[^"\n]*"[^"\n]*")*[^"\n]*$', re.MULTILINE)
_KNOWN = (
    *("FileTimestamp", "InspectionStationID", "SampleType", "ResultTimestamp", "TiffSpec", "TiffFileName", "LotID"),
    *("SampleSize", "DeviceID", "SetupID", "StepID", "SampleOrientationMarkType", "OrientationMarkLocation"),
    *("DiePitch", "DieOrigin", "WaferID", "Slot", "SampleCenterLocation", "OrientationInstructions"),
    *("CoordinatesMirrored", "ClassLookup", "InspectionTest", "SampleTestPlan", "InspectedAreaOrigin", "AreaPerTest"),
    *("DefectRecordSpec", "DefectList", "SummarySpec", "SummaryList", "Units"),
)
"""Keywords that end a record before them which has no semicolon."""
_NEXT_RECORD = re.compile(rf"\n(?=[ \t]*(?:{'|'.join(_KNOWN)})\b)", re.IGNORECASE)
_NO_END = re.compile(rf'\s*\w+(?:"[^"\n]*"|[^"\n])*?\s({"|".join(_KNOWN)})\b', re.IGNORECASE)
_PART = re.compile(r'(?:[^;"]+|"[^"\n]*")+')
_TOKEN = re.compile(r'"([^"]*)"|([^\s"]+)')
_NESTED_TOKEN = re.compile(r'"([^"\n]*)"|([{};,])|([^\s"{};,]+)')


@dataclass(frozen=True, slots=True)
class Record:
    """One record, from its keyword to its semicolon: the words of each line, without the keyword."""

    lines: tuple[Words, ...]

    @property
    def words(self) -> Words:
        """All words in order."""
        return tuple(word for line in self.lines for word in line)


@dataclass(frozen=True, slots=True)
class DefectList:
    """List of defects: its columns, the words of each defect, and those of each of its images.

    tiff_file: name of the file that image numbers refer to.
    """

    columns: Words
    rows: tuple[Words, ...]
    images: tuple[tuple[Words, ...], ...] = ()
    tiff_file: str = ""


@dataclass(frozen=True, slots=True)
class Records:
    """Records of a file by keyword in lower case, in order; repeated ones of all inspection tests together.

    counted: True if the file states the number of its defects.
    """

    by_keyword: dict[str, tuple[Record, ...]]
    lists: tuple[DefectList, ...]
    counted: bool
    notes: tuple[str, ...] = ()

    def __contains__(self, keyword: str) -> bool:
        return keyword.lower() in self.by_keyword

    def __getitem__(self, keyword: str) -> Record:
        """Return the last record of a keyword."""
        return self.by_keyword[keyword.lower()][-1]

    def all(self, keyword: str) -> tuple[Record, ...]:
        """Return all records of a keyword."""
        return self.by_keyword.get(keyword.lower(), ())


def read_records(content: bytes) -> Records:
    """Return all records of a file.

    Raises DatasetError for another format or version, a truncated or damaged file, or several wafers.
    """
    text, notes = _text(content)
    nested = _NESTED.match(text) is not None
    if not nested and not text.lstrip().lower().startswith("fileversion"):
        raise DatasetError("it is not a KLARF file: it does not begin with FileVersion or Record FileRecord.")
    body, left_out = _until_end(text)
    if (unclosed := _UNCLOSED.search(body)) is not None:
        line = body.count("\n", 0, unclosed.start()) + 1
        raise DatasetError(f"line {line} has a quotation mark that is not closed: close it.")
    found = _nested_records(body) if nested else _flat_records(body)
    if len(found.all("WaferID")) > 1:
        raise DatasetError("it holds several wafers: export one wafer to a file.")
    _require_version(found, NESTED_VERSIONS if nested else FLAT_VERSIONS)
    return replace(found, notes=notes + found.notes + left_out)


def column_names(spec: Record) -> Words:
    """Return the columns of a specification in capitals. Raises DatasetError when they are not as many as it states."""
    stated, *names = spec.words
    if len(names) != parse_integer(stated):
        raise DatasetError(f"it names {len(names)} of {stated} columns: export it again.")
    return tuple(name.upper() for name in names)


def parse_integer(word: str) -> int:
    """Parse an integer, which some programs write as ``0.000``. Raises ValueError for any other word."""
    value = float(word)
    if not value.is_integer():
        raise ValueError(f"{word} is not a whole number")
    return int(value)


def _text(content: bytes) -> tuple[str, Words]:
    """Return the text with plain line feeds, and a note where it is not Unicode."""
    notes = Words()
    utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if utf_16 else "utf-8-sig")
    except UnicodeDecodeError as fault:
        if utf_16:
            raise DatasetError("it is cut off or damaged, its text is no UTF-16: copy or export it again.") from fault
        text = _western(content)
        notes = ("Its text is not UTF-8 and was read as Windows-1252: names with other letters may be wrong.",)
    return text.replace("\r\n", "\n").replace("\r", "\n"), notes


def _western(content: bytes) -> str:
    try:
        return content.decode("cp1252")
    except UnicodeDecodeError:  # five bytes are in Latin-1 alone
        return content.decode("latin-1")


def _until_end(text: str) -> tuple[str, Words]:
    """Return the text before EndOfFile, and a note on what follows it."""
    end = _END.search(text)
    if end is None:
        raise DatasetError("it is cut off, it has no EndOfFile: copy or export it again.")
    after = text[end.end() :].strip(" \t\n\f\v\0\x1a")
    if _OTHER_FILE.search(after):
        raise DatasetError("another file follows its EndOfFile: keep one wafer to a file.")
    return text[: end.start()], ("What follows EndOfFile was left out.",) if after else ()


def _require_version(found: Records, versions: Words) -> None:
    version = ".".join(found["FileVersion"].words[:2])
    if version not in versions:
        raise DatasetError(f"it is KLARF {version} and not one of {', '.join(versions)}: export it as 1.2.")


# ---------------------------------------------------------------------------------------------------------- flat syntax


def _flat_records(text: str) -> Records:
    found: dict[str, list[Record]] = defaultdict(list)
    lists: list[tuple[Words, list[Words], str]] = []
    pieces = [[piece for piece in _NEXT_RECORD.split(part) if piece.strip()] for part in _PART.findall(text)]
    keyword = ""
    for piece in itertools.chain.from_iterable(pieces):
        lines = tuple(words for line in piece.split("\n") if (words := _words(line)))
        first = lines[0][0]
        if first[:1].isalpha():
            keyword = first.lower()
            _require_end(keyword, piece)
            found[keyword].append(Record((lines[0][1:], *lines[1:])))
            if keyword == "defectlist":
                columns = column_names(found["defectrecordspec"][-1]) if found["defectrecordspec"] else ()
                tiff_file = " ".join(found["tifffilename"][-1].words) if found["tifffilename"] else ""
                lists.append((columns, [*filter(None, found[keyword][-1].lines), ()], tiff_file))
        elif keyword in LISTS:  # a further row of a list whose rows each end with a semicolon
            found[keyword][-1] = Record(found[keyword][-1].lines + lines)
            if keyword == "defectlist":
                lists[-1][1].extend((*lines, ()))
        else:
            raise DatasetError(f"it has {first!r} where the keyword of a record is expected: export it again.")
    counted = "summarylist" in found
    by_keyword = {name: tuple(records) for name, records in found.items() if records}
    defects = tuple(_defect_list(columns, lines, tiff_file, counted) for columns, lines, tiff_file in lists)
    open_end = any(len(records) > 1 for records in pieces)
    notes = ("A record has no semicolon and was taken to end before the next keyword.",) if open_end else ()
    if any(len(row) < len(listed.columns) for listed in defects for row in listed.rows):
        notes += ("Its defects have no IMAGELIST: a number that is lost from a row may not be detected.",)
    return Records(by_keyword, defects, counted, notes)


def _require_end(keyword: str, piece: str) -> None:
    """Raise DatasetError when another record begins in the line of a keyword."""
    if keyword not in ("defectrecordspec", "summaryspec") and (lost := _NO_END.match(piece)) is not None:
        raise DatasetError(f"a semicolon is missing before {lost[1]}: export it again.")


def _words(line: str) -> Words:
    if '"' not in line:
        return tuple(line.split())
    return tuple(quoted or plain for quoted, plain in _TOKEN.findall(line))


def _defect_list(columns: Words, lines: list[Words], tiff_file: str, counted: bool) -> DefectList:
    """Return a list of defects; the list of images, the last column, may be left out of all of them.

    counted: True if a summary reveals a defect that is taken for the images of the one above.
    """
    try:
        rows = _complete_rows(columns, lines, counted)
    except DatasetError:
        if columns[-1:] == ("IMAGELIST",):
            with suppress(DatasetError):
                rows = _complete_rows(columns[:-1], lines, counted)
                return DefectList(columns, tuple(row[: len(columns) - 1] for row in rows))
        raise
    images = tuple(_images_of(columns, row) for row in rows)
    return DefectList(columns, tuple(row[: len(columns)] for row in rows), images, tiff_file)


def _images_of(columns: Words, row: Words) -> tuple[Words, ...]:
    """Return the words of each image of a row, which follow the list's own count; some files leave it out."""
    if columns[-1:] != ("IMAGELIST",):
        return ()
    n, words = _n_images(columns, row), row[len(columns) :]
    return _in_parts(row[len(columns) - 1 :] if len(words) == 2 * n - 1 else words, n)


def _in_parts(words: Words, n: int) -> tuple[Words, ...]:
    """Return words in n equal parts, none if they cannot be divided."""
    if not n or not words or len(words) % n:
        return ()
    step = len(words) // n
    return tuple(words[k : k + step] for k in range(0, len(words), step))


def _complete_rows(columns: Words, lines: list[Words], counted: bool) -> list[Words]:
    """Return the words of each defect and of its images behind them.

    An empty line is the end of a row, other line breaks count as blanks.
    """
    rows: list[Words] = []
    pending: Words = ()
    n_image_words, begun = 0, 0
    for n, words in _numbered(lines):
        if not words:
            if pending:
                raise DatasetError(_wrong_length(begun, len(pending), len(columns)))
            n_image_words = 0
            continue
        is_complete = len(words) >= len(columns)
        if not pending and len(words) <= n_image_words:  # lines below a defect list its images
            if is_complete and not counted:
                raise DatasetError(f"line {n} of its defects may be a defect or images, and no summary counts them.")
            n_image_words -= len(words)
            rows[-1] += words
            continue
        begun = begun if pending else n
        joined = pending + words
        if pending and is_complete:
            raise DatasetError(_wrong_length(begun, len(pending), len(columns)))
        pending = joined if len(joined) < len(columns) else ()
        if not pending:
            n_image_words = IMAGE_WORDS * _n_images(columns, joined) + len(columns) - len(joined)
            if n_image_words < 0:
                raise DatasetError(_wrong_length(begun, len(joined), len(columns)))
            rows.append(joined)
    return rows


def _numbered(lines: list[Words]) -> Iterator[tuple[int, Words]]:
    """Yield the lines with their numbers; ends of rows do not count."""
    n = 0
    for words in lines:
        n += bool(words)
        yield n, words


def _n_images(columns: Words, words: Words) -> int:
    """Return the number of images of a defect, with which the list of images begins too."""
    values = dict(zip(columns, words, strict=False))
    counts = {parse_integer(values[name]) for name in ("IMAGECOUNT", "IMAGELIST") if name in values}
    if len(counts) > 1:
        raise DatasetError(f"its defect {words[0]} has another IMAGECOUNT than images: export it again.")
    return counts.pop() if counts else 0


def _wrong_length(line: int, n_words: int, n_columns: int) -> str:
    return f"line {line} of its defects has {n_words} of {n_columns} numbers: export it again."


# -------------------------------------------------------------------------------------------------------- nested syntax


class _Token(NamedTuple):
    """Word, quoted text or mark; a quoted mark is a text."""

    text: str
    is_mark: bool = False


_OPEN, _CLOSE, _COMMA, _SEMICOLON = (_Token(mark, True) for mark in "{},;")


@dataclass(slots=True)
class _Tokens:
    """Tokens of a nested text, from which parsers take what they expect."""

    rest: Iterator[_Token]

    def take(self) -> _Token:
        """Return the next token. Raises DatasetError at the end of the text."""
        token = next(self.rest, None)
        if token is None:
            raise DatasetError("a brace is not closed before its EndOfFile: export it again.")
        return token

    def expect(self, *words: str) -> None:
        """Take these words and marks. Raises DatasetError for others."""
        for word in words:
            if (found := self.take().text).lower() != word:
                raise DatasetError(f"it has {found!r} where {word.capitalize()!r} is expected: export it again.")

    def until_close(self) -> Words:
        """Return the words before the next closing brace, without commas."""
        words: list[str] = []
        while (token := self.take()) != _CLOSE:
            if token in (_OPEN, _SEMICOLON):
                raise DatasetError(f"it has {token.text!r} within a list of values: export it again.")
            if token != _COMMA:
                words.append(token.text)
        return tuple(words)


@dataclass(slots=True)
class _Found:
    """Records found so far with the depth at which they were found, and the lists of defects."""

    entries: dict[str, list[tuple[int, Record]]] = field(default_factory=lambda: defaultdict(list))
    lists: list[DefectList] = field(default_factory=list[DefectList])

    def add(self, depth: int, keyword: str, *lines: Words) -> None:
        """Add a record under its keyword in version 1.2."""
        self.entries[_FLAT_NAMES.get(keyword.lower(), keyword).lower()].append((depth, Record(lines)))

    def records(self) -> Records:
        """Return all records; of a keyword at several depths those at the greatest."""
        deepest = {name: max(depth for depth, _ in entries) for name, entries in self.entries.items()}
        kept = {
            name: tuple(record for depth, record in entries if depth == deepest[name])
            for name, entries in self.entries.items()
        }
        return Records({"units": (Record((("nm",),)),), **kept}, tuple(self.lists), counted=True)


_FLAT_NAMES = {
    "lotrecord": "LotID",
    "waferrecord": "WaferID",
    "testrecord": "InspectionTest",
    "recipeid": "SetupID",
    "slotnumber": "Slot",
    "classlookuplist": "ClassLookup",
    "sampletestplanlist": "SampleTestPlan",
}
"""Names of records, fields and lists of version 1.8 that version 1.2 names otherwise."""
_LIST_COLUMNS = {"classlookuplist": ("CLASSNUMBER", "CLASSNAME"), "sampletestplanlist": ("XINDEX", "YINDEX")}


def _nested_records(text: str) -> Records:
    tokens, found, depth = _Tokens(_tokens(text)), _Found(), 0
    for token in tokens.rest:
        word = token.text.lower()
        if token == _SEMICOLON:
            continue
        if token == _CLOSE and depth:
            depth -= 1
        elif word == "record":
            depth += 1
            _add_record(tokens, found, depth)
        elif word == "field":
            _add_field(tokens, found, depth)
        elif word == "list":
            _add_list(tokens, found, depth)
        else:
            raise DatasetError(f"it has {token.text!r} where Record, Field or List is expected: export it again.")
    if depth:
        raise DatasetError("a brace is not closed before its EndOfFile: export it again.")
    return found.records()


def _tokens(text: str) -> Iterator[_Token]:
    return (
        _Token(match[2], True) if match[2] else _Token(match[3] or match[1]) for match in _NESTED_TOKEN.finditer(text)
    )


def _add_record(tokens: _Tokens, found: _Found, depth: int) -> None:
    """Add a record under its name; its own value is what 1.2 gives as a record, such as LotID."""
    name, value = tokens.take().text, tokens.take()
    if value == _OPEN:
        found.add(depth, name, ("",))
        return
    tokens.expect("{")
    if name.lower() == "filerecord":
        found.add(depth, "FileVersion", tuple(value.text.split(".")))
    else:
        found.add(depth, name, (value.text,))


def _add_field(tokens: _Tokens, found: _Found, depth: int) -> None:
    name, stated = tokens.take().text, tokens.take().text
    tokens.expect("{")
    values = tokens.until_close()
    if len(values) != parse_integer(stated):
        raise DatasetError(f"its field {name} has {len(values)} of {stated} values: export it again.")
    if name.lower() == "samplesize":
        values = ("1", *(str(float(value) / _NM_PER_MM) for value in values))
    if name.lower() != "inspectiontest":  # repeats the number of its TestRecord
        found.add(depth, name, values)


def _add_list(tokens: _Tokens, found: _Found, depth: int) -> None:
    """Add a list under its keyword of 1.2, with the count that precedes its rows there."""
    name = tokens.take().text
    tokens.expect("{", "columns")
    columns = _list_columns(name, tokens)
    tokens.expect("data")
    listed = tuple(_list_rows(name, len(columns), tokens))
    rows = tuple(row for row, _ in listed)
    tokens.expect("}")
    if name.lower() == "defectlist":
        found.add(depth, "DefectRecordSpec", (str(len(columns)), *columns))
        found.add(depth, name, *rows)
        found.lists.append(DefectList(columns, rows, tuple(images for _, images in listed)))
    elif name.lower() == "testsummarylist":
        found.add(depth, "SummarySpec", (str(len(columns)), *columns))
        found.add(depth, "SummaryList", *rows)
    elif (wanted := _LIST_COLUMNS.get(name.lower())) is not None:
        at = [columns.index(column) for column in wanted]
        found.add(depth, name, (str(len(rows)),), *(tuple(row[k] for k in at) for row in rows))


def _list_columns(name: str, tokens: _Tokens) -> Words:
    stated = tokens.take().text
    tokens.expect("{")
    words = tokens.until_close()
    if len(words) != 2 * parse_integer(stated):
        raise DatasetError(f"its {name} names {len(words) / 2:g} of {stated} columns: export it again.")
    return tuple(word.upper() for word in words[1::2])


def _list_rows(name: str, n_columns: int, tokens: _Tokens) -> Iterator[tuple[Words, tuple[Words, ...]]]:
    """Yield the words of each row, and those of each of its images."""
    stated = parse_integer(tokens.take().text)
    tokens.expect("{")
    n, row, images = 0, list[str](), tuple[Words, ...]()
    while True:
        token = tokens.take()
        if not token.is_mark:
            row.append(token.text)
        elif token == _OPEN:
            images = _take_images(tokens, row)
        elif token != _COMMA and (row or token == _SEMICOLON):
            n += 1
            if len(row) != n_columns:
                raise DatasetError(f"row {n} of its {name} has {len(row)} of {n_columns} values: export it again.")
            yield tuple(row), images
            row, images = [], ()
        if token == _CLOSE:
            break
    if n != stated:
        raise DatasetError(f"its {name} has {n} of {stated} rows: export it again.")


def _take_images(tokens: _Tokens, row: list[str]) -> tuple[Words, ...]:
    """Take a list of images, ``Images 2 {...}``, which is one value of a row, and return the words of each."""
    if len(row) < 2 or row[-2].lower() not in ("image", "images"):
        raise DatasetError("it has a brace within a row that lists no images: export it again.")
    return _in_parts(tokens.until_close(), parse_integer(row.pop()))
