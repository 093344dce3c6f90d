"""Lines of text to and from a controller, with a deadline on every wait."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.errors import RigError, RigTimeout

REPLY_S = 0.25
"""Time in s after which a controller does not answer any more: over ten times what they take."""
TRIES = 3
"""Number of times that a command without an answer is sent. All commands name goals, so that once more does no harm."""
QUIET_S = 0.05
"""Silence in s after which no further late answer is expected."""
WAKE_S = 3.0
"""Time in s in which a controller that restarts when its port is opened begins to answer."""
MOST_READS = 100
"""Number of reads after which a controller that never falls silent is taken as it is."""
LONGEST_LINE = 4096
"""Bytes without a line end after which what arrives is no text of a controller."""


class SerialLine:
    """Sender of commands and reader of lines; errors of its port become a RigError that names the device."""

    def __init__(self, port: SerialPort, clock: Clock, device: str) -> None:
        self._port, self._clock, self.device = port, clock, device
        self._buffer = b""

    def send(self, data: bytes) -> None:
        """Send bytes."""
        with self._cable():
            self._port.write(data)

    def line(self, within_s: float = REPLY_S) -> str | None:
        """Return the next line without its line end, or None when none is complete in time."""
        until_s = self._clock.now_s() + within_s
        while b"\n" not in self._buffer:
            left_s = max(0.0, until_s - self._clock.now_s())
            with self._cable():
                self._port.timeout = left_s
                data = self._port.read(max(1, self._port.in_waiting))
            self._buffer = (self._buffer + data)[-LONGEST_LINE:]
            if left_s == 0.0 and b"\n" not in data:
                return None
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode("latin-1").rstrip("\r")

    def lines(self, within_s: float = REPLY_S) -> Generator[str]:
        """Yield lines until none arrives any more within a time that all of them share."""
        until_s = self._clock.now_s() + within_s
        while (line := self.line(max(0.0, until_s - self._clock.now_s()))) is not None:
            yield line
            if self._clock.now_s() > until_s:
                return

    def discard(self, quiet_s: float = 0.0) -> None:
        """Drop what has arrived, and go on until nothing arrives for a time."""
        self._buffer = b""
        with self._cable():
            self._port.timeout = quiet_s
            for _ in range(MOST_READS):
                if not self._port.read(1):
                    return
                self._port.read(self._port.in_waiting)

    def silent(self, command: str) -> RigTimeout:
        """Return the error for a command without an answer."""
        return RigTimeout(
            f"The {self.device} did not answer '{command}' in {TRIES} tries of {REPLY_S:g} s: check its power, its "
            "cable, the port and its speed in the rig's file."
        )

    def close(self) -> None:
        """Close the port."""
        with self._cable():
            self._port.close()

    @contextmanager
    def _cable(self) -> Generator[None]:
        try:
            yield
        except OSError as fault:
            raise RigError(
                f"The {self.device} was lost ({fault.strerror or fault}): check its cable and its power, and open the "
                "rig again."
            ) from fault
