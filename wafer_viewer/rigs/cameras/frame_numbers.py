"""Frame numbers of GigE Vision, USB3 Vision and GenTL as a counter from 0."""

from __future__ import annotations

ID_CYCLE = 65535
"""Period of 16-bit frame numbers, which continue with 1 after 65535."""


class FrameNumbers:
    """Counts frames from 0 by their numbers, which may have 16 bits and need not start anew with each run."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._count = 0

    def count(self, frame_id: int) -> int:
        """Return the count of a complete frame, including the frames missing since the one before."""
        if self._last is None:
            step = 0
        elif frame_id > self._last:
            step = frame_id - self._last
        else:
            step = (frame_id - self._last) % ID_CYCLE
        self._last = frame_id
        self._count += step
        return self._count

    def skip(self) -> None:
        """Record an incomplete frame before the first complete one."""
        if self._last is None:
            self._count += 1
