"""Measured values for statistical process control: the Q-DAS ASCII transfer format, AQDEF, a line for each K field."""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from wafer_viewer.draw.number_format import MINUS

NOT_VALID = 255
"""Attribute (K0002) of a value that was not obtained; it keeps its place among the others and counts nowhere."""
_LETTERS = {
    "K1001": 30,
    "K1002": 80,
    "K1004": 20,
    "K1082": 40,
    "K1900": 255,
    "K2001": 20,
    "K2002": 80,
    "K2142": 20,
    "K2900": 255,
    "K0006": 14,
    "K0009": 255,
    "K0014": 40,
}
"""Longest text of a field, by the format."""


@dataclass(frozen=True, slots=True)
class MeasuredValue:
    """One value; None where none was obtained. part: what it was measured on, such as wafer and die."""

    value: float | None
    part: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class ControlledQuantity:
    """A measured quantity with nominal and limits in its unit, where it has them, and its values."""

    number: str
    name: str
    unit: str
    values: Sequence[MeasuredValue]
    nominal: float | None = None
    lower: float | None = None
    upper: float | None = None
    remark: str = ""


@dataclass(frozen=True, slots=True)
class MeasuredPart:
    """A product with its characteristics; at: local time of the measurement."""

    number: str
    name: str
    revision: str
    instrument: str
    remark: str
    lot: str
    at: datetime | None
    characteristics: Sequence[ControlledQuantity]


def transfer_file(part: MeasuredPart) -> bytes:
    """Return the file: Windows-1252, or UTF-8 with a byte order mark where a name needs other letters."""
    text = "".join(f"{line}\r\n" for line in _lines(part))
    try:
        return text.encode("cp1252")
    except UnicodeEncodeError:
        return codecs.BOM_UTF8 + text.encode()


def _lines(part: MeasuredPart) -> Iterator[str]:
    yield f"K0100 {len(part.characteristics)}"
    for key, text in (
        ("K1001", part.number),
        ("K1002", part.name),
        ("K1004", part.revision),
        ("K1082", part.instrument),
        ("K1900", part.remark),
    ):
        yield from _text(key, 1, text)
    for n, each in enumerate(part.characteristics, 1):
        yield from _text("K2001", n, each.number)
        yield from _text("K2002", n, each.name)
        yield f"K2004/{n} 0"
        for key, number in (("K2101", each.nominal), ("K2110", each.lower), ("K2111", each.upper)):
            if number is not None:
                yield f"{key}/{n} {_decimal(number)}"
        yield from _text("K2142", n, each.unit)
        yield from _text("K2900", n, each.remark)
    for n, each in enumerate(part.characteristics, 1):
        for value in each.values:
            yield from _value(n, value, part)


def _value(n: int, value: MeasuredValue, part: MeasuredPart) -> Iterator[str]:
    yield f"K0001/{n} {_decimal(value.value if value.value is not None else 0.0)}"
    yield f"K0002/{n} {0 if value.value is not None else NOT_VALID}"
    if part.at is not None:
        yield f"K0004/{n} {part.at:%d.%m.%Y/%H:%M:%S}"
    lot_fits = len(_plain(part.lot)) <= _LETTERS["K0006"]
    yield from _text("K0006", n, part.lot if lot_fits else "")
    yield from _text("K0009", n, " · ".join(filter(None, (value.text, "" if lot_fits else f"lot {part.lot}"))))
    yield from _text("K0014", n, value.part)


def _text(key: str, n: int, text: str) -> Iterator[str]:
    """Yield the line of a text; none for an empty one. What is longer than the format takes ends with three dots."""
    plain, most = _plain(text), _LETTERS[key]
    if plain:
        yield f"{key}/{n} {plain if len(plain) <= most else f'{plain[: most - 3]}...'}"


def _plain(text: str) -> str:
    """Return a text on one line, without the control characters that separate fields, with the minus of a keyboard."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text.replace(MINUS, "-")).split())


def _decimal(value: float) -> str:
    """Return a number without an exponent, which not every reader takes, to nine significant digits."""
    return f"{float(f'{value:.9g}') + 0.0:.12f}".rstrip("0").rstrip(".")
