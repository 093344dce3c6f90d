"""Serial ports of this machine, and its clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar, cast

from wafer_viewer.model.acquisition.devices import SerialPort
from wafer_viewer.model.errors import RigError

if TYPE_CHECKING:
    from serial.tools.list_ports_common import ListPortInfo

T = TypeVar("T")
USB_NAME = "usb:"
"""Beginning of the name of a port that is found by the product name or the serial number of its device on USB."""
WRITE_TIMEOUT_S = 1.0
"""Time after which a port that accepts no bytes has failed, s."""


class SystemClock:
    """Implementation of Clock for real devices: the monotonic clock of this machine."""

    def __init__(self) -> None:
        self._origin_s = time.monotonic()

    def now_s(self) -> float:
        """Return the seconds since the rig was opened."""
        return time.monotonic() - self._origin_s

    def sleep(self, seconds: float) -> None:
        """Wait for a number of seconds."""
        time.sleep(max(0.0, seconds))


class ReopenedPort:
    """Implementation of SerialPort that opens a lost port again when its device is back.

    A device on USB takes its port along when it restarts or its cable is pulled. Until it is back, nothing is read and
    what is written is lost, as on a line to a silent device.

    name, baud : as for `open_port`, whose RigError it raises where the port cannot be opened at first.
    """

    def __init__(self, name: str, baud: int) -> None:
        self.timeout: float | None = 0.0
        self._name, self._baud = name, baud
        self._port: SerialPort | None = open_port(name, baud)

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read without waiting."""
        return self._attempt(lambda port: port.in_waiting) or 0

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes, fewer on timeout."""
        if self._port is None:
            time.sleep(self.timeout or 0.0)
        return self._attempt(lambda port: self._read(port, size)) or b""

    def write(self, data: bytes, /) -> int:
        """Send bytes, after opening the port again if it was lost."""
        if self._port is None:
            with suppress(RigError):
                self._port = open_port(self._name, self._baud)
        return self._attempt(lambda port: port.write(data)) or 0

    def close(self) -> None:
        """Close the port."""
        self._attempt(lambda port: port.close())

    def _read(self, port: SerialPort, size: int) -> bytes:
        port.timeout = self.timeout
        return port.read(size)

    def _attempt(self, use: Callable[[SerialPort], T]) -> T | None:
        """Use the port; None where it is lost, now or since an earlier attempt."""
        if self._port is None:
            return None
        try:
            return use(self._port)
        except OSError:
            lost, self._port = self._port, None
            with suppress(OSError):
                lost.close()
            return None


def open_port(name: str, baud: int) -> SerialPort:
    """Open a serial port for this process alone. Raises RigError that names the ports of this machine.

    name : device, as /dev/ttyACM0 or COM3, or `USB_NAME` and the product name or serial number of a device on USB.
    """
    import serial
    from serial.tools import list_ports

    ports = sorted(list_ports.comports())
    try:
        device = _device(name, ports)
        port = serial.Serial(device, baud, timeout=0.0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as fault:
        there = ", ".join(_description(port) for port in ports) or "none"
        raise RigError(
            f"The port {name} cannot be opened ({fault}): check its name, its cable and the right to use it; close "
            f"other programs that use it. Ports of this machine: {there}."
        ) from fault
    return cast(SerialPort, port)


def _device(name: str, ports: Sequence[ListPortInfo]) -> str:
    """Return the device of a port. Raises OSError unless exactly one has the name."""
    if not name.startswith(USB_NAME):
        return name
    wanted = name.removeprefix(USB_NAME).casefold()
    found = [port.device for port in ports if wanted in (own.casefold() for own in _usb_names(port))]
    if len(found) != 1:
        several = (
            f"{', '.join(found)} have this name: use a serial number" if found else "no device on USB has this name"
        )
        raise OSError(several)
    return found[0]


def _usb_names(port: ListPortInfo) -> list[str]:
    return [own for own in (port.product, port.serial_number) if own]


def _description(port: ListPortInfo) -> str:
    names = " or ".join(USB_NAME + own for own in _usb_names(port))
    return f"{port.device} ({names})" if names else port.device
