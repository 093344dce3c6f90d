"""Serial ports of this machine, and its clock."""

from __future__ import annotations

import time
from typing import cast

from wafer_viewer.model.acquisition.devices import SerialPort
from wafer_viewer.model.errors import RigError

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


def open_port(name: str, baud: int) -> SerialPort:
    """Open a serial port for this process alone. Raises RigError that names the ports of this machine."""
    import serial
    from serial.tools import list_ports

    try:
        port = serial.Serial(name, baud, timeout=0.0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as fault:
        there = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        raise RigError(
            f"The port {name} cannot be opened ({fault}): check its name, its cable and the right to use it; close "
            f"other programs that use it. Ports of this machine: {there}."
        ) from fault
    return cast(SerialPort, port)
