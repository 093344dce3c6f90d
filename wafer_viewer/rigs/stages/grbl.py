"""GRBL 1.1 controllers, for motion only: jogs in machine coordinates, in mm.

A line is answered by ``ok`` or ``error:n``, in order; ``?`` by a status at once, except while it homes. Every motion is
a jog, which is cancelled without loss of the position; a search is ended by a reset only, after which the position is
unknown. A feed hold is left to the operator's button, because it would lock an idle board. Pulses never come from
g-code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import NamedTuple

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.errors import RigError, RigTimeout
from wafer_viewer.rigs.stages.motion_controller import (
    QUIET_S,
    REPLY_S,
    TRIES,
    WAKE_S,
    ControllerAxis,
    ControllerDriver,
    SerialLine,
)
from wafer_viewer.rigs.stages.simulated.grbl import SimulatedGrbl

STATUS = re.compile(r"<([A-Za-z]+)(?::\d+)?\|(?:[^>]*\|)?([MW])Pos:([-\d.,]+)(?:\|[^>]*)?>")
SETTING = re.compile(r"\$(\d+)=([-\d.]+)")
STATUS_QUERY, JOG_CANCEL, RESET = b"?", b"\x85", b"\x18"
LETTERS = "XYZABC"
"""Axes by their order in settings and reports; A, B and C, in degrees, are of boards with more than three."""
INCHES, HOMING = 13, 22
STEPS_PER_MM, MAX_RATE, ACCELERATION = 100, 110, 120
"""First of the settings of the axes; rates are in mm/min, of A, B and C in deg/min."""
ROUNDING = 1e-6
"""Fraction by which a setting may be rounded."""
REPORTED_MM = 0.001
"""Resolution of reported positions; coarser steps are found from them exactly."""
RESTART_S = 1.0
"""Time in s in which a board greets after a reset."""
MOTION = ("Jog", "Run", "Home")
HELD = {
    "Hold": "it is held: release it by its button, or reset it and home it",
    "Door": "its door is open: close it and reset it",
    "Check": "it only checks programs: send $C to it",
    "Sleep": "it sleeps: reset it and home it",
    "Alarm": "it is locked by an alarm: home it",
}
"""States in which no motion is possible, with the mend."""

ALARMS = {
    1: "a limit switch was hit and the position is lost: clear the way, check the range in the rig's file and home it",
    2: "the goal lies beyond its travel: correct the range in the rig's file, or $130 to $132",
    3: "it was reset in motion and the position is lost: home it",
    6: "its search was interrupted by a reset: home it",
    7: "its search was interrupted by the safety door: close the door and home it",
    8: "it did not leave the limit switch: raise the pull-off $27 or check the switch",
    9: "it did not find the limit switch: check switch and wiring, and $27, $130 to $132",
}
"""Alarms with the mend."""
ERRORS = {
    2: "a number is damaged: check the cable",
    3: "it does not know the command: it is not GRBL 1.1",
    5: "homing is switched off: connect limit switches and set $22=1",
    8: "it is not idle: wait for it or stop it",
    9: "it is locked by an alarm or a motion: home it",
    11: "the line is too long: check the cable",
    15: "the goal lies beyond its travel: correct the range in the rig's file, or $130 to $132",
    16: "it does not know jogs: update it to GRBL 1.1",
    20: "it does not know a word of the command: check the cable",
}
"""Errors with the mend."""


class Status(NamedTuple):
    """Status report: state and machine position in mm."""

    state: str
    position_mm: tuple[float, ...]


def parse_status(line: str) -> Status | None:
    """Return a status report, or None for another line. Raises RigError when it has no machine position."""
    found = STATUS.fullmatch(line)
    if found is None:
        return None
    if found[2] == "W":
        raise RigError("The GRBL controller reports work positions: send $10=1 to it once, for machine positions.")
    try:
        position_mm = tuple(float(text) for text in found[3].split(","))
    except ValueError:
        return None
    return Status(found[1], position_mm) if all(map(math.isfinite, position_mm)) else None


class GrblController:
    """Implementation of MotionController on one GRBL board."""

    def __init__(self, port: SerialPort, clock: Clock, axes: Mapping[str, ControllerAxis]) -> None:
        self._line = SerialLine(port, clock, "GRBL controller")
        self._axes, self._clock = axes, clock
        self._indices = {name: LETTERS.index(axis.address) for name, axis in axes.items()}
        self._homed = self._searching = False
        self._settings: dict[int, float] = {}
        self._last = self._wake()
        self._require_reported()
        self._settings = {int(n): float(v) for n, v in SETTING.findall("\n".join(self._command("$$")))}
        self._require_settings()

    def identity(self) -> str:
        """Return the version of the firmware."""
        return " ".join(["GRBL", *self._command("$I")])

    def positions(self) -> Mapping[str, float]:
        """Return the machine position in mm; the last known one during a search, in which GRBL does not answer."""
        at = self._last if self._search_goes_on() else self._status()
        return {name: self._on_step(index, at.position_mm[index]) for name, index in self._indices.items()}

    def moving(self) -> Collection[str]:
        """Return all axes while any moves, as GRBL does not tell them apart. Raises RigError in an alarm."""
        if self._search_goes_on():
            return list(self._axes)
        state = self._status().state
        if state in HELD and (self._homed or state != "Alarm"):
            raise RigError(f"The GRBL controller is in state {state}: {HELD[state]}.")
        return list(self._axes) if state in MOTION else []

    def homed(self) -> Collection[str]:
        """Return the axes once a search of this connection has ended, and no reset or alarm came since."""
        if not self._search_goes_on() and self._homed:
            self._status()
        return list(self._axes) if self._homed else []

    def home(self, axes: Collection[str]) -> None:
        """Begin to search the references of all axes."""
        self._command("$X")
        self._line.send(b"$H\n")
        self._homed, self._searching = False, True

    def move(self, goals: Mapping[str, float], speeds: Mapping[str, float]) -> None:
        """Begin a straight motion in which no axis exceeds its speed."""
        here = self.positions()
        ways = {name: goal - here[name] for name, goal in goals.items()}
        way = math.hypot(*ways.values())
        lasts_s = max(abs(ways[name]) / speeds[name] for name in goals)
        rate = 60 * (way / lasts_s if lasts_s > 0 else min(speeds.values()))
        words = "".join(f"{self._axes[name].address}{goal:.4f}" for name, goal in goals.items())
        self._command(f"$J=G90 G21 G53 {words} F{rate:.3f}")

    def stop(self) -> None:
        """Cancel a jog, or end a search by a reset."""
        if not self._searching:
            self._line.send(JOG_CANCEL)
            return
        self._searching = False
        self._line.send(RESET)
        for line in self._line.lines(RESTART_S):
            if line.startswith("Grbl "):
                break
        self._line.discard(QUIET_S)

    def close(self) -> None:
        """Close the port."""
        self._line.close()

    def _wake(self) -> Status:
        """Wait for a board that restarts when its port is opened; return its status."""
        until_s = self._clock.now_s() + WAKE_S
        while self._clock.now_s() < until_s:
            self._line.send(b"\n" + STATUS_QUERY)
            if (status := self._next_status()) is not None:
                self._line.discard(QUIET_S)
                return status
        raise RigTimeout(
            f"No GRBL controller answered in {WAKE_S:g} s: check its power, its cable, and port and baud in the rig's "
            "file."
        )

    def _require_reported(self) -> None:
        """Raise RigError for an axis that the board does not have."""
        n_axes = len(self._last.position_mm)
        for name, index in self._indices.items():
            if index >= n_axes:
                raise RigError(
                    f"The GRBL controller has no axis {LETTERS[index]} for {name}: it reports {n_axes} axes, "
                    f"{', '.join(LETTERS[:n_axes])}. Correct the address in the rig's file."
                )

    def _require_settings(self) -> None:
        """Raise RigError where the settings of the board contradict the rig's file."""
        for number, wanted, why in ((INCHES, 0, "reports in mm"), (HOMING, 1, "homing needs limit switches")):
            if self._settings.get(number) != wanted:
                raise RigError(
                    f"Setting ${number} of the GRBL controller must be {wanted}: {why}. Send ${number}={wanted}."
                )
        for name, index in self._indices.items():
            axis = self._axes[name]
            self._require_reach(f"speed of the {name} axis", axis.speed * 60, MAX_RATE + index, "mm/min")
            self._require_reach(f"acceleration of the {name} axis", axis.acceleration, ACCELERATION + index, "mm/s^2")

    def _require_reach(self, what: str, value: float, number: int, unit: str) -> None:
        """Raise RigError when a value of the rig's file is over the setting that bounds it."""
        most = self._settings.get(number, 0.0)
        if value > most * (1 + ROUNDING):
            raise RigError(
                f"The {what} in the rig's file is {value:g} {unit}, over ${number}={most:g} of the GRBL controller: "
                "lower it in the file, or raise the setting if the drive can do it."
            )

    def _on_step(self, index: int, mm: float) -> float:
        """Return the position of the step nearest to a reported one, if steps are no finer than reported positions."""
        steps = self._settings.get(STEPS_PER_MM + index, 0.0)
        return round(mm * steps) / steps if 0 < steps * REPORTED_MM <= 1 else mm

    def _search_goes_on(self) -> bool:
        """Return whether a search has not been answered yet. Raises RigError when it failed."""
        while self._searching and (line := self._line.line(0.0)) is not None:
            if line == "ok":
                self._searching, self._homed = False, True
            else:
                self._searching = not line.startswith(("ALARM:", "error:", "Grbl"))
                self._heed(line)
        return self._searching

    def _status(self) -> Status:
        for _ in range(TRIES):
            self._line.send(STATUS_QUERY)
            status = self._next_status()
            if status is not None and len(status.position_mm) > max(self._indices.values()):  # else it is damaged
                self._last = status
                return status
        raise self._line.silent("?")

    def _next_status(self) -> Status | None:
        for line in self._line.lines():
            if (status := parse_status(line)) is not None:
                return status
            self._heed(line)
        return None

    def _command(self, text: str) -> list[str]:
        """Send a line and return its answer before the ``ok``; late answers to earlier lines are discarded."""
        for attempt in range(TRIES):
            self._line.discard(QUIET_S if attempt else 0.0)
            self._line.send(f"{text}\n".encode())
            said: list[str] = []
            for line in self._line.lines(REPLY_S):
                if line == "ok":
                    return said
                if line.startswith("error:"):
                    raise RigError(f"The GRBL controller refused '{text}' ({line}): {_words(ERRORS, line)}.")
                self._heed(line)
                said += [line] if line.startswith(("$", "[")) else []
        raise self._line.silent(text)

    def _heed(self, line: str) -> None:
        """Note a reset; raise RigError for an alarm."""
        if line.startswith("Grbl "):
            self._homed = False
        elif line.startswith("ALARM:"):
            self._homed = False
            raise RigError(f"The GRBL controller reports {line}: {_words(ALARMS, line)}.")


def _words(table: Mapping[int, str], line: str) -> str:
    number = line.partition(":")[2]
    return table.get(int(number) if number.isdigit() else -1, "see the list of GRBL 1.1")


DRIVER = ControllerDriver(
    name="grbl",
    title="GRBL 1.1",
    baud=115_200,
    address="[XYZABC]",
    address_words="X, Y, Z, A, B or C",
    connect=GrblController,
    simulate=SimulatedGrbl,
)
