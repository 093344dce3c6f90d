"""Run of the conformance checks on an opened rig, one after the other; the rig is left at rest."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress

from wafer_viewer.acquire.conformance import box_checks, camera_checks, joint_checks, stage_checks
from wafer_viewer.acquire.conformance.bench import (
    ORDER,
    CheckOutcome,
    ConformanceBench,
    ConformanceCheck,
    DeviceRole,
    TravelLimits,
    words_of,
)
from wafer_viewer.acquire.motion import at_um, come_to_rest
from wafer_viewer.model.acquisition.conformance import ConformanceResult, ConformanceVerdict
from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop, never

CHECKS: tuple[ConformanceCheck, ...] = (
    *(check for check in box_checks.CHECKS if not check.moves),
    *camera_checks.CHECKS,
    *joint_checks.AT_REST,
    *stage_checks.CHECKS,
    *(check for check in box_checks.CHECKS if check.moves),
    *joint_checks.IN_MOTION,
)
"""All checks in the order in which they run: what needs no motion first, then homing, then the rest."""
HOMING = "stage_homed"
NEEDS_MOVE = "It moves the stage: give --move."
NOT_HOMED = "The stage is not homed."
STOPPED = "Stopped before its end."
NOT_HOMED_WORDS = (
    "The stage is not homed: z searches its reference and goes to the lower end of its range, then x and y go to the "
    "middle of theirs"
)


def run_checks(
    rig: Rig,
    *,
    move: bool,
    travel: TravelLimits | None = None,
    checks: Sequence[ConformanceCheck] = CHECKS,
    tell: Callable[[str], None] = lambda sentence: None,
    begin: Callable[[ConformanceCheck], None] = lambda check: None,
    should_stop: ShouldStop = never,
) -> Iterator[ConformanceResult]:
    """Run checks and yield their results. The stage moves with `move` only.

    A check that fails does not stop the others unless one of its devices no longer answers. `tell` gets a sentence for
    each axis before it moves, `begin` each check before it runs. When `should_stop` returns True, motion ends with the
    stage at rest and the remaining checks are not run. At the end the stage returns to where it began.

    Raises RigError for a range of z that the stage cannot reach.
    """
    travel = travel or TravelLimits()
    travel.require_reachable(rig.limits)
    return _Run(rig, ConformanceBench(rig, travel, should_stop), move, tell, begin).results(checks)


@contextmanager
def _left_at_rest(rig: Rig) -> Generator[None]:
    """Leave what still answers at rest: no pulses, stage halted, camera stopped."""
    try:
        yield
    finally:
        for step in (rig.box.halt, rig.stage.stop, rig.camera.stop):
            with suppress(RigError, OSError):
                step()


class _Run:
    def __init__(
        self,
        rig: Rig,
        bench: ConformanceBench,
        move: bool,
        tell: Callable[[str], None],
        begin: Callable[[ConformanceCheck], None],
    ) -> None:
        self._rig, self._bench, self._move, self._tell, self._begin = rig, bench, move, tell, begin
        self._gone: dict[DeviceRole, str] = {}
        self._homed = True
        self._announced = False
        self._began_at: Position | None = None

    def results(self, checks: Sequence[ConformanceCheck]) -> Iterator[ConformanceResult]:
        """Run checks and yield their results."""
        with _left_at_rest(self._rig):
            for check in checks:
                yield self._result(check)
            self._return()

    def _result(self, check: ConformanceCheck) -> ConformanceResult:
        if obstacle := self._obstacle(check):
            return _result(check, CheckOutcome(skipped=obstacle), 0.0)
        began_s = self._rig.clock.now_s()
        self._begin(check)
        found = self._run(check)
        if check.name == HOMING:
            self._homed = not found.fault
        if found.fault:
            self._probe(check)
        return _result(check, found, self._rig.clock.now_s() - began_s)

    def _obstacle(self, check: ConformanceCheck) -> str:
        """Return the reason why a check cannot run, or an empty text."""
        if self._bench.should_stop():
            return STOPPED
        if lost := [self._gone[role] for role in check.roles if role in self._gone]:
            return lost[0]
        if check.moves and not self._move:
            return NEEDS_MOVE
        return NOT_HOMED if check.moves and check.name != HOMING and not self._homed else ""

    def _run(self, check: ConformanceCheck) -> CheckOutcome:
        try:
            if check.moves:
                self._announce(check)
            with _left_at_rest(self._rig):
                found = check.run(self._bench)
        except (RigError, OSError) as fault:
            found = CheckOutcome(fault=str(fault))
        if found.fault and self._bench.should_stop():
            return CheckOutcome(found.figures, skipped=STOPPED)
        return found

    def _announce(self, check: ConformanceCheck) -> None:
        """Say which axes will move, before they do."""
        if check.name == HOMING:
            if not self._rig.stage.homed():
                self._tell(NOT_HOMED_WORDS)
        elif not self._announced:
            self._announced = True
            self._began_at = self._rig.stage.position()
            for sentence in words_of(self._bench.windows):
                self._tell(sentence)

    def _probe(self, check: ConformanceCheck) -> None:
        """Find out which devices of a failed check no longer answer."""
        for role in check.roles:
            try:
                PROBES[role](self._bench)
            except (RigError, OSError) as fault:
                self._gone[role] = f"The {role} no longer works: {fault}"

    def _return(self) -> None:
        """Move the axes back to where they stood before their first motion, unless nobody can."""
        if self._began_at is None or "stage" in self._gone:
            return
        with suppress(RigError, OSError):
            for axis in ORDER:
                self._bench.go(axis, at_um(self._began_at, axis))


def _result(check: ConformanceCheck, found: CheckOutcome, duration_s: float) -> ConformanceResult:
    verdict: ConformanceVerdict = "not run" if found.skipped else "failed" if found.fault else "passed"
    return ConformanceResult(
        name=check.name,
        title=check.title,
        subject=check.subject,
        demand=check.demand,
        verdict=verdict,
        why=found.skipped or found.fault,
        figures=found.figures,
        duration_s=duration_s,
    )


def _probe_camera(bench: ConformanceBench) -> None:
    bench.rig.camera.start(bench.exposure_us)
    bench.rig.camera.stop()


PROBES: dict[DeviceRole, Callable[[ConformanceBench], object]] = {
    "stage": lambda bench: come_to_rest(bench.rig),
    "pulse box": lambda bench: bench.rig.box.hello(),
    "camera": _probe_camera,
}
"""Question to a device that it answers while it works."""
