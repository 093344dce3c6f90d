"""Progress and cancellation of long computations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
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


def part_of(progress: Progress, begin: float, end: float) -> Progress:
    """Return the progress of a part of a computation, which takes the fractions from begin to end of the whole."""
    return partial(_tell_part, progress, begin, end)


def _tell_part(progress: Progress, begin: float, end: float, share: float) -> None:
    progress(begin + (end - begin) * share)


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
