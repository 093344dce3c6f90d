"""Mutated inputs of every reader of what comes from outside: a surface or one sentence, soon and with little memory.

tests/bench/bench_fuzz.py runs many more.
"""

from __future__ import annotations

import pytest

from tests.support.fuzzing import feed, inputs, memory_limit_mb
from tests.support.outside_readers import outside_readers

SEEDS = range(1000, 1012)


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    return outside_readers(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.campaign
def test_no_mutation_raises_a_foreign_exception_hangs_or_fills_the_memory(readers):
    contents = {reader.name: reader.path.read_bytes() for reader in readers}
    faults = list[str]()
    n_refused = 0
    for reader in readers:
        content = contents[reader.name]
        most_mb = memory_limit_mb(reader, content)
        for seed, mutation in inputs(reader, content, list(contents.values()), SEEDS):
            outcome = feed(reader, mutation, most_mb)
            n_refused += outcome.refused
            if outcome.fault:
                faults.append(f"{reader.name}, seed {seed}: {outcome.fault}")
        reader.write(content)
    assert faults == []
    assert n_refused > len(SEEDS) * len(readers) / 2, "the mutations must damage most inputs"


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("first_seed", range(2000, 2300, 30))
def test_no_mutation_of_many_does(readers, first_seed):
    contents = {reader.name: reader.path.read_bytes() for reader in readers}
    for reader in readers:
        content = contents[reader.name]
        most_mb = memory_limit_mb(reader, content)
        for seed, mutation in inputs(reader, content, list(contents.values()), range(first_seed, first_seed + 30)):
            assert not (fault := feed(reader, mutation, most_mb).fault), f"{reader.name}, seed {seed}: {fault}"
        reader.write(content)
