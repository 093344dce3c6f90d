"""Iteration that reports its progress and can be stopped."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop

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
