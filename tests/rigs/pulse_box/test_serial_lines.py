"""The core with two serial lines: answers and events go where they belong."""

from __future__ import annotations

import ctypes
import itertools

import pytest

from tests.rigs.pulse_box.firmware_box import Send, Trigger
from wafer_viewer.rigs.pulse_box.wpc_protocol import HALT, Line, decode, encode

BOOTS = itertools.count(1)
"""Numbers of starts: the library is loaded once, and knows repeated commands of the same start."""


class Core:
    """The core as a library; `heard` are the lines that it sent on each serial line."""

    def __init__(self, library):
        self.core, self.sequence = ctypes.CDLL(str(library)), 0
        self.core.library_move.argtypes = [ctypes.c_uint8, ctypes.c_long, ctypes.c_long]
        self.heard: dict[int, list[Line]] = {0: [], 1: []}
        self.callbacks = Trigger(lambda: None), Send(self.collect)
        self.core.library_connect(*self.callbacks)
        self.core.library_start(next(BOOTS), (ctypes.c_long * 3)())
        self.core.library_time(0)

    def collect(self, link, data, length):
        self.heard[link].append(decode(bytes(data[: length - 1])))

    def feed(self, link, data):
        for byte in data:
            self.core.box_receive(link, byte)

    def ask(self, link, verb, **values):
        """Send a command on a serial line; returns its answer, which came on the same."""
        self.sequence += 1
        self.feed(link, encode(Line("C", self.sequence, verb, {k: str(v) for k, v in values.items()})))
        answer = self.heard[link][-1]
        assert (answer.kind, answer.sequence) == ("A", self.sequence)
        return answer

    def arm(self, link, **settings):
        self.ask(link, "REF", AX="Z", COUNT=0)
        self.ask(link, "CFG", AX="Z", DIV=1, START=10, STOP=12, MAX=3, WIDTH_US=1, **settings)
        self.ask(link, "HB", MS=1_000)
        assert self.ask(link, "ARM", RUN=7).verb == "OK"

    def pass_to(self, counts):
        """Move the scale by single counts, 1 ms each, as pulses never overlap."""
        for count in range(1, counts + 1):
            self.core.library_time(count * 1_000)
            self.core.library_move(2, count, 1)
            self.core.library_report()


@pytest.fixture
def core(built):
    return Core(built("library") / "libpulse_box.so")


def verbs(lines):
    return [line.verb for line in lines if line.kind == "E"]


@pytest.mark.parametrize("link", [0, 1])
def test_pulses_are_told_on_the_line_that_armed_the_box(link, core):
    core.arm(link)
    core.pass_to(14)
    assert verbs(core.heard[link]) == ["P", "P", "P"]
    assert core.heard[1 - link] == []
    assert core.ask(1 - link, "DUMP", FROM=1, TO=2).values["RECORDS"] == "2"
    assert verbs(core.heard[1 - link]) == ["P", "P"], "but sent again to the one that asks"


def test_commands_that_come_at_once_on_both_lines_are_told_apart(core):
    one, other = (encode(Line("C", 5, "GET", {"AX": axis})) for axis in "XY")
    for pair in zip(one, other, strict=True):
        for link, byte in enumerate(pair):
            core.feed(link, bytes([byte]))
    assert [core.heard[link][-1].values["AX"] for link in (0, 1)] == ["X", "Y"]


def test_a_repeated_command_is_known_by_its_line(core):
    core.arm(0, SOURCE="COMMAND")
    raw = encode(Line("C", 99, "FIRE", {}))
    for link, time_us in ((0, 1_000), (1, 2_000), (0, 3_000)):
        core.core.library_time(time_us)
        core.feed(link, raw)
    assert [core.heard[link][-1].values["EMITTED"] for link in (0, 1)] == ["1", "2"]
    assert core.ask(0, "GET").values["EMITTED"] == "2", "one for each line, and its answer again for the repetition"


def test_a_heartbeat_on_another_line_keeps_no_run_alive(core):
    core.arm(0)
    core.core.library_time(900_000)
    refused = core.ask(1, "HB", MS=60_000)
    assert (refused.verb, refused.values["WHY"]) == ("NO", "armed_from_another_serial_line")
    core.core.library_time(1_100_000)
    core.core.library_report()
    assert verbs(core.heard[0]) == ["F"]
    assert verbs(core.heard[1]) == []
    assert core.ask(1, "HB").verb == "OK", "once the box is not armed"


@pytest.mark.parametrize("how", ["halt", "disarm"])
def test_a_run_is_ended_from_either_line(how, core):
    core.arm(0)
    if how == "halt":
        core.feed(1, HALT)
    else:
        core.ask(1, "DISARM")
    core.pass_to(14)
    assert core.ask(0, "GET").values["EMITTED"] == "0"
