"""Callbacks for progress and cancellation of long computations."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]
"""Receives the completed fraction, 0 to 1."""
ShouldStop = Callable[[], bool]
"""Returns True if the computation should stop."""


def silent(_: float) -> None:
    """Ignore progress."""


def never() -> bool:
    """Return False: never stop."""
    return False
