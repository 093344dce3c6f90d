"""Simulated GRBL 1.1 board with limit switches."""

from __future__ import annotations

import re
from collections.abc import Mapping

from wafer_viewer.rigs.stages.motion_controller import AxisConfig
from wafer_viewer.rigs.stages.simulated.axis import SimulatedController
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage

GREETING = b"\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n"
OK = b"ok\r\n"
JOG = re.compile(r"\$J=G90 ?G21 ?G53 ?((?:[XYZABC]-?[\d.]+ ?)+)F([\d.]+)")
STEPS_PER_MM = 1000.0
LOOK_S = 0.01
"""Time between two looks at the end of a search, s."""
LETTERS = "XYZABC"
"""Axes by their order; a board reports X, Y and Z, and those after them up to the last that it has."""


class SimulatedGrbl(SimulatedController):
    """A board that is locked at power-up and does not answer while it homes."""

    def __init__(self, clock: VirtualClock, stage: VirtualStage, axes: Mapping[str, AxisConfig]) -> None:
        super().__init__(clock, stage, axes)
        self._by_letter = {axes[name].address: self.axes[name] for name in axes}
        self.settings = {13: 0.0, 20: 1.0, 22: 1.0}
        self._letters = LETTERS[: max((3, *(1 + LETTERS.index(letter) for letter in self._by_letter)))]
        for letter in self._letters:
            config = next((config for config in axes.values() if config.address == letter), None)
            rate = config.rate(config.speed_um_s) * 60 if config else 500.0
            acceleration = config.rate(config.acceleration_um_s2) if config else 10.0
            for first, value in ((100, STEPS_PER_MM), (110, rate), (120, acceleration)):
                self.settings[first + LETTERS.index(letter)] = value
        self.state = "Alarm"
        self._homing = False
        self._buffer = b""

    def process(self, data: bytes) -> bytes:
        """Process bytes; return what the board says."""
        said = b""
        for one in data:
            if one == 0x18:
                said += self._reset()
            elif self._homing:
                continue
            elif one == ord("?"):
                said += self._status()
            elif one == 0x85:
                self._stop()
            elif one in b"\r\n":
                said += self._line(self._buffer.decode("latin-1"))
                self._buffer = b""
            else:
                self._buffer += bytes([one])
        return said

    def _reset(self) -> bytes:
        """Restart; a reset in motion loses the position."""
        alarm = b"ALARM:6\r\n" if self._homing else b"ALARM:3\r\n" if self._moving() else b""
        for axis in self._by_letter.values():
            axis.stop()
            if alarm:
                axis.homed = False
        self._homing, self._buffer, self.state = False, b"", "Alarm"
        return alarm + GREETING

    def _look_for_end(self, time_s: float) -> None:
        """Answer a search that has ended; look again later while it goes on."""
        if not self._homing:
            return
        if self._moving():
            self._clock.at(time_s + LOOK_S, self._look_for_end)
            return
        self._homing, self.state = False, "Idle"
        self._deliver(OK, time_s)

    def _line(self, text: str) -> bytes:
        if text == "":
            return OK
        if text == "$$":
            return b"".join(b"$%d=%.3f\r\n" % item for item in sorted(self.settings.items())) + OK
        if text == "$I":
            return b"[VER:1.1h.20190830:simulated]\r\n[OPT:V,15,128]\r\n" + OK
        if text == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            return OK
        if text == "$H":
            return self._search()
        if text.startswith("$J="):
            return self._jog(text)
        return b"error:3\r\n"

    def _search(self) -> bytes:
        if self._moving():
            return b"error:8\r\n"
        for axis in self._by_letter.values():
            axis.search()
        self._homing = True
        self._clock.at(self._clock.now_s() + LOOK_S, self._look_for_end)
        return b""

    def _jog(self, text: str) -> bytes:
        """Begin a straight motion; all axes arrive together."""
        found = JOG.fullmatch(text)
        if found is None:
            return b"error:20\r\n"
        if self.state == "Alarm":
            return b"error:9\r\n"
        goals = {word[0]: float(word[1:]) for word in re.findall(r"[XYZABC]-?[\d.]+", found[1])}
        goals = {letter: round(mm * STEPS_PER_MM) / STEPS_PER_MM for letter, mm in goals.items()}
        if any(not self._by_letter[letter].reachable(mm) for letter, mm in goals.items()):
            return b"error:15\r\n"
        ways = {letter: abs(mm - self._by_letter[letter].units) for letter, mm in goals.items()}
        lasts_min = sum(way**2 for way in ways.values()) ** 0.5 / float(found[2])
        for letter, mm in goals.items():
            if ways[letter] > 0:
                self._by_letter[letter].move(mm, ways[letter] / lasts_min / 60)
        return OK

    def _status(self) -> bytes:
        stalled = [axis for axis in self._by_letter.values() if axis.stalled]
        if stalled and self.state != "Alarm":
            for axis in self._by_letter.values():
                axis.stop()
                axis.homed = axis.stalled = False
            self.state = "Alarm"
            return b"ALARM:1\r\n" + self._report("Alarm")
        return self._report("Jog" if self._moving() else self.state)

    def _report(self, state: str) -> bytes:
        at = ",".join(f"{self._by_letter[x].units if x in self._by_letter else 0.0:.3f}" for x in self._letters)
        return f"<{state}|MPos:{at}|FS:0,0>\r\n".encode()

    def _moving(self) -> bool:
        moving = [axis.moving for axis in self._by_letter.values()]
        return any(moving)

    def _stop(self) -> None:
        for axis in self._by_letter.values():
            axis.stop()
