"""Commands to the compute host, and its events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wafer_viewer.compute.watched_tasks import LedTask, WatchedTask


@dataclass(frozen=True, slots=True)
class RunTask:
    """Run ``task(*args, progress=…, should_stop=…)`` on a worker. The reply is its return value."""

    work: str
    task: WatchedTask[*tuple[Any, ...], Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class RunLedTask:
    """Run ``task(*args, crew=…, progress=…, should_stop=…)`` in the host, where it submits many tasks to the crew.

    The reply is its return value.
    """

    work: str
    task: LedTask[*tuple[Any, ...], Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Cancel:
    """Request the tasks of a work to stop. The reply comes at once."""

    work: str


@dataclass(frozen=True, slots=True)
class ComputeUp:
    """The workers accept tasks."""

    n_workers: int


@dataclass(frozen=True, slots=True)
class ComputeWarm:
    """Every kernel is compiled, so that fields can be reconstructed without delay."""


@dataclass(frozen=True, slots=True)
class ComputeAbsent:
    """No cluster is available, for the reason `why`."""

    why: str


@dataclass(frozen=True, slots=True)
class Progressed:
    """Progress of a work, 0 to 1."""

    work: str
    fraction: float
