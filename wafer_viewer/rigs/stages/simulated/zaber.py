"""Simulated chain of Zaber devices that speak the Zaber ASCII protocol."""

from __future__ import annotations

from collections.abc import Mapping

from wafer_viewer.rigs.stages.motion_controller import AxisConfig
from wafer_viewer.rigs.stages.simulated.axis import SimulatedAxis, SimulatedController
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage

SPEED_UNIT = 1.6384
"""Settings of speed for a microstep/s."""
Place = tuple[int, int]
Answer = tuple[str, str]
OK: Answer = "OK", "0"
SETTINGS = {
    "deviceid": "30342",
    "version": "7.35",
    "version.build": "15000",
    "system.serial": "123456",
    "system.access": "1",
    "comm.protocol": "2",
    "comm.alert": "0",
    "comm.command.packets.max": "1",
    "comm.packet.size.max": "80",
    "comm.word.size.max": "50",
    "device.hw.modified": "0",
}


def checksum(body: bytes) -> int:
    """Return the byte that makes the sum of all bytes 0."""
    return (256 - sum(body) % 256) % 256


class SimulatedZaber(SimulatedController):
    """The axes of all devices of a chain."""

    def __init__(self, clock: VirtualClock, stage: VirtualStage, axes: Mapping[str, AxisConfig]) -> None:
        super().__init__(clock, stage, axes)
        self._places: dict[Place, SimulatedAxis] = {}
        self._speeds: dict[Place, float] = {}
        for name, config in axes.items():
            device, axis = (config.address + " 1").split()[:2]
            self._places[int(device), int(axis)] = self.axes[name]
            self._speeds[int(device), int(axis)] = config.rate(config.speed_um_s) * SPEED_UNIT
        self._checksums = dict.fromkeys((device for device, _ in self._places), False)
        self._buffer = b""

    def process(self, data: bytes) -> bytes:
        """Process bytes; return the replies to the commands that they complete."""
        self._buffer += data
        *lines, self._buffer = self._buffer.replace(b"\r", b"\n").split(b"\n")
        return b"".join(self._replies(line) for line in lines if line.startswith(b"/"))

    def _replies(self, line: bytes) -> bytes:
        """Return the replies of all addressed devices; a damaged command has none."""
        body, colon, given = line[1:].partition(b":")
        if colon and given != b"%02X" % checksum(body):
            return b""
        words = body.decode("latin-1").split()
        numbers = [int(words.pop(0)) for _ in range(3) if words and words[0].isdigit()]
        device, axis = [*numbers, 0, 0][:2]
        number = f"{numbers[2]:02d} " if len(numbers) > 2 else ""
        devices = sorted(self._checksums) if device == 0 else [device] if device in self._checksums else []
        return b"".join(self._reply(one, axis, number, words) for one in devices)

    def _reply(self, device: int, axis: int, number: str, words: list[str]) -> bytes:
        places = [place for place in self._places if place[0] == device and axis in (0, place[1])]
        verdict, data = self._carried_out(device, places, words) if places else ("RJ", "BADAXIS")
        busy = "BUSY" if any(self._places[place].moving for place in places) else "IDLE"
        flags = [flag for place in places for flag in self._flags(place)]
        body = f"{device:02d} {axis} {number}{verdict} {busy} {flags[0] if flags else '--'} {data}".encode()
        return b"@" + body + (b":%02X" % checksum(body) if self._checksums[device] else b"") + b"\r\n"

    def _flags(self, place: Place) -> list[str]:
        axis = self._places[place]
        return ["FS"] * axis.stalled + ["WR"] * (not axis.homed and not axis.searching)

    def _carried_out(self, device: int, places: list[Place], words: list[str]) -> Answer:
        match words:
            case []:
                return OK
            case ["get", setting]:
                return self._value(device, places, setting)
            case ["set", setting, value]:
                return self._set(device, places, setting, value)
            case ["warnings", *clear]:
                flags = [flag for place in places for flag in self._flags(place)]
                for place in places if clear else []:
                    self._places[place].stalled = False
                return "OK", " ".join([f"{len(flags):02d}", *flags])
            case ["home"]:
                for place in places:
                    self._places[place].search()
                return OK
            case ["stop"]:
                for place in places:
                    self._places[place].stop()
                return OK
            case ["move", kind, *values]:
                return self._move(places, kind, [float(value) for value in values])
            case _:
                return "RJ", "BADCOMMAND"

    def _value(self, device: int, places: list[Place], setting: str) -> Answer:
        if setting in ("pos", "encoder.pos"):
            return "OK", " ".join(str(round(self._places[place].units)) for place in places)
        if setting == "maxspeed":
            return "OK", " ".join(str(round(self._speeds[place])) for place in places)
        if setting == "system.axiscount":
            return "OK", str(sum(place[0] == device for place in self._places))
        if setting == "comm.address":
            return "OK", str(device)
        return ("OK", SETTINGS[setting]) if setting in SETTINGS else ("RJ", "BADCOMMAND")

    def _set(self, device: int, places: list[Place], setting: str, value: str) -> Answer:
        if setting == "comm.checksum":
            self._checksums[device] = value == "1"
        elif setting == "maxspeed":
            if float(value) < 1:
                return "RJ", "BADDATA"
            self._speeds.update(dict.fromkeys(places, float(value)))
        elif setting not in ("accel", "comm.alert"):
            return "RJ", "BADCOMMAND"
        return OK

    def _move(self, places: list[Place], kind: str, values: list[float]) -> Answer:
        """Begin a motion to a position, over a distance, or at a velocity until the end of the travel."""
        for place in places:
            axis, speed = self._places[place], self._speeds[place] / SPEED_UNIT
            match kind, values:
                case "abs", [goal]:
                    pass
                case "rel", [way]:
                    goal = axis.units + way
                case "vel", [velocity]:
                    goal, speed = axis.end(velocity), abs(velocity) / SPEED_UNIT
                case _:
                    return "RJ", "BADDATA"
            if not axis.reachable(goal):
                return "RJ", "BADDATA"
            axis.move(goal, speed)
        return OK
