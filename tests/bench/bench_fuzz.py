"""Whether any input makes a reader raise a foreign exception, hang, or take memory without bound.

    python tests/bench/bench_fuzz.py [--quick] [--inputs N] [--first-seed N] [--only WORD ...]

Mutations, by seed, of a valid input of every reader of what comes from outside: files, uploads, serial replies and
messages of browsers (tests/support/outside_readers.py). A refusal is a sentence in the program's own error class. A
fault is another exception, more than 2 s, or more than twice the memory of the valid input (64 MB are free).
--quick: 100 inputs a reader. The full run takes 2000 a reader; its faults are listed with their seeds. It exits with
status 1 if there is a fault.
"""

from __future__ import annotations

import logging
import sys
import tempfile
import time
import warnings
from pathlib import Path

from tests.bench.harness import read_options, show
from tests.support.fuzzing import feed, inputs, memory_limit_mb
from tests.support.outside_readers import OutsideReader, outside_readers

FULL, QUICK = 2000, 100
HEADER = "reader | inputs | refused | faults | slowest [s] | most [MB]"


def main() -> None:
    """Feed all readers, and print a table and the faults."""
    arguments = read_options(__doc__, inputs=int, first_seed=1000, only=[])
    n_inputs = arguments.inputs or (QUICK if arguments.quick else FULL)
    seeds = range(arguments.first_seed, arguments.first_seed + n_inputs)
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    begun_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        readers = outside_readers(Path(folder))
        contents = {reader.name: reader.path.read_bytes() for reader in readers}
        wanted = [r for r in readers if not arguments.only or any(word in r.name for word in arguments.only)]
        rows, faults = [], list[str]()
        for reader in wanted:
            row, found = _fed(reader, contents, seeds)
            rows.append(row)
            faults += found
    show("Mutated inputs", HEADER, rows)
    print(f"{len(wanted) * n_inputs} inputs, {len(faults)} faults, {time.perf_counter() - begun_s:.0f} s")
    print("\n".join(faults))
    sys.exit(1 if faults else 0)


def _fed(
    reader: OutsideReader, contents: dict[str, bytes], seeds: range
) -> tuple[tuple[str, int, int, int, float, float], list[str]]:
    """Return the row of a reader, and its faults."""
    content = contents[reader.name]
    most_mb = memory_limit_mb(reader, content)
    faults, n_refused, slowest_s, most = list[str](), 0, 0.0, 0.0
    for seed, mutation in inputs(reader, content, list(contents.values()), seeds):
        outcome = feed(reader, mutation, most_mb)
        n_refused += outcome.refused
        slowest_s, most = max(slowest_s, outcome.took_s), max(most, outcome.took_mb)
        if outcome.fault:
            faults.append(f"{reader.name}, seed {seed}: {outcome.fault}")
    reader.write(content)
    return (reader.name, len(seeds), n_refused, len(faults), round(slowest_s, 3), round(most)), faults


if __name__ == "__main__":
    main()
