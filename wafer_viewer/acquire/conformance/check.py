"""Descriptor of a conformance check, and the outcome of one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from wafer_viewer.acquire.conformance.bench import ConformanceBench
from wafer_viewer.model.acquisition.conformance import CheckFigure, ConformanceSubject

DeviceRole = Literal["stage", "pulse box", "camera"]
Figures = tuple[CheckFigure, ...]


@dataclass(frozen=True, slots=True)
class CheckOutcome:
    """Figures of a check; fault: what the rig did instead of what it should; skipped: why it could not be judged."""

    figures: Figures = ()
    fault: str = ""
    skipped: str = ""


CheckRun = Callable[[ConformanceBench], CheckOutcome]


@dataclass(frozen=True, slots=True)
class ConformanceCheck:
    """One demand on a rig.

    Parameters
    ----------
    name : name in reports and in the reference.
    title : the same for people.
    subject : heading under which it is listed.
    roles : devices that it needs.
    moves : true if the stage moves.
    demand : what the rig has to do, in a sentence.
    run : measures it. A RigError that it raises is the reason of a failure.
    """

    name: str
    title: str
    subject: ConformanceSubject
    roles: tuple[DeviceRole, ...]
    moves: bool
    demand: str
    run: CheckRun


def figure(name: str, value: float, unit: str) -> CheckFigure:
    """Return a number with its name and unit."""
    return CheckFigure(name=name, value=float(value), unit=unit)


def outcome(figures: Iterable[CheckFigure], *faults: str) -> CheckOutcome:
    """Return the outcome with the faults that are not empty, as sentences."""
    return CheckOutcome(tuple(figures), " ".join(fault for fault in faults if fault))
