"""Lines over a true pseudo-terminal, and the words for what controllers report."""

from __future__ import annotations

import os
import pty
import tty
from contextlib import suppress

import pytest

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.composed.rig import SystemClock, open_port
from wafer_viewer.rigs.stages import grbl, pi_gcs2, zaber
from wafer_viewer.rigs.stages.motion_controller import LONGEST_LINE, SerialLine

WORDS = {**zaber.FAULTS, **zaber.REJECTED, **grbl.ALARMS, **grbl.ERRORS, **grbl.HELD, **pi_gcs2.ERRORS}


@pytest.fixture
def wire():
    """The file of the far end, and the line at the near one."""
    far, near = pty.openpty()
    tty.setraw(near)
    line = SerialLine(open_port(os.ttyname(near), 115_200), SystemClock(), "controller")
    os.close(near)
    yield far, line
    line.close()
    with suppress(OSError):
        os.close(far)


def test_a_line_may_come_in_parts_and_several_at_once(wire):
    far, line = wire
    os.write(far, b"one\r\ntwo \nthr")
    assert [line.line(), line.line(), line.line(0.01)] == ["one", "two ", None]
    os.write(far, b"ee\n")
    assert line.line() == "three"


def test_what_has_no_end_is_no_line_and_fills_no_memory(wire):
    far, line = wire
    for _ in range(5):
        os.write(far, b"x" * 1000)
        assert line.line(0.01) is None
    assert len(line._buffer) == LONGEST_LINE
    line.discard()
    os.write(far, b"then\n")
    assert line.line() == "then"


def test_an_unplugged_port_is_a_fault_of_the_rig(wire):
    far, line = wire
    os.close(far)
    with pytest.raises(RigError, match=r"controller was lost.*cable.*open the rig again"):
        line.line()


def test_a_port_in_use_is_refused():
    far, near = pty.openpty()
    port = open_port(os.ttyname(near), 115_200)
    with pytest.raises(RigError, match=r"cannot be opened.*other programs"):
        open_port(os.ttyname(near), 115_200)
    port.close()
    os.close(far)
    os.close(near)


@pytest.mark.parametrize("words", WORDS.values())
def test_what_a_controller_reports_is_said_with_its_mend(words):
    assert ":" in words
    assert not words.endswith(".")


def test_checksums_are_those_of_the_makers_manual():
    assert zaber.checksum("01 0 01 OK IDLE -- 0") == "0C"
    assert zaber.checksum("1 0 01 trigger 1 when 1 encoder dist 4000") == "BE"
    assert zaber.parse("@01 0 01 OK IDLE -- 0:0C").accepted
    assert zaber.parse("@01 0 01 OK IDLE -- 0:0D") is None
    assert zaber.parse("@01 0 01 OK IDLE -- 0").number == 1
    assert zaber.parse("!01 1 IDLE --") is None


def test_work_positions_of_grbl_are_refused_with_the_mend():
    assert grbl.parse_status("<Hold:0|MPos:1.000,-2.000,0.500|FS:0,0|WCO:0,0,0>").position_mm == (1.0, -2.0, 0.5)
    with pytest.raises(RigError, match=r"\$10=1"):
        grbl.parse_status("<Idle|WPos:0.000,0.000,0.000|FS:0,0>")
