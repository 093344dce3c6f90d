"""Execution of a plan on a rig, with immediate repetition of doubtful passes and final repair of empty slots."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass

from wafer_viewer.acquire.pass_runner import PassResult, PassSettings, device_clock, rig_at_rest, run_pass
from wafer_viewer.acquire.pulse_reconciliation import (
    COUNT_TOLERANCE,
    DeviceClock,
    MissingFrame,
    marked_axes,
    reference_axes,
)
from wafer_viewer.model.acquisition.devices import Rig, ScanControl, ScanSink
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import Axis, Leg, ScanPlan, Shot
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import MotionStopped, PulseBoxRestarted, RigError
from wafer_viewer.model.spec import replace

REPAIRS = 2
"""Number of repair attempts for an empty slot."""
PASS_TRIES = 3
"""Attempts at a pass with doubtful frames before the scan ends."""
CLOCK_HOLDS_S = 5.0
"""Time without images after which the clocks are compared again; 100 ppm of it are a small part of a pulse period."""
SMALL_SLIPS = 2
"""Slips of 1 or 2 counts after which the position of the stage is trusted to tell such slips, whatever their share.

Also the repetitions of a pass for them, which are not counted among PASS_TRIES.
"""
SMALL_SLIPS_SHARE = 0.2
"""Largest further share of passes with such slips. With more of them the position of the stage is too uncertain."""
NAMED = 5
"""Number of missing frames named in a report."""


@dataclass(frozen=True, slots=True)
class ScanOutcome:
    """Outcome of a scan.

    kept: frames passed to the sink; missing: slots empty after the repairs, or recorded as empty before a stop;
    repaired: slots filled by a repair; prepared_s: preparation time of the rig, not part of duration_s.
    """

    kept: int
    missing: tuple[Shot, ...]
    repaired: int
    stopped: bool
    duration_s: float
    prepared_s: float = 0.0


def run_scan(
    plan: ScanPlan,
    rig: Rig,
    sink: ScanSink,
    control: ScanControl,
    skip: Container[Shot] = (),
    delay_us: float | None = None,
) -> ScanOutcome:
    """Execute a plan. Slots in `skip` are already stored: their frames are not passed on again.

    The counts of the pulse box are set from the position of the stage, or by the index marks of its axes, at the
    beginning, after a doubtful pass and after a restart of the box. A pass with inconsistent counts or times is
    repeated immediately, at most PASS_TRIES times in all. Empty slots are taken again after the last leg, at most
    twice; those still empty are reported to the sink. A pause takes effect at the end of a leg, a stop immediately.
    In every case the rig is left at rest: no pulses, stage halted, camera idle. Raises RigError if a device fails or
    a pass remains doubtful in all of its tries.

    delay_us: delay from a pulse to the exposure; by default that of the rig's own calibration.
    """
    with rig_at_rest(rig):
        return _Scan(plan, rig, sink, control, skip, delay_us).run()


def trimmed(leg: Leg, wanted: Callable[[Shot], bool], limits: RigLimits) -> Leg | None:
    """Return the part of a leg from the first to the last wanted shot; None if it has none."""
    places = [i for i, shot in enumerate(leg.shots) if wanted(shot)]
    if not places:
        return None
    first, last, train = places[0], places[-1], leg.train
    count = train.first_count + train.direction * train.counts_per_frame * first
    begin_um = {f"{train.axis}_um": limits.axis(train.axis).position_um(count)}
    train = replace(train, first_count=count, n_frames=last - first + 1)
    return replace(leg, train=train, shots=leg.shots[first : last + 1], **begin_um)


class _Scan:
    def __init__(
        self,
        plan: ScanPlan,
        rig: Rig,
        sink: ScanSink,
        control: ScanControl,
        skip: Container[Shot],
        delay_us: float | None,
    ) -> None:
        self._plan = plan
        self._rig = rig
        self._sink = sink
        self._control = control
        self._skip = skip
        self._delay_us = delay_us
        self._clock: DeviceClock | None = None
        self._clock_known_s = 0.0
        self._taken: set[Shot] = set()
        """Slots with a frame in the current pass, valid once the pass is over."""
        self._kept: set[Shot] = set()
        self._holes: dict[Shot, MissingFrame] = {}
        self._repaired = 0
        self._stopped = False
        self._referenced = False
        """Whether the counts of the pulse box are set."""
        self._agreed: set[Axis] = set()
        """Axes whose count agreed with the stage at the end of their last pass."""
        self._ended: list[tuple[Axis, bool]] = []
        """Passes so far: their axis, and whether box and stage differed by 1 or 2 counts more than before."""
        self._remarks = _Remarks(sink.fault)

    def run(self) -> ScanOutcome:
        """Prepare the rig, take all legs, repair empty slots and report."""
        switched_on_s = self._rig.clock.now_s()
        legs = self._legs_with(self._wanted)
        self._rig.prepare(replace(self._plan, legs=tuple(leg for _, leg in legs)), self._control.should_stop)
        started_s = self._rig.clock.now_s()
        try:
            self._take_all(legs)
            self._repair()
        except MotionStopped:  # on the way to an index mark
            self._stopped = True
        self._report()
        return ScanOutcome(
            kept=len(self._kept),
            missing=tuple(self._holes),
            repaired=self._repaired,
            stopped=self._stopped,
            duration_s=self._rig.clock.now_s() - started_s,
            prepared_s=started_s - switched_on_s,
        )

    def _wanted(self, shot: Shot) -> bool:
        return shot not in self._skip and shot not in self._kept

    def _take_all(self, legs: list[tuple[int, Leg]]) -> None:
        if legs and not self._interrupted():
            self._clock_at(self._plan.exposures_us[0])
            self._take(legs)

    def _repair(self) -> None:
        for attempt in range(1, REPAIRS + 1):
            self._take(self._legs_with(self._holes.__contains__, number=attempt * len(self._plan.legs)))

    def _legs_with(self, wanted: Callable[[Shot], bool], number: int = 0) -> list[tuple[int, Leg]]:
        """Return the parts of the legs that contain wanted shots, with pass numbers counted from `number`."""
        parts = ((i, trimmed(leg, wanted, self._rig.limits)) for i, leg in enumerate(self._plan.legs, start=number))
        return [(i, leg) for i, leg in parts if leg is not None]

    def _take(self, legs: list[tuple[int, Leg]]) -> None:
        for number, leg in legs:
            if not self._take_until_trusted(number, leg):
                return

    def _take_until_trusted(self, number: int, leg: Leg) -> bool:
        """Repeat a leg while its frames are doubtful; return False if stopped."""
        attempt = small_slips = 0
        while not self._interrupted():
            attempt += 1
            result = self._carry_out(number, leg, self._count_tolerance(leg.train.axis, small_slips))
            if result.stopped:
                return False
            if not result.doubts:
                return True
            small_slips += len(result.doubts) == 1 and 0 < abs(result.slip) <= COUNT_TOLERANCE
            self._report_doubts(leg, result, attempt, PASS_TRIES + small_slips)
            self._distrust_box()
        return False

    def _interrupted(self) -> bool:
        if self._control.should_pause():
            self._control.wait_while_paused()
        self._stopped = self._stopped or self._control.should_stop()
        return self._stopped

    def _count_tolerance(self, axis: Axis, small_slips: int) -> int:
        """Return the permitted slip in counts of a pass that was repeated for so many small slips already.

        None as long as the position of the stage tells single counts, but slips of 1 or 2 counts never end a scan.
        """
        small = [small for of, small in self._ended if of == axis]
        telling = sum(small) <= SMALL_SLIPS + SMALL_SLIPS_SHARE * len(small)
        return 0 if telling and small_slips < SMALL_SLIPS else COUNT_TOLERANCE

    def _carry_out(self, number: int, leg: Leg, count_tolerance: int) -> PassResult:
        exposures_us = self._plan.exposures_us
        clock = self._clock_at(exposures_us[leg.shots[0].exposure])
        self._sink.pass_begun(number, leg)
        self._taken.clear()
        settings = PassSettings(exposures_us, clock, count_tolerance, self._delay_us)
        result = run_pass(self._rig, leg, settings, self._frame, self._control.should_stop)
        self._stopped = result.stopped
        self._settle(leg, result)
        self._sink.pass_ended(number, result.summary)
        if result.pairing is not None:
            changes = abs(result.slip), abs(result.count_mended)
            self._ended.append((leg.train.axis, any(0 < n <= COUNT_TOLERANCE for n in changes)))
            self._clock, self._clock_known_s = result.pairing.clock, self._rig.clock.now_s()
            self._remark(leg, result)
        return result

    def _clock_at(self, exposure_us: float) -> DeviceClock:
        """Return the camera's clock relative to the box's, with the counts of the box set before."""
        try:
            return self._compared_clock(exposure_us)
        except PulseBoxRestarted as restart:
            source = "by the index marks" if marked_axes(self._rig.limits) else "from the position of the stage"
            self._sink.fault(f"{restart} Its counts are set again {source}.")
            self._distrust_box()
            return self._compared_clock(exposure_us)

    def _distrust_box(self) -> None:
        self._clock, self._referenced = None, False
        self._agreed.clear()

    def _compared_clock(self, exposure_us: float) -> DeviceClock:
        """Return the camera's clock relative to the box's, measured again if the last comparison is too old."""
        if not self._referenced:
            reference_axes(self._rig, self._control.should_stop)
            self._referenced = True
        if self._clock is None or self._rig.clock.now_s() - self._clock_known_s > CLOCK_HOLDS_S:
            self._clock = device_clock(self._rig, exposure_us, self._clock)
            self._clock_known_s = self._rig.clock.now_s()
        return self._clock

    def _frame(self, frame: Frame) -> None:
        """Pass on a frame of the current pass."""
        if self._wanted(frame.shot) and frame.shot not in self._taken:
            self._sink.frame(frame)
            self._taken.add(frame.shot)
            self._control.progress(self._plan, frame)

    def _settle(self, leg: Leg, result: PassResult) -> None:
        """Accept the frames of a finished pass, or record their slots as empty."""
        holes = _untrusted(leg, result) if result.doubts else result.pairing.holes if result.pairing else ()
        for hole in holes:
            if self._wanted(hole.shot) and not (result.stopped and hole.shot not in self._taken):
                self._note(hole)
        for shot in self._taken - {hole.shot for hole in holes}:
            self._keep(shot)

    def _note(self, hole: MissingFrame) -> None:
        """Record an empty slot; a known one is reported again only if its frame is revoked."""
        if hole.shot not in self._holes or hole.shot in self._taken:
            self._sink.missed(hole.shot, hole.count, hole.why)
        self._holes[hole.shot] = hole

    def _keep(self, shot: Shot) -> None:
        self._kept.add(shot)
        if self._holes.pop(shot, None) is not None:
            self._repaired += 1
            self._sink.repaired(shot)

    def _report_doubts(self, leg: Leg, result: PassResult, attempt: int, tries: int) -> None:
        """Report a doubtful pass. Raises RigError after the last try."""
        why = ", and ".join(doubt.why for doubt in result.doubts)
        which = f"the pass that begins at field {leg.shots[0].field}"
        if attempt < tries:
            self._sink.fault(
                f"None of the {len(leg.shots)} frames of {which} is kept: {why}. It is taken again (try {attempt + 1} "
                f"of {tries})."
            )
            return
        mends = "; ".join(dict.fromkeys(doubt.mend for doubt in result.doubts))
        raise RigError(
            f"The scan cannot be trusted: in {tries} tries of {which} no frame could be kept, in the last one "
            f"because {why}. {mends[0].upper()}{mends[1:]}; then continue the scan."
        )

    def _remark(self, leg: Leg, result: PassResult) -> None:
        """Record corrected and harmless faults of a pass."""
        axis, pairing, limits = leg.train.axis, result.pairing, self._rig.limits
        followed = limits.pass_speed_um_s(axis) == limits.axis(axis).speed_um_s
        if result.count_mended and axis in self._agreed and followed:
            self._remarks.slipped(axis, result.count_mended, limits)
        if result.doubts:
            return
        self._agreed.add(axis)
        if result.slip:
            self._remarks.drifted(axis, result.slip, limits)
        if pairing is not None:
            self._remarks.paired(pairing.extra_edges, pairing.uncounted, pairing.strays)

    def _report(self) -> None:
        self._remarks.close()
        if self._holes and not self._stopped:
            self._sink.fault(_still_missing(list(self._holes.values())))


class _Remarks:
    """Harmless faults, reported on first occurrence and summed up at the end."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._totals: dict[str, list[int]] = {}

    def slipped(self, axis: Axis, counts: int, limits: RigLimits) -> None:
        """Record a corrected count error of the box before a pass."""
        self._add(
            f"Between two passes the pulse box's count of the {axis} axis slipped, by {counts:+d} counts "
            f"({limits.axis(axis).position_um(counts):+.2f} um) at first; it was set by the stage's position before "
            "any frame was taken. Check the cable and the signal of the scale.",
            f"the pulse box's count of the {axis} axis slipped between passes",
            1,
        )

    def drifted(self, axis: Axis, counts: int, limits: RigLimits) -> None:
        """Record a change of 1 or 2 counts in a pass whose frames are kept."""
        self._add(
            f"In a pass the pulse box's count of the {axis} axis moved by {counts:+d} counts against the position of "
            f"the stage ({limits.axis(axis).position_um(counts):+.3f} um). Its frames are kept: such differences are "
            "too frequent to be told from errors of that position. Check the scale, and the stage's resolution.",
            f"the pulse box's count of the {axis} axis moved by 1 or 2 counts",
            1,
        )

    def paired(self, extra_edges: int, uncounted: int, strays: int) -> None:
        """Record differences of the camera's counter and images from the pulses; frames are assigned by time."""
        mend = "every frame is in its slot by its time. Check the trigger cable for noise."
        if extra_edges:
            first = f"The camera counted {_times(extra_edges, 'edge')} that the pulse box did not send; {mend}"
            self._add(first, "the camera counted edges that the pulse box did not send", extra_edges)
        if uncounted:
            first = (
                f"The camera did not count {_times(uncounted, 'pulse')}: it ignores triggers, or numbers its images "
                "instead of its triggers; every frame is in its slot by its time."
            )
            self._add(first, "the camera did not count pulses", uncounted)
        if strays:
            first = f"The camera sent {_times(strays, 'image')} that no pulse took, left out; {mend}"
            self._add(first, "the camera sent images that no pulse took", strays)

    def close(self) -> None:
        """Report the totals of faults that occurred in more than one pass."""
        for what, numbers in self._totals.items():
            if len(numbers) > 1:
                self._tell(f"In {len(numbers)} passes {what}: {sum(numbers)} times in all.")

    def _add(self, first: str, what: str, number: int) -> None:
        if what not in self._totals:
            self._tell(first)
        self._totals.setdefault(what, []).append(number)


def _untrusted(leg: Leg, result: PassResult) -> list[MissingFrame]:
    """Return every slot of a pass as an empty one."""
    train, why = leg.train, ", and ".join(doubt.why for doubt in result.doubts)
    step = train.direction * train.counts_per_frame
    return [MissingFrame(shot, train.first_count + step * i, why) for i, shot in enumerate(leg.shots)]


def _times(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _still_missing(holes: list[MissingFrame]) -> str:
    named = ", ".join(f"field {h.shot.field} frame {h.shot.k} ({h.why})" for h in holes[:NAMED])
    more = f" and {len(holes) - NAMED} more" if len(holes) > NAMED else ""
    return f"After {REPAIRS} repairs {len(holes)} frames are missing: {named}{more}; continue the scan to try again."
