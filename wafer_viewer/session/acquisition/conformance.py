"""Conformance of a rig: opens it, runs the checks and gathers their results."""

from __future__ import annotations

import datetime
from collections.abc import Callable

from wafer_viewer._version import __version__
from wafer_viewer.acquire.conformance.check import ConformanceCheck
from wafer_viewer.acquire.conformance.runner import run_checks
from wafer_viewer.acquire.conformance.travel import TravelLimits
from wafer_viewer.model.acquisition.conformance import ConformanceReport, ConformanceResult
from wafer_viewer.model.progress import ShouldStop, never
from wafer_viewer.model.spec import encode
from wafer_viewer.rigs.rig_config import RigConfig, open_rig


def check_conformance(
    rig: RigConfig,
    *,
    move: bool = False,
    longest_um: float | None = None,
    z_um: tuple[float, float] | None = None,
    by: str = "",
    rig_file: str = "",
    tell: Callable[[str], None] = lambda sentence: None,
    begin: Callable[[ConformanceCheck], None] = lambda check: None,
    done: Callable[[ConformanceResult], None] = lambda result: None,
    should_stop: ShouldStop = never,
) -> ConformanceReport:
    """Run the conformance checks on a rig and return their results; the rig is left at rest.

    Parameters
    ----------
    rig : RigConfig
        Configuration of the rig.
    move : bool
        Move the stage. Without it, the checks that need a motion are not run.
    longest_um : float or None
        Longest motion of x and y in um; None for as much as their full speed needs.
    z_um : tuple of two floats or None
        Range of z in um. None keeps z below where it stands, away from the objective; at the lower end of its range it
        moves up by as much as it needs.
    by : str
        Lab or person, for the report.
    rig_file : str
        Name of the rig's file, for the report.
    tell : callable
        Called with a sentence for each axis before it moves.
    begin : callable
        Called with each check before it runs.
    done : callable
        Called with each result.
    should_stop : callable
        Polled during motions. When it returns True, the stage stops and the remaining checks are not run.

    Returns
    -------
    ConformanceReport
        Results of all checks with the devices and the settings of the rig.

    Raises
    ------
    RigError
        When the rig cannot be opened, or a range is out of reach.
    """
    motions: list[str] = []
    results: list[ConformanceResult] = []

    def announce(sentence: str) -> None:
        motions.append(sentence)
        tell(sentence)

    opened = open_rig(rig)
    try:
        devices = opened.identities()
        travel = TravelLimits(longest_um=longest_um, z_um=z_um)
        checks = run_checks(opened, move=move, travel=travel, tell=announce, begin=begin, should_stop=should_stop)
        for result in checks:
            results.append(result)
            done(result)
        return ConformanceReport(
            rig=opened.name,
            simulated=opened.simulated,
            rig_file=rig_file,
            config=encode(rig),
            devices=devices,
            program_version=__version__,
            at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            by=by,
            motions=tuple(motions),
            results=tuple(results),
        )
    finally:
        opened.close()
