"""A plan carried out on a rig: every leg, then again what stayed empty; each frame to the sink once it is known."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass

from wafer_viewer.acquire.one_pass import PassResult, clock_offset_us, rest_afterwards, run_pass
from wafer_viewer.acquire.reconcile import Hole
from wafer_viewer.model.devices import Rig
from wafer_viewer.model.limits import RigLimits
from wafer_viewer.model.plan import Leg, ScanPlan, Shot
from wafer_viewer.model.scanning import ScanControl, ScanSink
from wafer_viewer.model.spec import replace
from wafer_viewer.model.stack import Frame

REPAIRS = 2
"""How often an empty slot is tried again."""
NAMED = 5
"""How many of the missing frames a report names."""


@dataclass(frozen=True, slots=True)
class ScanOutcome:
    """How a scan went.

    kept: frames handed to the sink; missing: slots left empty after the repairs, or noted empty before a stop;
    repaired: slots filled by a repair; prepared_s: what the rig took beforehand, not part of duration_s.
    """

    kept: int
    missing: tuple[Shot, ...]
    repaired: int
    stopped: bool
    duration_s: float
    prepared_s: float = 0.0


def run_scan(plan: ScanPlan, rig: Rig, sink: ScanSink, control: ScanControl, skip: Container[Shot] = ()) -> ScanOutcome:
    """Carry out a plan. Slots in `skip` are kept already: their frames are not handed over again.

    Empty slots are taken again after the last leg, at most twice; what then still is empty is reported to the sink.
    A pause takes hold at the end of a leg, a stop at once. Whatever happens, the rig is left at rest: no pulses, the
    stage halted, the camera idle. Raises RigError when a device fails or the pulse box was started anew.
    """
    with rest_afterwards(rig):
        return _Scan(plan, rig, sink, control, skip).run()


def trimmed(leg: Leg, wanted: Callable[[Shot], bool], limits: RigLimits) -> Leg | None:
    """The part of a leg from the first to the last wanted shot; None when it has none."""
    places = [i for i, shot in enumerate(leg.shots) if wanted(shot)]
    if not places:
        return None
    first, last, train = places[0], places[-1], leg.train
    count = train.first_count + train.direction * train.counts_per_frame * first
    begin_um = {f"{train.axis}_um": limits.axis(train.axis).position_um(count)}
    train = replace(train, first_count=count, n_frames=last - first + 1)
    return replace(leg, train=train, shots=leg.shots[first : last + 1], **begin_um)


class _Scan:
    def __init__(self, plan: ScanPlan, rig: Rig, sink: ScanSink, control: ScanControl, skip: Container[Shot]) -> None:
        self._plan = plan
        self._rig = rig
        self._sink = sink
        self._control = control
        self._skip = skip
        self._offset_us = 0.0
        self._kept: set[Shot] = set()
        self._holes: dict[Shot, Hole] = {}
        self._repaired = 0
        self._stopped = False

    def run(self) -> ScanOutcome:
        """Prepare, take all legs, repair, report."""
        switched_on_s = self._rig.clock.now_s()
        legs = self._legs_with(lambda shot: shot not in self._skip)
        self._rig.prepare(replace(self._plan, legs=tuple(leg for _, leg in legs)), self._control.should_stop)
        started_s = self._rig.clock.now_s()
        self._take_all(legs)
        self._repair()
        self._report()
        return ScanOutcome(
            kept=len(self._kept),
            missing=tuple(self._holes),
            repaired=self._repaired,
            stopped=self._stopped,
            duration_s=self._rig.clock.now_s() - started_s,
            prepared_s=started_s - switched_on_s,
        )

    def _take_all(self, legs: list[tuple[int, Leg]]) -> None:
        if legs and not self._interrupted():
            self._offset_us = clock_offset_us(self._rig, self._plan.exposures_us[0])
            self._take(legs)

    def _repair(self) -> None:
        for attempt in range(1, REPAIRS + 1):
            self._take(self._legs_with(self._holes.__contains__, number=attempt * len(self._plan.legs)))

    def _legs_with(self, wanted: Callable[[Shot], bool], number: int = 0) -> list[tuple[int, Leg]]:
        """The parts of the legs that hold wanted shots, with the numbers of their passes: leg by leg from `number`."""
        parts = ((i, trimmed(leg, wanted, self._rig.limits)) for i, leg in enumerate(self._plan.legs, start=number))
        return [(i, leg) for i, leg in parts if leg is not None]

    def _take(self, legs: list[tuple[int, Leg]]) -> None:
        for number, leg in legs:
            if self._interrupted():
                return
            self._sink.pass_begun(number, leg)
            result = self._carry_out(leg)
            self._sink.pass_ended(number, result.summary)

    def _interrupted(self) -> bool:
        if self._control.should_pause():
            self._control.wait_while_paused()
        self._stopped = self._stopped or self._control.should_stop()
        return self._stopped

    def _carry_out(self, leg: Leg) -> PassResult:
        exposure_us = self._plan.exposures_us[leg.shots[0].exposure]
        result = run_pass(self._rig, leg, exposure_us, self._offset_us, self._keep, self._control.should_stop)
        self._offset_us = result.offset_us
        self._stopped = result.stopped
        if not result.stopped:
            self._note(result.holes)
        return result

    def _keep(self, frame: Frame) -> None:
        if frame.shot in self._skip or frame.shot in self._kept:
            return
        self._sink.frame(frame)
        self._kept.add(frame.shot)
        if self._holes.pop(frame.shot, None) is not None:
            self._repaired += 1
            self._sink.repaired(frame.shot)
        self._control.progress(self._plan, frame)

    def _note(self, holes: Iterable[Hole]) -> None:
        for hole in holes:
            if hole.shot not in self._skip and hole.shot not in self._kept and hole.shot not in self._holes:
                self._holes[hole.shot] = hole
                self._sink.missed(hole.shot, hole.count, hole.why)

    def _report(self) -> None:
        if self._holes and not self._stopped:
            self._sink.fault(_still_missing(list(self._holes.values())))


def _still_missing(holes: list[Hole]) -> str:
    named = ", ".join(f"field {h.shot.field} frame {h.shot.k} ({h.why})" for h in holes[:NAMED])
    more = f" and {len(holes) - NAMED} more" if len(holes) > NAMED else ""
    return f"After {REPAIRS} repairs {len(holes)} frames are missing: {named}{more}; continue the scan to try again."
