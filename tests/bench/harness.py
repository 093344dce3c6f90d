"""What benchmarks share: options, clocks, memory, processes of their own, runs that are kept, and tables."""

from __future__ import annotations

import argparse
import json
import math
import resource
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Generic, TypeVar

HOME = Path(tempfile.gettempdir()) / "wafer-viewer-bench"
"""Folder of made-up surfaces and of finished runs, from which a run that was stopped continues."""
T = TypeVar("T")
Cell = str | float | int | None


# ------------------------------------------------------------------------------------------------------------- options


def read_options(about: str | None, **options: Any) -> argparse.Namespace:
    """Read the command line: `--quick`, and an option for each keyword.

    Its value is the default and gives the type; a type has no default, False is a switch, a tuple or list stands for
    one value or more, and a dictionary holds the words of argparse. Numbers are 1 or more. `first_seed` is `--from`.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in {"quick": False, **options}.items():
        flags = ("--from", "--first-seed") if name == "first_seed" else (f"--{name.replace('_', '-')}",)
        parser.add_argument(*flags, dest=name, **_words(value, is_seed="seed" in name))
    return parser.parse_args()


def _words(value: Any, is_seed: bool) -> dict[str, Any]:
    if isinstance(value, dict):
        return value
    if value is False:
        return {"action": "store_true"}
    if isinstance(value, list | tuple):
        return {"nargs": "+", "type": type(value[0]) if value else str, "default": value}
    kind = value if isinstance(value, type) else type(value)
    default = None if isinstance(value, type) else value
    return {"type": _positive if kind is int and not is_seed else kind, "default": default}


def _positive(word: str) -> int:
    if (number := int(word)) < 1:
        raise argparse.ArgumentTypeError(f"{word} is below 1")
    return number


def some_of(names: Iterable[str], default: Iterable[str] | None = None) -> dict[str, Any]:
    """An option that takes some of these names, all of them by default."""
    every = list(names)
    return {"nargs": "+", "choices": every, "default": list(default or every), "metavar": "NAME"}


def run_sections(sections: Mapping[str, Callable[[bool], object]], asked: argparse.Namespace) -> None:
    """Run the sections that `--only` names, and print the seconds of each."""
    for name in asked.only:
        clock_s = took(lambda section=sections[name]: section(asked.quick)).clock_s
        print(f"({name}: {clock_s:.0f} s)", flush=True)


# ------------------------------------------------------------------------------------------------- clocks, memory, runs


@dataclass(frozen=True, slots=True)
class Took(Generic[T]):
    """Seconds by the clock and of this process on the processor, and what the work returned."""

    clock_s: float
    processor_s: float
    result: T

    @property
    def both(self) -> tuple[float, float]:
        """(by the clock, of the processor)."""
        return self.clock_s, self.processor_s


def took(work: Callable[[], T], rounds: int = 1) -> Took[T]:
    """The least of some rounds, each clock by itself."""
    found: list[tuple[float, float, T]] = []
    for _ in range(rounds):
        began, busy = time.perf_counter(), time.process_time()
        result = work()
        found.append((time.perf_counter() - began, time.process_time() - busy, result))
    return Took(min(one[0] for one in found), min(one[1] for one in found), found[-1][2])


def own_mb() -> float:
    """Anonymous memory of this process: without mapped files (Linux; nan elsewhere)."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return math.nan
    return int(status.split("RssAnon:")[1].split()[0]) / 1024


def peak_mb() -> float:
    """The most memory that this process ever had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@contextmanager
def highest(look: Callable[[], float] = own_mb, every_s: float = 0.02) -> Generator[list[float]]:
    """The highest of what a thread of its own looks at meanwhile, in a list of one."""
    most, over = [look()], threading.Event()

    def watch() -> None:
        while not over.wait(every_s):
            most[0] = max(most[0], look())

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield most
    finally:
        over.set()
        watcher.join()
        most[0] = max(most[0], look())


def alone(work: Callable[..., T], *given: Any) -> T:
    """Do something in a new process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(work, *given).result()


def read_runs(path: Path | None) -> list[dict[str, Any]]:
    """Return the runs that a file keeps, a line each; none where there is no file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []


def keep_run(path: Path | None, run: dict[str, Any]) -> None:
    """Add a finished run to a file, if there is to be one."""
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:
            file.write(json.dumps(run) + "\n")


# -------------------------------------------------------------------------------------------------------------- tables


def show(title: str, header: Sequence[str] | str, rows: Iterable[Sequence[Cell]]) -> None:
    """Print a titled table, the first column to the left and the others to the right.

    A header in one string has its columns apart by ` | `.
    """
    columns = header.split(" | ") if isinstance(header, str) else list(header)
    lines = [columns, *([told(cell) for cell in row] for row in rows)]
    widths = [max(len(line[n]) for line in lines) for n in range(len(columns))]
    print(f"\n{title}")
    for line in lines:
        others = (cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        print("  " + "  ".join([line[0].ljust(widths[0]), *others]).rstrip(), flush=True)


def told(cell: Cell) -> str:
    """A cell as text: three figures of a number, what is missing as a dash."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, float):
        return f"{cell:.3g}" if abs(cell) < 100 else f"{cell:.0f}"
    return str(cell)


def percent(share: float, digits: int = 1) -> str:
    """A share as a percentage."""
    return "-" if math.isnan(share) else f"{100 * share:.{digits}f}"


def met(value: float, limit: float, at_least: bool = False) -> str:
    """Whether a goal is met."""
    return "met" if (value >= limit if at_least else value <= limit) else "MISSED"


def goal(value: float, limit: float, unit: str = "", at_least: bool = False) -> str:
    """A goal in parentheses, and whether it is met."""
    return f"(goal {limit:g}{unit} {met(value, limit, at_least)})"
