"""Long campaigns: complete on request, a tenth of them in every ordinary run, drawn by the commit.

A test marked ``campaign`` is drawn as a whole, each set of its parameters by itself. One marked
``campaign(within=True)`` always runs and draws its own cases by `drawn_cases`.
"""

from __future__ import annotations

import functools
import os
import subprocess
import zlib
from collections.abc import Callable, Iterable
from typing import TypeVar

import pytest
from _pytest.mark.structures import ParameterSet

from tests.support.paths import ROOT

T = TypeVar("T")
SHARE = 10
"""An ordinary run takes one case in so many."""
COMPLETE = os.environ.get("WAFER_VIEWER_CAMPAIGNS") == "all"
"""Whether this run takes all cases, as `bash tests/run.sh campaigns` does."""


@functools.cache
def draw() -> str:
    """Return what the cases are drawn by: ``WAFER_VIEWER_DRAW``, the commit, or a fixed text outside of git."""
    if given := os.environ.get("WAFER_VIEWER_DRAW"):
        return given
    asked = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    return asked.stdout.strip() or "no commit"


def is_drawn(case: str) -> bool:
    """Return whether a case, by a name that stays, is run."""
    return COMPLETE or (zlib.crc32(case.encode()) + zlib.crc32(draw().encode())) % SHARE == 0


def drawn_cases(cases: Iterable[T], name: Callable[[T], str] = str) -> list[T]:
    """Return a tenth of the cases, at least one, or all of them in a complete campaign."""
    cases = list(cases)
    one = zlib.crc32(draw().encode()) % max(len(cases), 1)
    return [case for case in cases if is_drawn(name(case))] or cases[one : one + 1]


def drawn_after(always: int, cases: Iterable[T]) -> list[T | ParameterSet]:
    """Return parameters of a test: the first so many in every run, the others as campaigns."""
    cases = list(cases)
    return [*cases[:always], *(pytest.param(case, marks=pytest.mark.campaign) for case in cases[always:])]


def examples(n: int) -> int:
    """Return how many of `n` random examples are tried: all in a complete campaign, else a tenth, at least five."""
    return n if COMPLETE else min(n, max(n // SHARE, 5))
