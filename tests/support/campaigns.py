"""Long campaigns: complete on request, a tenth of them in every ordinary run, the same tenth each time.

A test marked ``campaign`` is drawn as a whole, each set of its parameters by itself. One marked
``campaign(within=True)`` always runs and draws its own cases by `drawn_cases`.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterable
from typing import TypeVar

import pytest
from _pytest.mark.structures import ParameterSet

T = TypeVar("T")
SHARE = 10
"""An ordinary run takes one case in so many."""
COMPLETE = os.environ.get("WAFER_VIEWER_CAMPAIGNS") == "all"
"""Whether this run takes all cases, as `bash tests/run.sh campaigns` does."""


DRAW = os.environ.get("WAFER_VIEWER_DRAW", "an ordinary run")
"""What the cases are drawn by: an ordinary run of the same sources tries the same cases."""


def is_drawn(case: str) -> bool:
    """Return whether a case, by a name that stays, is run."""
    return COMPLETE or (zlib.crc32(case.encode()) + zlib.crc32(DRAW.encode())) % SHARE == 0


def drawn_cases(cases: Iterable[T], name: Callable[[T], str] = str) -> list[T]:
    """Return a tenth of the cases, at least one, or all of them in a complete campaign."""
    cases = list(cases)
    one = zlib.crc32(DRAW.encode()) % max(len(cases), 1)
    return [case for case in cases if is_drawn(name(case))] or cases[one : one + 1]


def drawn_after(always: int, cases: Iterable[T]) -> list[T | ParameterSet]:
    """Return parameters of a test: the first so many in every run, the others as campaigns."""
    cases = list(cases)
    return [*cases[:always], *(pytest.param(case, marks=pytest.mark.campaign) for case in cases[always:])]


def examples(n: int) -> int:
    """Return how many of `n` random examples are tried: all in a complete campaign, else a tenth, at least five."""
    return n if COMPLETE else min(n, max(n // SHARE, 5))
