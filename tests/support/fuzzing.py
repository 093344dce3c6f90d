"""Feeding mutated inputs to a reader, and what it must not do: another exception, a hang, or memory without bound."""

from __future__ import annotations

import signal
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.mutations import mutated
from tests.support.outside_readers import OutsideReader
from wafer_viewer.model.errors import WaferViewerError

MOST_S, MOST_WAIT_S = 2.0, 20.0
"""Processor time and time of the clock; on a busy machine a process may not run for seconds."""
FREE_MB = 64.0
"""Memory in MB that any input may take, before twice that of the valid file counts."""
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Hangs(BaseException):
    """The reader took more than `MOST_S` or `MOST_WAIT_S`; no reader may catch it."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One input: accepted or refused, or the fault that was found; time, and memory on top of what the process had."""

    fault: str
    refused: bool
    took_s: float
    took_mb: float


def feed(reader: OutsideReader, content: bytes, most_mb: float) -> Outcome:
    """Let a reader read some content."""
    reader.write(content)
    before_mb, begun_s = _mark_memory(), time.perf_counter()
    refused, fault = False, ""
    try:
        with _limited_time():
            reader.read(reader.path)
    except WaferViewerError as error:
        refused, fault = True, _wrong_sentence(str(error))
    except Hangs:
        fault = f"hangs for more than {MOST_S:g} s of processor time or {MOST_WAIT_S:g} s"
    except Exception as error:  # noqa: BLE001 - what is looked for
        fault = f"{type(error).__name__}: {str(error)[:120]}"
    took_s, took_mb = time.perf_counter() - begun_s, _peak_mb() - before_mb
    if not fault and took_mb > most_mb:
        fault = f"took {took_mb:.0f} MB, more than {most_mb:.0f} MB"
    return Outcome(fault, refused, took_s, took_mb)


def memory_limit_mb(reader: OutsideReader, content: bytes) -> float:
    """Return twice the memory that the valid input takes, and at least `FREE_MB`."""
    outcome = feed(reader, content, float("inf"))
    if outcome.fault or outcome.refused:
        raise AssertionError(f"{reader.name} refuses its valid input: {outcome.fault}")
    return max(FREE_MB, 2 * outcome.took_mb)


def inputs(
    reader: OutsideReader, content: bytes, others: Sequence[bytes], seeds: range
) -> Generator[tuple[int, bytes]]:
    """Yield mutations of a valid input with their seeds; the name of the reader is part of the seed."""
    key = list(reader.name.encode())
    for seed in seeds:
        yield seed, mutated(content, np.random.default_rng([seed, *key]), [content, content, *others])


def _wrong_sentence(text: str) -> str:
    """Return what is wrong with the sentence of a refusal; empty if nothing is."""
    if "\n" in text or not text.endswith(".") or len(text) > 1200:
        return f"is refused by what is no sentence: {text[:120]!r}"
    return ""


@contextmanager
def _limited_time() -> Generator[None]:
    def stop(*_: Any) -> None:
        raise Hangs

    before = {kind: signal.signal(kind, stop) for kind in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, MOST_S)
    signal.setitimer(signal.ITIMER_REAL, MOST_WAIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _mark_memory() -> float:
    """Set the peak of the process back to its present memory, in MB, and return that."""
    _CLEAR.write_text("5")
    return _memory_mb("VmRSS")


def _peak_mb() -> float:
    return _memory_mb("VmHWM")


def _memory_mb(name: str) -> float:
    return next(int(line.split()[1]) for line in _STATUS.read_text().splitlines() if line.startswith(name)) / 1024
