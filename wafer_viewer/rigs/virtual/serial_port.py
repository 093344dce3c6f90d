"""Virtual serial port: pyserial's interface on one end, a virtual device on the other, with line faults."""

from __future__ import annotations

import errno
import os
from typing import Annotated, ClassVar, Protocol

import numpy as np

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Spec, Within
from wafer_viewer.rigs.virtual.clock import VirtualClock

LATENCY_S = 0.000175
"""One-way latency, half the round trip measured over a pseudo-terminal."""

Share = Annotated[float, Within(0, 0.5)]


class Interference(Spec, frozen=True, kw_only=True):
    """Line faults in both directions: fraction of lines lost, and fraction damaged."""

    error: ClassVar[type[WaferViewerError]] = RigError
    lost_fraction: Share = 0.0
    damaged_fraction: Share = 0.0
    seed: int = 0


class Device(Protocol):
    """Protocol of the device at the far end of a port."""

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Process bytes that arrive at a time; return the immediate answer."""
        ...


class VirtualPort:
    """Implementation of SerialPort; bytes reach the device, and the answer the reader, after a latency."""

    def __init__(self, clock: VirtualClock, device: Device, interference: Interference | None = None) -> None:
        self.timeout: float | None = None
        self._clock = clock
        self._device = device
        self._wire = interference or Interference()
        self._rng = np.random.default_rng(self._wire.seed)
        self._arrived = bytearray()
        self.has_room = True
        self._lost = False

    def pull_cable(self) -> None:
        """Lose the line; further calls raise OSError, as of a port on USB."""
        self._lost = True

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read without waiting."""
        self._check_open()
        self._clock.catch_up()
        return len(self._arrived)

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes, fewer on timeout."""
        self._check_open()
        self._clock.wait_for(lambda: len(self._arrived) >= size, self.timeout or 0.0)
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def write(self, data: bytes, /) -> int:
        """Send bytes."""
        self._check_open()
        on_wire = self._disturbed(data)
        self._clock.at(self._clock.now_s() + LATENCY_S, lambda t: self.deliver(self._device.receive(on_wire, t), t))
        return len(data)

    def close(self) -> None:
        """Close the port."""
        self.has_room = False

    def deliver(self, data: bytes, time_s: float) -> None:
        """Send bytes from the device, which reach the reader after the latency."""
        if data:
            on_wire = self._disturbed(data)
            self._clock.at(time_s + LATENCY_S, lambda _: self._arrived.extend(on_wire))

    def _check_open(self) -> None:
        if not self.has_room:
            raise RigError("The virtual pulse box's port is closed: open the rig again.")
        if self._lost:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def _disturbed(self, data: bytes) -> bytes:
        if self._wire.lost_fraction == self._wire.damaged_fraction == 0:
            return data
        return b"".join(self._disturbed_line(line) for line in data.splitlines(keepends=True))

    def _disturbed_line(self, line: bytes) -> bytes:
        fate = self._rng.uniform()
        if fate < self._wire.lost_fraction:
            return b""
        if fate < self._wire.lost_fraction + self._wire.damaged_fraction:
            at = int(self._rng.integers(len(line)))
            return line[:at] + bytes([line[at] ^ (1 << int(self._rng.integers(8)))]) + line[at + 1 :]
        return line
