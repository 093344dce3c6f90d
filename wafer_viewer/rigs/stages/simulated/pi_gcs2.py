"""Simulated PI controller that speaks the General Command Set (GCS 2)."""

from __future__ import annotations

from collections.abc import Mapping

from wafer_viewer.rigs.stages.motion_controller import AxisConfig
from wafer_viewer.rigs.stages.simulated.axis import SimulatedController
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage

IDENTITY = "(c)2026 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC (simulated), 0, 1.0.0.0"
UNKNOWN, NOT_REFERENCED, OUT_OF_RANGE, TOO_FAST, STOPPED, NO_AXIS, BUSY, MOTION_ERROR = 2, 5, 7, 8, 10, 15, 1005, 1024
MOVING, READY, STOP = 5, 7, 24


class SimulatedPi(SimulatedController):
    """A controller whose servos are off and whose axes have no reference at power-up."""

    def __init__(self, clock: VirtualClock, stage: VirtualStage, axes: Mapping[str, AxisConfig]) -> None:
        super().__init__(clock, stage, axes, middle=True)
        self._by_address = {axes[name].address: self.axes[name] for name in axes}
        self._most = {config.address: config.rate(config.speed_um_s) * 1.001 for config in axes.values()}
        self._speeds = dict(self._most)
        self._servos = dict.fromkeys(self._by_address, False)
        self._error = 0
        self._buffer = b""

    def process(self, data: bytes) -> bytes:
        """Process bytes; return the answers to the questions that they complete."""
        answers: list[bytes] = []
        for one in data:
            if one in (MOVING, READY, STOP):
                answers.append(self._byte(one))
            elif one == ord("\n"):
                answers.append(self._line(self._buffer.decode("latin-1")))
                self._buffer = b""
            else:
                self._buffer += bytes([one])
        return b"".join(answers)

    def _byte(self, one: int) -> bytes:
        self._see_stalls()
        if one == MOVING:
            mask = sum(1 << bit for bit, axis in enumerate(self._by_address.values()) if axis.moving)
            return b"%X\n" % mask
        if one == READY:
            return b"\xb0\n" if self._searching() else b"\xb1\n"
        for axis in self._by_address.values():
            axis.stop()
        self._error = STOPPED
        return b""

    def _line(self, text: str) -> bytes:
        self._see_stalls()
        verb, *words = text.split() or [""]
        if verb.endswith("?"):
            return self._answer(verb, words)
        if verb:
            self._error = self._carried_out(verb, words) or self._error
        return b""

    def _answer(self, verb: str, words: list[str]) -> bytes:
        if verb == "ERR?":
            error, self._error = self._error, 0
            return b"%d\n" % error
        if verb == "*IDN?":
            return f"{IDENTITY}\n".encode("latin-1")
        addresses = words or list(self._by_address)
        if verb == "SAI?":
            return _lines(list(self._by_address))
        if self._searching():
            self._error = BUSY
            return b""
        if any(address not in self._by_address for address in addresses):
            self._error = NO_AXIS
            return b""
        match verb:
            case "POS?":
                return _lines([f"{address}={self._by_address[address].units:.7f}" for address in addresses])
            case "FRF?":
                return _lines([f"{address}={self._by_address[address].homed:d}" for address in addresses])
            case "SVO?":
                return _lines([f"{address}={self._servos[address]:d}" for address in addresses])
            case "ONT?":
                return _lines([f"{address}={self._on_target(address):d}" for address in addresses])
            case "VEL?":
                return _lines([f"{address}={self._speeds[address]:.7f}" for address in addresses])
            case _:
                self._error = UNKNOWN
                return b""

    def _carried_out(self, verb: str, words: list[str]) -> int:
        """Carry a command out; return its error, 0 for none."""
        if self._searching() and verb not in ("HLT", "STP"):
            return BUSY
        pairs = dict(zip(words[::2], words[1::2], strict=False))
        addresses = list(pairs) if verb in ("SVO", "ACC", "DEC", "VEL", "MOV") else words or list(self._by_address)
        if any(address not in self._by_address for address in addresses):
            return NO_AXIS
        match verb:
            case "SVO":
                self._servos.update({address: value == "1" for address, value in pairs.items()})
            case "ACC" | "DEC":
                pass
            case "VEL":
                return self._set_speeds({address: float(value) for address, value in pairs.items()})
            case "MOV":
                return self._move({address: float(value) for address, value in pairs.items()})
            case "FRF":
                return self._search(addresses)
            case "HLT" | "STP":
                for address in addresses:
                    self._by_address[address].stop()
                return STOPPED
            case _:
                return UNKNOWN
        return 0

    def _set_speeds(self, speeds: dict[str, float]) -> int:
        if any(not 0 < speed <= self._most[address] for address, speed in speeds.items()):
            return TOO_FAST
        self._speeds.update(speeds)
        return 0

    def _move(self, goals: dict[str, float]) -> int:
        axes = self._by_address
        if any(not (self._servos[address] and axes[address].homed) for address in goals):
            return NOT_REFERENCED
        if any(not axes[address].reachable(goal) for address, goal in goals.items()):
            return OUT_OF_RANGE
        for address, goal in goals.items():
            axes[address].move(goal, self._speeds[address])
        return 0

    def _search(self, addresses: list[str]) -> int:
        if any(not self._servos[address] for address in addresses):
            return NOT_REFERENCED
        for address in addresses:
            self._by_address[address].search()
        return 0

    def _searching(self) -> bool:
        return any(axis.searching for axis in self._by_address.values())

    def _on_target(self, address: str) -> bool:
        return self._servos[address] and not self._by_address[address].moving

    def _see_stalls(self) -> None:
        """Switch the servo of a stalled axis off."""
        for address, axis in self._by_address.items():
            if axis.stalled:
                self._servos[address], self._error, axis.stalled = False, MOTION_ERROR, False


def _lines(texts: list[str]) -> bytes:
    """Return an answer: every line but the last ends with a space."""
    return " \n".join(texts).encode("latin-1") + b"\n"
