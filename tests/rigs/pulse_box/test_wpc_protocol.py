"""The line protocol: every line there and back, no damaged one believed, every command carried out exactly once."""

from __future__ import annotations

import string

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.model.errors import WireError
from wafer_viewer.rigs.pulse_box.wpc_protocol import (
    ANSWER,
    COMMAND,
    HALT,
    Line,
    LineReader,
    WireClient,
    crc,
    decode,
    encode,
)
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.serial_port import Interference, VirtualPort

WORD = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ", min_size=1, max_size=9)
VALUE = st.text("abcXYZ0123456789_/-", min_size=1, max_size=12)
LINES = st.builds(
    Line, st.sampled_from(["C", "A", "E"]), st.integers(0, 0xFFFF), WORD, st.dictionaries(WORD, VALUE, max_size=6)
)


def test_the_checksum_is_the_one_of_the_protocol():
    assert crc(b"123456789") == 0x29B1


@given(LINES)
def test_a_line_comes_back_as_it_was(line):
    assert decode(encode(line).rstrip(b"\n")) == line


@given(LINES, st.data())
def test_no_line_with_a_flipped_bit_is_believed(line, data):
    raw = bytearray(encode(line).rstrip(b"\n"))
    bit = data.draw(st.integers(0, 8 * len(raw) - 1))
    raw[bit // 8] ^= 1 << bit % 8
    with pytest.raises(WireError, match="damaged"):
        decode(bytes(raw))


@given(st.binary(max_size=200))
def test_noise_is_no_line(data):
    assert LineReader().feed(data + b"\n") == []


@given(st.lists(LINES, max_size=8), st.lists(st.integers(1, 40), min_size=1))
def test_lines_are_found_however_the_stream_is_cut(lines, cuts):
    stream, reader, found, at, i = b"".join(map(encode, lines)), LineReader(), [], 0, 0
    while at < len(stream):
        size = cuts[i % len(cuts)]
        found += reader.feed(stream[at : at + size])
        at, i = at + size, i + 1
    assert found == lines


def test_no_flipped_bit_turns_a_line_into_a_halt():
    characters = string.ascii_letters + string.digits + " *=-_/.\n"
    assert all(bin(ord(c) ^ HALT[0]).count("1") > 1 for c in characters)


def test_a_number_that_is_none_is_a_wire_error():
    with pytest.raises(WireError, match="without a whole number N"):
        Line(ANSWER, 1, "OK", {"N": "many"}).number("N")


class Counter:
    """A device that counts how often it carries out each command, with the box's rule of one answer a sequence."""

    def __init__(self):
        self.reader, self.carried_out, self.last = LineReader(), [], None

    def receive(self, data, time_s):
        return b"".join(self.answer(line) for line in self.reader.feed(data) if line.kind == COMMAND)

    def answer(self, line):
        if self.last is None or self.last[0] != line:
            self.carried_out.append(line.number("I"))
            self.last = line, encode(Line(ANSWER, line.sequence, "OK", {"I": line.values["I"]}))
        return self.last[1]


@settings(max_examples=examples(5))
@given(seed=st.integers(0, 2**32 - 1))
def test_on_a_bad_wire_each_of_2000_commands_is_carried_out_exactly_once(seed):
    clock, device = VirtualClock(), Counter()
    wire = Interference(lost_fraction=0.02, damaged_fraction=0.02, seed=seed)
    client = WireClient(VirtualPort(clock, device, wire), clock)
    answers = [client.ask("DO", I=i).number("I") for i in range(2000)]
    assert answers == device.carried_out == list(range(2000))
    assert 80 < client.retries < 260


def test_a_late_answer_is_drained_and_costs_no_second_try():
    clock, device = VirtualClock(), Counter()
    port = VirtualPort(clock, device)
    client = WireClient(port, clock)
    client.ask("DO", I=0)
    port.deliver(encode(Line(ANSWER, 1, "OK", {"I": "0"})), clock.now_s())
    clock.sleep(0.01)
    assert client.ask("DO", I=1).number("I") == 1
    assert client.retries == 0
