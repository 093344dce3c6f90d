"""WPC/2, the line protocol of the pulse box: framing and checksums for both ends, and the client end.

A line is ``<C|A|E><sequence, 4 hex> <VERB key=value …>*<crc, 4 hex>`` and a line feed: a command, its answer, or an
event. The checksum is CRC-16/CCITT-FALSE over everything before the asterisk. A repeated command has the same sequence
number; the box executes it once and repeats its answer. The verbs are described in
assets/docs/reference/pulse-box-protocol.md.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, cast

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.errors import RigError, RigTimeout, WireError

Kind = Literal["C", "A", "E"]
COMMAND, ANSWER, EVENT = cast(tuple[Kind, Kind, Kind], ("C", "A", "E"))
VERSION = "WPC/2"
HALT = b"\x98"
"""Raw byte that stops pulses at once; no flipped bit turns a character of a line into it."""
LONGEST_LINE = 256
SEQUENCES = 0x10000
ANSWER_S = 0.05
"""Time in s after which a command without an answer is sent again."""
PATIENCE_S = 12 * ANSWER_S
"""Time in s after which a command without an answer fails."""

_LINE = re.compile(rb"([CAE])([0-9A-F]{4}) ([A-Z]+)((?: [A-Z_]+=[^ *=]+)*)\*([0-9A-F]{4})")


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the protocol. Values are words or integers, as text."""

    kind: Kind
    sequence: int
    verb: str
    values: dict[str, str] = field(default_factory=dict[str, str])

    def number(self, name: str) -> int:
        """Return an integer value. Raises WireError when it is missing or not an integer."""
        try:
            return int(self.values[name])
        except (KeyError, ValueError) as fault:
            raise WireError(
                f"The pulse box sent '{self.verb}' without a whole number {name}: {self.values}."
            ) from fault


def crc(body: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(body, 0xFFFF)


def encode(line: Line) -> bytes:
    """Return the bytes of a line, including the line feed."""
    words = [f"{line.kind}{line.sequence:04X} {line.verb}", *(f"{k}={v}" for k, v in line.values.items())]
    body = " ".join(words).encode()
    return body + b"*%04X\n" % crc(body)


def decode(raw: bytes) -> Line:
    """Decode a line without its line feed. Raises WireError when it is damaged."""
    match = _LINE.fullmatch(raw)
    if match is None or int(match[5], 16) != crc(raw[:-5]):
        raise WireError(f"A line came damaged over the wire: {raw[:80]!r}.")
    values = dict(word.split("=", 1) for word in match[4].decode("latin-1").split())
    return Line(cast(Kind, match[1].decode()), int(match[2], 16), match[3].decode(), values)


class LineReader:
    """Splits a byte stream into lines; damaged ones are counted and dropped."""

    def __init__(self) -> None:
        self._rest = b""
        self.damaged = 0

    def feed(self, data: bytes) -> list[Line]:
        """Return the lines that these bytes complete."""
        *raw, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-LONGEST_LINE:]
        return [line for r in raw if (line := self._decoded(r)) is not None]

    def _decoded(self, raw: bytes) -> Line | None:
        try:
            return decode(raw)
        except WireError:
            self.damaged += 1
            return None


class WireClient:
    """Client end: one command at a time, repeated until answered; events are queued until fetched."""

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        self._port = port
        self._clock = clock
        self._reader = LineReader()
        self._sequence = 0
        self._events: list[Line] = []
        self.retries = 0

    def ask(self, verb: str, *, patience_s: float = PATIENCE_S, **values: int | str) -> Line:
        """Send a command and return its answer, OK or NO.

        Pending input is read first, so that a late answer to an earlier command does not cause a repetition. Raises
        RigTimeout when the box does not answer within `patience_s`.
        """
        self._sort(self._read_waiting())
        self._sequence = (self._sequence + 1) % SEQUENCES
        raw = encode(Line(COMMAND, self._sequence, verb, {k: str(v) for k, v in values.items()}))
        deadline_s = self._clock.now_s() + patience_s
        self._write(raw)
        while (answer := self._answer()) is None:
            if self._clock.now_s() >= deadline_s:
                raise RigTimeout(f"The pulse box did not answer {verb} within {patience_s:g} s: check its cable.")
            self.retries += 1
            self._write(raw)
        return answer

    def events(self) -> list[Line]:
        """Return the events received since the last call."""
        self._sort(self._read_waiting())
        events, self._events = self._events, []
        return events

    def halt(self) -> None:
        """Stop pulses at once."""
        self._write(HALT)

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _answer(self) -> Line | None:
        deadline = self._clock.now_s() + ANSWER_S
        while (left := deadline - self._clock.now_s()) > 0:
            found = self._sort(self._read(left))
            if found is not None:
                return found
        return None

    def _sort(self, data: bytes) -> Line | None:
        """Queue the received events; return the answer to the current command if there is one."""
        found = None
        for line in self._reader.feed(data):
            if line.kind == EVENT:
                self._events.append(line)
            elif line.kind == ANSWER and line.sequence == self._sequence:
                found = line
        return found

    def _read_waiting(self) -> bytes:
        with _cable("read"):
            return self._port.read(n) if (n := self._port.in_waiting) else b""

    def _read(self, timeout_s: float) -> bytes:
        with _cable("read"):
            self._port.timeout = timeout_s
            return self._port.read(max(1, self._port.in_waiting))

    def _write(self, data: bytes) -> None:
        with _cable("written to"):
            self._port.write(data)


@contextmanager
def _cable(done: str) -> Generator[None]:
    """Raise an OSError of the port as a RigError of the pulse box; done: what cannot be done with the port."""
    try:
        yield
    except OSError as fault:
        why = fault.strerror or fault
        raise RigError(f"The pulse box's port cannot be {done} ({why}): check its cable and its power.") from fault
