"""What the compilation of the kernels costs, part by part, on an empty cache, in one process.

    python tests/bench/bench_kernels.py [--parts NAME …] [--dearest N]

Prints for each part, in the order in which a first scan needs them, the signatures that numba compiled, those of them
that are kept, and the processor time; at the end the dearest functions, each without the functions that it calls.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from tests.bench.harness import read_options, took


def main() -> None:
    asked = read_options(__doc__, parts={"nargs": "+", "metavar": "NAME"}, dearest=10)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["WAFER_VIEWER_CACHE"] = folder  # before anything is imported that looks for kernels
        show(Path(folder), asked.parts, asked.dearest, quick=asked.quick)


def show(folder: Path, names: list[str] | None, n_dearest: int, *, quick: bool) -> None:
    from numba.core import event

    from wafer_viewer.session.surface.kernel_build import PARTS, SIMULATION

    class Compiled(event.Listener):
        """Processor time by function, without that of the functions compiled meanwhile."""

        def __init__(self) -> None:
            self.seconds: Counter[str] = Counter()
            self.count = 0
            self._open: list[list[float]] = []

        def on_start(self, event: Any) -> None:
            self._open.append([time.process_time(), 0.0])

        def on_end(self, event: Any) -> None:
            began, of_others = self._open.pop()
            taken = time.process_time() - began
            if self._open:
                self._open[-1][1] += taken
            function = event.data["dispatcher"].py_func
            self.seconds[f"{function.__module__}.{function.__qualname__}"] += taken - of_others
            self.count += 1

    event.register("numba:compile", compiled := Compiled())
    print(f"{'part':<26}{'signatures':>12}{'kept':>8}{'processor time':>17}")
    n_before = n_kept = 0
    began = time.process_time()
    for part in SIMULATION if quick else PARTS:
        if names and part.name not in names:
            continue
        taken = took(part.compile).processor_s
        kept = len(list(folder.rglob("*.nbc")))
        print(f"{part.name:<26}{compiled.count - n_before:>12}{kept - n_kept:>8}{taken:>15.1f} s", flush=True)
        n_before, n_kept = compiled.count, kept
    print(f"{'in all':<26}{compiled.count:>12}{n_kept:>8}{time.process_time() - began:>15.1f} s")
    for name, seconds in compiled.seconds.most_common(n_dearest):
        print(f"{seconds:>8.2f} s  {name}")


if __name__ == "__main__":
    main()
