"""Long campaigns: complete on request, a tenth of them in every ordinary run, drawn by the commit.

A test marked ``campaign`` is drawn as a whole, each set of its parameters by itself; of one marked
``campaign(at_least_one=True)`` every run takes one set or more. Those of a file that are marked
``campaign(together=True)`` are drawn together: they go on from each other, or share what takes long. A test marked
``campaign(within=True)`` always runs and draws its own cases by `drawn_cases`.
"""

from __future__ import annotations

import functools
import os
import subprocess
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
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


def one_drawn(cases: Sequence[T]) -> T:
    """Return one of the cases, another at another commit."""
    return cases[zlib.crc32(draw().encode()) % len(cases)]


def drawn_cases(cases: Iterable[T], name: Callable[[T], str] = str) -> list[T]:
    """Return a tenth of the cases, at least one, or all of them in a complete campaign."""
    cases = list(cases)
    return [case for case in cases if is_drawn(name(case))] or ([one_drawn(cases)] if cases else [])


def drawn(items: Iterable[pytest.Item]) -> set[pytest.Item]:
    """Return the tests of this run: campaigns are drawn, but for a test that was asked for by its name."""
    items = list(items)
    named = any("::" in word for word in items[0].config.invocation_params.args) if items else False
    now = {item for item in items if named or runs_always(item) or is_drawn(drawn_by(item))}
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if (campaign := item.get_closest_marker("campaign")) and campaign.kwargs.get("at_least_one", False):
            cases[item.nodeid.partition("[")[0]].append(item)
    for of_one in cases.values():
        if now.isdisjoint(of_one):
            now.add(one_drawn(of_one))
    return now


def runs_always(item: pytest.Item) -> bool:
    """Return whether a test is no campaign, or draws its cases itself."""
    campaign = item.get_closest_marker("campaign")
    return campaign is None or campaign.kwargs.get("within", False)


def drawn_by(item: pytest.Item) -> str:
    """Return the name by which a test is drawn: that of its file for tests that are drawn together."""
    together = any(mark.kwargs.get("together", False) for mark in item.iter_markers("campaign"))
    return item.nodeid.partition("::")[0] if together else item.nodeid


def drawn_after(always: int, cases: Iterable[T]) -> list[T | ParameterSet]:
    """Return parameters of a test: the first so many in every run, the others as campaigns."""
    cases = list(cases)
    return [*cases[:always], *(pytest.param(case, marks=pytest.mark.campaign) for case in cases[always:])]


def examples(n: int) -> int:
    """Return how many of `n` random examples are tried: all in a complete campaign, else a tenth, at least five."""
    return n if COMPLETE else min(n, max(n // SHARE, 5))
