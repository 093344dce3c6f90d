"""A virtual rig whose pulse box is the machine code of the board, run by an emulator on the rig's own clock.

The emulated processor never runs ahead of the next event on the clock, and stops at each rising edge of its trigger and
at the end of each line that it sends. Runs are the same on every machine, however busy it is.
"""

from __future__ import annotations

import heapq
import math
import struct
import subprocess
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from unittest.mock import patch

from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.pulse_box_firmware import BOOT_S, VirtualPulseBox
from wafer_viewer.rigs.virtual.rig import VirtualRig
from wafer_viewer.rigs.virtual.stage import VirtualStage

CLOCK_HZ = 16_000_000
AXES = ("x", "y", "z")


class LockstepClock(VirtualClock):
    """A virtual clock that takes an emulated board along."""

    def __init__(self, *, real_time: bool = False) -> None:
        super().__init__(real_time=real_time)
        self.board: MachineCodeBox | None = None

    def _next_event(self, until_s):
        while self._events and self._events[0].cancelled:
            heapq.heappop(self._events)
        if self.board is not None:
            self.board.run(min(self._events[0].time_s, until_s) if self._events else until_s)
        return super()._next_event(until_s)


class MachineCodeBox:
    """Fulfils the part of VirtualPulseBox with the image for the ATmega2560 in the program `lockstep`."""

    def __init__(
        self,
        folder: Path,
        clock: LockstepClock,
        stage: VirtualStage,
        trigger: Callable[[float], bool],
        suppresses: Callable[[], bool],
    ) -> None:
        self.program = subprocess.Popen(
            [folder / "lockstep", folder / "pulse_box_atmega2560.elf"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.clock, self.stage, self.trigger = clock, stage, trigger
        self.send: Callable[[bytes, float], None] = lambda data, time_s: None
        self.moved = 2
        self.on_pulse: Callable[[int, float], None] = lambda number, time_s: None
        self.pulses = 0
        self.places_um: list[float] = []
        """Position at each pulse of the axis that moved last."""
        self.lost_pulses: set[int] = set()
        """Pulses that do not reach the camera, numbered as `on_pulse` is told."""
        stage.on_motion(self.follow)
        clock.board = self

    def connect(self, send):
        self.send = send

    def run(self, until_s: float) -> None:
        """Run to a time or to the first output, which becomes an event of the clock."""
        self.order("<cQ", b"R", cycles(until_s))
        self.program.stdin.flush()
        kind, at, n = struct.unpack("<cQH", self.program.stdout.read(11))
        time_s = max(at / CLOCK_HZ, self.clock.now_s())
        if kind == b"T":
            self.clock.at(time_s, self.pulse)
        elif kind == b"L":
            line = self.program.stdout.read(n)
            self.clock.at(time_s, lambda t: self.send(line, t))

    def pulse(self, time_s):
        """Bring a pulse to the camera, and its exposure back to the board."""
        number = self.pulses
        self.pulses += 1
        self.places_um.append(self.stage.axes[AXES[self.moved]].profile.position_at(time_s))
        self.on_pulse(number, time_s)
        if number not in self.lost_pulses and self.trigger(time_s):
            self.see_exposure()

    def receive(self, data, time_s):
        self.order("<cH", b"B", len(data), data)
        return b""

    def follow(self, axis, time_s):
        """Give the board's world the motion of an axis."""
        one, number = self.stage.axes[axis], AXES.index(axis)
        self.moved = number
        per_um = one.limits.counts_per_um
        pieces = [
            struct.pack(
                "<5d",
                piece.start_s,
                piece.duration_s,
                piece.position_um * per_um,
                piece.speed_um_s * per_um,
                piece.acceleration_um_s2 * per_um,
            )
            for piece in one.profile.pieces
        ]
        self.order("<cBbB", b"M", number, one.profile.direction, len(pieces), b"".join(pieces))

    def reboot(self):
        self.order("<cQ", b"P", cycles(self.clock.now_s() + BOOT_S))

    def slip(self, counts, *, reported):
        """Lose the next counts of the axis that moved last.

        Unreported, at the scale, whose lines stand still meanwhile. Reported, by a loose contact that the board sees as
        a change of both lines at once.
        """
        if reported:
            self.order("<cBI", b"H", self.moved, counts + (2 - counts) % 4)
        else:
            self.order("<cBI", b"S", self.moved, counts)

    def loosen(self, counts):
        """Hold the lines of the axis that moved last for its next counts."""
        self.order("<cBI", b"H", self.moved, counts)

    def see_exposure(self):
        self.order("<c", b"X")

    def order(self, layout, *values):
        n_values = len(layout) - 1
        self.program.stdin.write(struct.pack(layout, *values[:n_values]) + b"".join(values[n_values:]))

    def close(self):
        self.program.stdin.close()
        self.program.stdout.close()
        self.program.wait(10)


class PlayedBackBox(VirtualPulseBox):
    """A virtual pulse box that fires late: where an emulated board did in the same scan.

    It counts and reports by itself; only the places of its pulses are given. A scan with it, on a stage that does not
    ring, has the light of the board's, so that every picture has to be the same.
    """

    def __init__(self, places_um: Sequence[float], *parts) -> None:
        self._places_um, self._fired = places_um, 0
        super().__init__(*parts)

    def _cross(self, count, time_s):
        profile, place_um = self._stage.axes[self._axis].profile, self._places_um[self._fired]
        late_s = profile.crossing_s(place_um, self._setting("DIR"), time_s)
        assert late_s is not None, f"pulse {self._fired}: {place_um} um is not ahead of its edge"
        self._watched = self._clock.at(late_s, lambda t: super(PlayedBackBox, self)._cross(count, t))

    def _pulse(self, count, time_s):
        self._fired += 1
        super()._pulse(count, time_s)


def cycles(time_s: float) -> int:
    return math.ceil(time_s * CLOCK_HZ)


def without_ringing():
    """Let stages not ring after a halt.

    The rest of it that a frame sees depends on the time since the halt, which the answers of a serial port change.
    """
    return patch("wafer_viewer.rigs.virtual.stage.RING_UM", 0.0)


@contextmanager
def hybrid_rig(folder: Path, **settings) -> Generator[VirtualRig]:
    """Switch on a virtual rig with the emulated board of a build folder in place of its virtual pulse box."""
    boxes: deque[MachineCodeBox] = deque(maxlen=1)

    def box(*parts):
        boxes.append(MachineCodeBox(folder, *parts))
        return boxes[-1]

    with patch.multiple("wafer_viewer.rigs.virtual.rig", VirtualClock=LockstepClock, VirtualPulseBox=box):
        rig = VirtualRig(**settings)
    try:
        yield rig
    finally:
        rig.close()
        boxes[-1].close()


@contextmanager
def played_back_rig(places_um: Sequence[float], **settings) -> Generator[VirtualRig]:
    """Switch on a virtual rig whose pulse box fires where an emulated board did."""
    with patch("wafer_viewer.rigs.virtual.rig.VirtualPulseBox", partial(PlayedBackBox, places_um)):
        rig = VirtualRig(**settings)
    try:
        yield rig
    finally:
        rig.close()
