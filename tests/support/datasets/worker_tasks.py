"""Small tasks, which workers in other processes import from here."""

from __future__ import annotations

import mmap
import os
import signal
import sys
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import never, silent

SIEVE = 200_000


def square(number):
    return number * number


def square_or_fault(number):
    """Every third fails in a way that a person is told, 7 in a way that nobody foresaw."""
    if number == 7:
        raise TypeError("seven")
    if number % 3 == 0:
        raise DatasetError(f"{number} is divisible by three.")
    return number * number


def square_or_die(number):
    """5 ends its worker."""
    if number == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def work_a_while(number):
    """The process that did it."""
    sum(i * number % 7 for i in range(SIEVE))
    return os.getpid()


def keep(folder, number):
    """Leave a mark."""
    work_a_while(number)
    (Path(folder) / str(number)).touch()


def said_to_the_process(name):
    """What its environment says."""
    return os.environ.get(name)


def hold(n_bytes):
    """Have memory of one's own."""
    return len(bytearray(b"x") * n_bytes)


def read_mapped(path):
    """Read a mapped file, all of whose pages are then in memory."""
    with Path(path).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        return sum(mapped[:: mmap.PAGESIZE])


def lead_squares(count, *, crew, progress=silent, should_stop=never):
    """A work of many tasks."""
    total = 0
    for n_done, done in enumerate(crew.each(square, [(i,) for i in range(count)], should_stop=should_stop), 1):
        total += done.value
        progress(n_done / count)
    return total


def lead_for_ever(*, crew, progress=silent, should_stop=never):
    """A work that ends when it is told to."""
    for _ in crew.each(work_a_while, [(i,) for i in range(10**6)], should_stop=should_stop):
        progress(0.5)


def lead_squares_alone(count, *, progress=silent, should_stop=never):
    """A single task of a worker."""
    return sum(i * i for i in range(count))


def lead_everywhere(task, items, *, crew, progress=silent, should_stop=never):
    """Led: what a task returns for some items."""
    return [done.value for done in crew.each(task, items, should_stop=should_stop)]


def began_with(module):
    """Process, whether it has a module that no task imports, niceness, and what the environment says of memory."""
    return os.getpid(), module in sys.modules, os.nice(0), said_to_the_process(_TRIM)


_TRIM = "MALLOC_TRIM_THRESHOLD_"
