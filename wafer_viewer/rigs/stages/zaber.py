"""Zaber controllers, by the Zaber ASCII protocol (firmware 6 and 7), in microsteps.

A command is ``/device axis id command:checksum``, its reply ``@device axis id OK|RJ IDLE|BUSY flag data:checksum``. The
checksum is the two's complement of the sum of the bytes between. The id tells a reply from a late one.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import NamedTuple

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.stages.motion_controller import TRIES, ControllerAxis, ControllerDriver, SerialLine
from wafer_viewer.rigs.stages.simulated.zaber import SimulatedZaber

SPEED_UNIT = 1.6384
"""Settings of speed for a microstep/s."""
ACCELERATION_UNIT = 1.6384e-4
"""Settings of acceleration for a microstep/s^2."""
N_IDS = 100
REPLY = re.compile(r"@(\d\d) (\d) (?:(\d\d) )?(OK|RJ) (IDLE|BUSY) (\S\S) ([^:]*)(?::([0-9A-F]{2}))?")

NOT_HOMED = ("WR", "WH")
FAULTS = {
    "FF": "a critical system error: switch the controller off and on, and ask Zaber if it comes back",
    "FN": "a stage that this controller does not support: connect the right one",
    "FZ": "no stage at its connector: connect it with the power off, and activate it",
    "FH": "the emergency stop is pressed: release it when the way is clear",
    "FV": "the supply voltage is out of range: check the power supply",
    "FO": "its driver is disabled: enable it",
    "FC": "a current inrush: check the power supply",
    "FM": "the motor is too hot: let it cool down and check its load",
    "FD": "its driver is disabled: check temperature, voltage and the emergency stop, and switch it off and on",
    "FQ": "the encoder has an error, so that its position is lost: check its cable, and home it",
    "FI": "an index mark was not found: check the encoder, and home it",
    "FA": "the encoder is out of step: home it",
    "FR": "the limit of overdrive is exceeded: check its load",
    "FS": "it stalled and stopped: clear its way, home it and continue",
    "FP": "it left its path: check its load",
    "FE": "a limit switch stopped it: check the range in the rig's file, and home it",
    "FT": "it is twisted: check its load",
}
"""Flags of a stopped axis, with the mend."""
REJECTED = {
    "BADDATA": "the value is out of its range: compare range, speed and microsteps in the rig's file with the stage",
    "BADCOMMAND": "it does not know the command: update its firmware",
    "BADAXIS": "it has no such axis: correct the address in the rig's file",
    "BUSY": "it is busy: wait for it or stop it",
    "STATUSBUSY": "it cannot do so during a motion: wait for it or stop it",
    "DRIVERDISABLED": "its driver is disabled: check the emergency stop and the power, and enable it",
    "LOCKSTEP": "it is locked to another axis: address that axis",
    "PARKED": "it is parked: unpark it",
    "REMOTE": "it is controlled by another interface: end that",
}


class ZaberReply(NamedTuple):
    """ZaberReply of a controller."""

    source: tuple[int, int]
    number: int | None
    accepted: bool
    busy: bool
    flag: str
    data: str


def checksum(body: str) -> str:
    """Return the checksum of the text between the first character and the colon, as two hex digits."""
    return f"{-sum(body.encode('latin-1')) & 0xFF:02X}"


def parse(line: str) -> ZaberReply | None:
    """Return a reply, or None for a damaged line and for anything else than a reply."""
    found = REPLY.fullmatch(line)
    if found is None or (found[8] and checksum(line[1 : line.rindex(":")]) != found[8]):
        return None
    number = int(found[3]) if found[3] else None
    return ZaberReply((int(found[1]), int(found[2])), number, found[4] == "OK", found[5] == "BUSY", found[6], found[7])


class ZaberController:
    """Implementation of MotionController on a chain of Zaber devices."""

    def __init__(self, port: SerialPort, clock: Clock, axes: Mapping[str, ControllerAxis]) -> None:
        self._line = SerialLine(port, clock, "Zaber controller")
        self._axes = axes
        self._places = {name: _place(axis.address) for name, axis in axes.items()}
        self._number = 0
        self._lost: set[str] = set()
        """Axes that had a fault and were not homed since."""
        for device in sorted({device for device, _ in self._places.values()}):
            self._ask((device, 0), "set comm.checksum 1")
        for name, axis in axes.items():
            self._ask(self._places[name], f"set accel {max(1, round(axis.acceleration * ACCELERATION_UNIT))}")

    def identity(self) -> str:
        """Return the devices of the chain with their firmware."""
        devices = sorted({device for device, _ in self._places.values()})
        return ", ".join(
            f"Zaber device {device}: id {self._ask((device, 0), 'get deviceid').data}, "
            f"firmware {self._ask((device, 0), 'get version').data}"
            for device in devices
        )

    def positions(self) -> Mapping[str, float]:
        """Return the positions in microsteps, by the encoder where there is one."""
        return {name: self._number_of(place, "get pos") for name, place in self._places.items()}

    def moving(self) -> Collection[str]:
        """Return the axes that move. Raises RigError once when one has stopped by a fault; it has to be homed then."""
        replies = {name: self._ask(place, "") for name, place in self._places.items()}
        for name, reply in replies.items():
            if (fault := FAULTS.get(reply.flag)) is not None:
                self._lost.add(name)
                self._ask(self._places[name], "warnings clear")
                raise RigError(f"The {name} axis of the Zaber controller reports {reply.flag}: {fault}.")
        return [name for name, reply in replies.items() if reply.busy]

    def homed(self) -> Collection[str]:
        """Return the axes that have a reference, and no fault since."""
        flags = {name: self._ask(place, "warnings").data.split() for name, place in self._places.items()}
        return [name for name, warned in flags.items() if name not in self._lost and not {*warned} & {*NOT_HOMED}]

    def home(self, axes: Collection[str]) -> None:
        """Begin to search the references."""
        for name in axes:
            self._ask(self._places[name], "home")
        self._lost -= set(axes)

    def move(self, goals: Mapping[str, float], speeds: Mapping[str, float]) -> None:
        """Begin to move, after the speeds were set."""
        for name in goals:
            self._ask(self._places[name], f"set maxspeed {max(1, round(speeds[name] * SPEED_UNIT))}")
        for name, goal in goals.items():
            self._ask(self._places[name], f"move abs {round(goal)}")

    def stop(self) -> None:
        """Decelerate every axis to a halt: all by one line to all devices, then each until it has answered."""
        self._line.send(f"/0 0 stop:{checksum('0 0 stop')}\n".encode())
        for place in self._places.values():
            self._ask(place, "stop")

    def close(self) -> None:
        """Close the port."""
        self._line.close()

    def _number_of(self, place: tuple[int, int], command: str) -> float:
        reply = self._ask(place, command)
        try:
            return float(reply.data)
        except ValueError:
            raise RigError(
                f"The Zaber controller answered '{command}' by '{reply.data}', which is no number."
            ) from None

    def _ask(self, place: tuple[int, int], command: str) -> ZaberReply:
        """Send a command and return its reply; one that is not answered in time is sent again with another id."""
        for _ in range(TRIES):
            self._number = (self._number + 1) % N_IDS
            body = f"{place[0]} {place[1]} {self._number:02d} {command}".rstrip()
            self._line.send(f"/{body}:{checksum(body)}\n".encode())
            for line in self._line.lines():
                reply = parse(line)
                if reply is None or (reply.source, reply.number) != (place, self._number):
                    continue
                if not reply.accepted:
                    why = REJECTED.get(reply.data, "see Zaber's list of rejection reasons")
                    at = f"device {place[0]}, axis {place[1]}"
                    raise RigError(f"The Zaber controller ({at}) rejected '{command}' ({reply.data}): {why}.")
                return reply
        raise self._line.silent(command or "status")


def _place(address: str) -> tuple[int, int]:
    """Return device and axis of an address such as ``1 2``; ``1`` is axis 1 of device 1."""
    device, _, axis = address.partition(" ")
    return int(device), int(axis or 1)


DRIVER = ControllerDriver(
    name="zaber",
    title="Zaber, ASCII protocol",
    baud=115_200,
    address=r"[1-9]\d?( [1-9])?",
    address_words="device and axis, such as '1 2', or '1' for its first axis",
    connect=ZaberController,
    simulate=SimulatedZaber,
)
