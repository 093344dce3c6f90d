"""Partition of a window into pieces that are each covered by a constant set of fields."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence

Part = tuple[slice, slice]
"""Rows and columns."""


def pieces(window: Part, parts: Sequence[Part]) -> Iterator[tuple[Part, list[int]]]:
    """Yield the pieces of a window from top to bottom, with the indices of the parts that cover each.

    Together the pieces form the window.
    """
    rows, cols = window
    for band in _cut(rows, (part[0] for part in parts)):
        here = [n for n, (of_part, _) in enumerate(parts) if _holds(of_part, band)]
        for strip in _cut(cols, (parts[n][1] for n in here)):
            yield (band, strip), [n for n in here if _holds(parts[n][1], strip)]


def _cut(whole: slice, parts: Iterable[slice]) -> Iterator[slice]:
    """Split a range of pixels wherever a part begins or ends."""
    inside = {end for part in parts for end in (part.start, part.stop) if whole.start < end < whole.stop}
    ends = [whole.start, *sorted(inside), whole.stop]
    return (slice(a, b) for a, b in itertools.pairwise(ends))


def _holds(part: slice, run: slice) -> bool:
    return part.start <= run.start and run.stop <= part.stop
