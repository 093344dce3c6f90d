"""Commands that are killed before random operations on files, and run again (tests/bench/bench_kills.py)."""

from __future__ import annotations

import random

import pytest

from tests.bench.bench_kills import STAGES, Bench, kill_commands
from tests.support.killed_programs import Commands, Tally

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kills")
    with Commands(folder) as commands:
        yield Bench(folder, commands, random.Random(1))


@pytest.mark.parametrize(
    ("stage", "n_kills"),
    [
        ("scan", 1),
        *(
            pytest.param(stage, n, marks=pytest.mark.campaign)
            for stage, n in (("scan", 4), ("heights", 2), ("stitch", 2), ("results", 1), ("export", 1))
        ),
    ],
)
def test_a_kill_loses_and_alters_nothing_and_is_in_the_way_of_nothing(bench, stage, n_kills):
    assert stage in STAGES
    tally = Tally()
    kill_commands(bench, stage, tally, n_kills)
    assert (tally.kills, tally.lost, tally.differ, tally.blocked) == (n_kills, 0, 0, 0), tally.remarks
