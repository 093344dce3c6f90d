"""Progress and cancellation of long work: two callbacks that every room takes alike."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]
"""Takes the fraction done, 0 to 1."""
ShouldStop = Callable[[], bool]
"""Whether the work should stop."""


def silent(_: float) -> None:
    """Ignore progress."""


def never() -> bool:
    """Never ask to stop."""
    return False
