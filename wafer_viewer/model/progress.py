"""Progress and cancellation of long computations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from wafer_viewer.model.errors import DatasetError

Progress = Callable[[float], None]
"""Receives the completed fraction, 0 to 1."""
ShouldStop = Callable[[], bool]
"""Returns True if the computation should stop."""


def silent(_: float) -> None:
    """Ignore progress."""


def never() -> bool:
    """Return False: never stop."""
    return False


T = TypeVar("T")


def with_progress(
    items: Iterable[T], total: int, what: str, progress: Progress | None, should_stop: ShouldStop | None
) -> Iterator[T]:
    """Yield the items and report the completed fraction after each. Raises DatasetError when stopped."""
    for done, item in enumerate(items, 1):
        if should_stop is not None and should_stop():
            raise DatasetError(f"{what} was stopped at {done - 1} of {total}. Nothing was kept of it.")
        yield item
        if progress is not None:
            progress(done / total)
