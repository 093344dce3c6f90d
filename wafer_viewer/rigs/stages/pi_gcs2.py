"""PI controllers, by the PI General Command Set (GCS 2), in mm.

A question ends with ``?`` and is answered; a command is not answered, its error is asked for by ``ERR?``. Answers have
no ids: after one that was late or does not fit, the line is cleared before the question is repeated. A single byte 5
asks which axes move, byte 7 whether the controller is ready, byte 24 stops everything.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from typing import TypeVar

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.stages.motion_controller import QUIET_S, TRIES, ControllerAxis, ControllerDriver, SerialLine
from wafer_viewer.rigs.stages.simulated.pi_gcs2 import SimulatedPi

T = TypeVar("T")
MOVING, READY, STOP = "\x05", "\x07", "\x18"
IS_READY = "\xb1"
POSITION, FLAG = re.compile(r"[-+]?\d+\.\d+([eE][-+]?\d+)?"), re.compile("[01]")
"""Forms of an answer: positions have a decimal point."""
UNKNOWN_COMMAND, STOPPED_BY_COMMAND = 2, 10
ERRORS = {
    1: "a parameter is damaged: check the cable",
    2: "it does not know the command: update its firmware",
    5: "the axis is not referenced or its servo is off: home it",
    7: "the goal is out of its range: correct the range in the rig's file, or its limits",
    8: "the speed is out of its range: lower it in the rig's file",
    10: "it was stopped: home it where a search was interrupted",
    15: "it has no such axis: correct the address in the rig's file",
    17: "a value is out of its range: correct speed and acceleration in the rig's file",
    23: "it has no such axis: correct the address in the rig's file",
    50: "its search is disabled: enable it by RON and check its switches",
    52: "it noticed a damaged line: check the cable",
    63: "it still starts: wait for it",
    1005: "it is busy with a search: wait for it or stop it",
    1024: "the position error became too large and the servo was switched off: clear the way, home it and continue",
    1025: "the motor gives all it can: check its load and home it",
}
"""Errors with the mend."""


class PiController:
    """Implementation of MotionController on one PI controller or a stack of them behind one port."""

    def __init__(self, port: SerialPort, clock: Clock, axes: Mapping[str, ControllerAxis]) -> None:
        self._line = SerialLine(port, clock, "PI controller")
        self._names = {axis.address: name for name, axis in axes.items()}
        self._addresses = {name: axis.address for name, axis in axes.items()}
        self._searching: set[str] = set()
        self._last = dict.fromkeys(axes, 0.0)
        self._line.discard(QUIET_S)
        self._error()
        self._order = self._ask("SAI?", lambda lines: [line.strip() for line in lines])
        for name, axis in axes.items():
            if axis.address not in self._order:
                raise RigError(
                    f"The PI controller has no axis '{axis.address}' for {name}: its axes are {', '.join(self._order)}."
                )
            for verb in ("ACC", "DEC"):
                self._command(f"{verb} {axis.address} {axis.acceleration:.6f}", also=(UNKNOWN_COMMAND,))

    def identity(self) -> str:
        """Return its maker, type, serial number and firmware."""
        return self._ask("*IDN?", lambda lines: lines[0] if lines[0].count(",") >= 2 else None)

    def positions(self) -> Mapping[str, float]:
        """Return the positions in mm; the last known ones during a search, in which it may not answer."""
        if not self._searching:
            self._last = self._values("POS?", POSITION)
        return self._last

    def moving(self) -> Collection[str]:
        """Return the axes that move, search or are not on their goal. Raises RigError when one stopped by a fault."""
        if self._searching:
            if not self._ask(READY, lambda lines: {IS_READY: True, "\xb0": False}.get(lines[0])):
                return set(self._searching)
            self._searching.clear()
        mask = self._ask(MOVING, lambda lines: int(lines[0], 16))
        moving = {address for bit, address in enumerate(self._order) if mask >> bit & 1} & set(self._names)
        self._require_no_error("motion", also=(STOPPED_BY_COMMAND,))
        if not moving:
            servo, on_target = self._values("SVO?", FLAG), self._values("ONT?", FLAG)
            return [name for name in self._addresses if servo[name] and not on_target[name]]
        return [self._names[address] for address in moving]

    def homed(self) -> Collection[str]:
        """Return the axes that have a reference and whose servo is on; it is off after a fault and after power-up."""
        if self._searching:
            return []
        referenced, servo = self._values("FRF?", FLAG), self._values("SVO?", FLAG)
        return [name for name in self._addresses if referenced[name] and servo[name]]

    def home(self, axes: Collection[str]) -> None:
        """Switch the servos on and begin to move to the reference switches."""
        self._command("SVO " + " ".join(f"{self._addresses[name]} 1" for name in axes))
        self.positions()
        self._command("FRF " + " ".join(self._addresses[name] for name in axes))
        self._searching = set(axes)

    def move(self, goals: Mapping[str, float], speeds: Mapping[str, float]) -> None:
        """Begin to move all axes together, after the speeds were set."""
        self._command("VEL " + " ".join(f"{self._addresses[name]} {speeds[name]:.6f}" for name in goals))
        self._command("MOV " + " ".join(f"{self._addresses[name]} {goal:.6f}" for name, goal in goals.items()))

    def stop(self) -> None:
        """Halt all axes; a search is ended by byte 24, as the controller is busy with it."""
        if self._searching:
            self._line.send(STOP.encode())
            self._searching.clear()
            self._require_no_error("stop", also=(STOPPED_BY_COMMAND,))
        else:
            self._command("HLT " + " ".join(self._addresses.values()), also=(STOPPED_BY_COMMAND,))

    def close(self) -> None:
        """Close the port."""
        self._line.close()

    def _command(self, text: str, also: Collection[int] = ()) -> None:
        """Send a command and raise RigError for its error, except for some."""
        self._line.send(f"{text}\n".encode())
        self._require_no_error(text, also)

    def _require_no_error(self, what: str, also: Collection[int] = ()) -> None:
        if (error := self._error()) != 0 and error not in also:
            raise RigError(f"The PI controller reports error {error} after '{what}': {_words(error)}.")

    def _error(self) -> int:
        return self._ask("ERR?", lambda lines: int(lines[0]))

    def _values(self, question: str, form: re.Pattern[str]) -> dict[str, float]:
        """Return what a question says of every axis, by name; answers of another form belong to another question."""

        def parsed(lines: list[str]) -> dict[str, float] | None:
            pairs = [line.strip().partition("=") for line in lines]
            values = {key: value for key, _, value in pairs if form.fullmatch(value)}
            if sorted(values) != sorted(self._names) or len(pairs) != len(values):
                return None
            return {self._names[key]: float(value) for key, value in values.items()}

        return self._ask(f"{question} {' '.join(self._names)}", parsed)

    def _ask(self, question: str, parse: Callable[[list[str]], T | None]) -> T:
        """Return the answer to a question; one that is damaged, foreign or missing is asked for again."""
        for attempt in range(TRIES):
            self._line.discard(QUIET_S if attempt else 0.0)
            self._line.send(question.encode("latin-1") + (b"" if len(question) == 1 else b"\n"))
            lines: list[str] = []
            for line in self._line.lines():
                lines.append(line)
                if not line.endswith(" "):
                    break
            try:
                answer = parse(lines) if lines else None
            except ValueError:
                continue
            if answer is not None:
                return answer
        raise self._line.silent(question if len(question) > 1 else f"byte {ord(question)}")


def _words(error: int) -> str:
    return ERRORS.get(error, "see PI's list of error codes")


DRIVER = ControllerDriver(
    name="pi_gcs2",
    title="PI, General Command Set 2",
    baud=115_200,
    address=r"[A-Z0-9]+",
    address_words="the axis as in SAI?, such as 1",
    connect=PiController,
    simulate=SimulatedPi,
)
