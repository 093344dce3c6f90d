"""Commands to the compute host, and its reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wafer_viewer.compute.watched_tasks import LedTask, WatchedTask


@dataclass(frozen=True, slots=True)
class RunTask:
    """Carry out ``task(*args, progress=…, should_stop=…)`` on a worker. Answered with what it returns."""

    work: str
    task: WatchedTask[*tuple[Any, ...], Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class RunLedTask:
    """Carry out ``task(*args, crew=…, progress=…, should_stop=…)`` in the host, where it hands the crew many tasks.

    Answered with what it returns.
    """

    work: str
    task: LedTask[*tuple[Any, ...], Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Cancel:
    """Tell the tasks of a work to stop. Answered at once."""

    work: str


@dataclass(frozen=True, slots=True)
class ComputeUp:
    """The workers take tasks."""

    n_workers: int


@dataclass(frozen=True, slots=True)
class ComputeWarm:
    """Every kernel is compiled: fields can be reconstructed without waiting for that."""


@dataclass(frozen=True, slots=True)
class ComputeAbsent:
    """There is no cluster, and why."""

    why: str


@dataclass(frozen=True, slots=True)
class Progressed:
    """How far a work is, 0 to 1."""

    work: str
    fraction: float
