"""Execution of one pass of a scan: approach, arming, motion, delivery of frames, and final checks."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from wafer_viewer.acquire.motion import Deadline, await_arrival, come_to_rest, device_errors, move
from wafer_viewer.acquire.pulse_reconciliation import (
    COUNT_TOLERANCE,
    DeviceClock,
    Pairing,
    Reconciler,
    Timing,
    stage_count,
)
from wafer_viewer.model.acquisition.devices import CameraImage, ExposureSequencer, PulseSummary, Rig
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import Axis, Leg, PulseTrain
from wafer_viewer.model.errors import MissedPulse, MotionStopped, PulseBoxDisarmed, PulseBoxRestarted, RigError
from wafer_viewer.model.progress import ShouldStop

POLL_S = 0.05
"""Longest wait for an image before the next heartbeat to the pulse box."""
GRACE_S = 0.25
"""Extra time for an image after the last pulse's exposure and readout."""
SYNC_TRIES = 3
"""Largest number of test pulses for the clock of the camera."""
COUNT_READINGS = 5
"""Readings at rest that agree if 1 or 2 counts are a slip and not vibration, a settling time apart."""
NOTHING_SENT = PulseSummary(emitted=0, suppressed=0, quadrature_errors=0, exposures=0)
"""Counts of a pass that was stopped before its pulses."""


@dataclass(frozen=True, slots=True)
class PassSettings:
    """Exposures and timing of a pass, and the slip that it may have.

    exposures_us: exposure times of the plan, by the numbers that the shots name; clock: of the camera against the box;
    count_tolerance: largest slip in counts that is no doubt, at most COUNT_TOLERANCE; delay_us: from a pulse to the
    exposure, None for that of the rig's own calibration.
    """

    exposures_us: tuple[float, ...]
    clock: DeviceClock
    count_tolerance: int = COUNT_TOLERANCE
    delay_us: float | None = None


@dataclass(frozen=True, slots=True)
class PassDoubt:
    """Reason for discarding the frames of a pass, and the remedy if it recurs."""

    why: str
    mend: str


@dataclass(frozen=True, slots=True)
class PassResult:
    """Outcome of a pass.

    doubts: reasons for discarding all of its frames; pairing: None if it was stopped on the approach or the pulse box
    restarted; count_mended: difference of box and stage counts before the pass, which was corrected; slip: this
    difference after the pass, 0 if it is the one before; a doubt only beyond the permitted one.
    """

    summary: PulseSummary
    pairing: Pairing | None
    doubts: tuple[PassDoubt, ...]
    count_mended: int
    stopped: bool
    slip: int = 0


@contextmanager
def rig_at_rest(rig: Rig) -> Generator[None]:
    """Leave the rig at rest on exit: no pulses, stage halted, camera stopped.

    A device that does not obey does not keep the others from it, and does not replace the error of the block.
    """
    try:
        yield
    except BaseException:
        _bring_to_rest(rig)
        raise
    for fault in _bring_to_rest(rig):
        raise fault


def _bring_to_rest(rig: Rig) -> list[RigError]:
    """Stop all devices, and return the errors of those that did not obey."""
    faults: list[RigError] = []
    for device, stop in (("pulse box", rig.box.halt), ("stage", rig.stage.stop), ("camera", rig.camera.stop)):
        try:
            with device_errors(device):
                stop()
        except RigError as fault:
            faults.append(fault)
    return faults


def require_devices(rig: Rig) -> None:
    """Raise the RigError of the first device that does not answer; the camera is stopped."""
    for device, ask in (("stage", rig.stage.position), ("pulse box", rig.box.hello), ("camera", rig.camera.stop)):
        with suppress(PulseBoxRestarted), device_errors(device):
            ask()


def device_clock(rig: Rig, exposure_us: float, before: DeviceClock | None = None) -> DeviceClock:
    """Measure the camera's clock against the box's by one pulse on command, which also tests the trigger line.

    Raises RigError if no image arrives.
    """
    train = PulseTrain(axis="z", first_count=stage_count(rig, "z"), counts_per_frame=1, n_frames=1, direction=1)
    for _ in range(SYNC_TRIES):
        with device_errors("camera"):
            rig.camera.start(exposure_us)
        rig.box.arm(train, on_command=True)
        rig.box.fire()
        with device_errors("camera"):
            image = rig.camera.next_image(image_wait_s(rig, exposure_us))
        rig.box.disarm()
        pulses = rig.box.pulses()
        with device_errors("camera"):
            rig.camera.stop()
        if image is not None and pulses:
            offset_us, at_us = image.device_time_us - pulses[0].time_us, pulses[0].time_us
            if before is None:
                return DeviceClock(offset_us, at_us)
            return DeviceClock(offset_us, at_us, before.drift, before.spread_us)
    raise RigError(
        f"The camera gave no image for {SYNC_TRIES} test pulses: check the trigger cable and that the camera waits for "
        "its hardware trigger."
    )


def run_pass(
    rig: Rig,
    leg: Leg,
    settings: PassSettings,
    take: Callable[[Frame], None],
    should_stop: ShouldStop,
) -> PassResult:
    """Execute a leg of a plan; frames go to `take` and are valid only by the result.

    A restart of the pulse box leaves stage and camera at rest and is a doubt of the result. Raises MissedPulse if the
    box sent no pulse at all, RigTimeout if the stage does not arrive in time, RigError if no image arrived at all or a
    device refuses.
    """
    one = _Pass(rig, leg, settings, take, should_stop)
    try:
        return one.run()
    except PulseBoxDisarmed as fault:
        raise one.explained(fault) from fault
    except PulseBoxRestarted:
        one.abort()
        return PassResult(NOTHING_SENT, None, (RESTARTED,), count_mended=0, stopped=False)


class _Pass:
    def __init__(
        self,
        rig: Rig,
        leg: Leg,
        settings: PassSettings,
        take: Callable[[Frame], None],
        should_stop: ShouldStop,
    ) -> None:
        exposures_us = settings.exposures_us
        self._rig = rig
        self._leg = leg
        self._sequence_us = tuple(exposures_us[e] for e in dict.fromkeys(shot.exposure for shot in leg.shots))
        self._longest_us = max(self._sequence_us)
        self._delay_us = _own_delay_us(rig) if settings.delay_us is None else settings.delay_us
        self._take = take
        self._should_stop = should_stop
        self._count_tolerance = settings.count_tolerance
        self._off_before = 0
        """Difference of box and stage counts when the pass began."""
        timing = _timing(rig, leg, exposures_us, self._longest_us, settings.clock, self._delay_us)
        self._reconciler = Reconciler(leg, rig.limits, timing)
        self._beaten_s, self._stage_s = rig.clock.now_s(), 0.0
        """Time of the last heartbeat, and how long the stage was waited for since."""

    def run(self) -> PassResult:
        """Execute the pass from approach to checks."""
        if not self.move_to_start():
            return PassResult(NOTHING_SENT, None, (), count_mended=0, stopped=True)
        mended = self.mend_count()
        with device_errors("camera"):
            _start_camera(self._rig, self._sequence_us)
        stopped = self.shoot() if self._leg.speed_um_s == 0 else self.sweep()
        return self.finish(stopped, mended)

    def abort(self) -> None:
        """Leave stage and camera at rest."""
        with device_errors("stage"):
            come_to_rest(self._rig)
        with device_errors("camera"):
            self._rig.camera.stop()

    def move_to_start(self) -> bool:
        """Move to the start of the pass; return False if stopped on the way."""
        train = self._leg.train
        first_um = self._rig.limits.axis(train.axis).position_um(train.first_count)
        return self._go_to(first_um - self._run_up_um())

    def mend_count(self) -> int:
        """Correct the box's count by the stage's position if they differ at rest; return the difference in counts."""
        off = self._count_error()
        if self._count_tolerance < abs(off) <= COUNT_TOLERANCE:
            off = self._standing_error()
        if abs(off) <= self._count_tolerance:
            self._off_before = off
            return 0
        axis = self._leg.train.axis
        self._rig.box.reference(axis, stage_count(self._rig, axis))
        return off

    def sweep(self) -> bool:
        """Move through all pulses at speed; return True if stopped on the way."""
        stage, train, speed = self._rig.stage, self._leg.train, self._leg.speed_um_s
        end_um = self._rig.limits.axis(train.axis).position_um(train.last_count) + self._run_up_um()
        with device_errors("stage"):
            deadline = Deadline(self._rig, {train.axis: end_um}, speed)
        self._arm(min_gap_us=self._rig.limits.camera.period_s(self._longest_us) * 1e6)
        with self._waiting_for_stage():
            stage.start(train.axis, end_um, speed)
        while self._moving():
            if self._should_stop():
                with device_errors("stage"):
                    come_to_rest(self._rig)
                return True
            if deadline.passed:
                with device_errors("stage"):
                    raise deadline.give_up()
            self._look(POLL_S)
        return not self._arrived(deadline)

    def shoot(self) -> bool:
        """Halt and settle at every count of the train and take a frame there; return True if stopped."""
        train = self._leg.train
        axis, exposed_s = self._rig.limits.axis(train.axis), self._exposed_s()
        self._arm(on_command=True)
        last_s = -1.0
        for i in range(train.n_frames):
            count = train.first_count + train.direction * train.counts_per_frame * i
            if not self._go_to(axis.position_um(count), armed=True):
                return True
            self._wait_until(last_s + self._rig.limits.camera.period_s(self._longest_us))
            last_s = self._rig.clock.now_s()
            self._rig.box.fire()
            self._wait_until(last_s + exposed_s)
            self._look(0.0)
        return False

    def finish(self, stopped: bool, mended: int) -> PassResult:
        """Wait for outstanding images, end the run and check it."""
        deadline_s = self._rig.clock.now_s() + image_wait_s(self._rig, self._longest_us)
        while not stopped and not self._reconciler.all_paired and self._rig.clock.now_s() < deadline_s:
            self._look(POLL_S)
        summary = self._rig.box.disarm()
        self._pair([])
        with device_errors("camera"):
            self._rig.camera.stop()
        pairing = self._reconciler.close()
        slip = self._slip()
        doubted = slip if abs(slip) > self._count_tolerance else 0
        doubts = doubts_of(summary, pairing, self._leg.train.axis, doubted, self._rig)
        if not stopped:
            self._check_anything_came(summary, pairing)
        return PassResult(summary, pairing, doubts, mended, stopped, slip)

    def _slip(self) -> int:
        """Return the count error of the box after the pass, or 0 if it is the one before."""
        if self._count_error() == self._off_before:
            return 0
        off = self._standing_error()
        return off if off != self._off_before else 0

    def _standing_error(self) -> int:
        """Return the count error that remains after settling; 1 or 2 counts in all readings alike, else none."""
        settle_s, readings = self._rig.limits.axis(self._leg.train.axis).settle_s, list[int]()
        for _ in range(COUNT_READINGS):
            self._wait_until(self._rig.clock.now_s() + settle_s)
            readings.append(self._count_error())
        off = sorted(readings)[COUNT_READINGS // 2]
        return off if abs(off) > COUNT_TOLERANCE or min(readings) == max(readings) else self._off_before

    def _count_error(self) -> int:
        """Return the box's count of the pass axis minus that of the stage's position; valid only at rest."""
        axis = self._leg.train.axis
        return self._rig.box.count(axis) - stage_count(self._rig, axis)

    def _run_up_um(self) -> float:
        train = self._leg.train
        return train.direction * self._rig.limits.axis(train.axis).run_up_um(self._leg.speed_um_s)

    def _arm(self, *, min_gap_us: float = 0.0, on_command: bool = False) -> None:
        self._rig.box.arm(self._leg.train, min_gap_us=min_gap_us, on_command=on_command)
        self._note_heartbeat()

    def _note_heartbeat(self) -> None:
        self._beaten_s, self._stage_s = self._rig.clock.now_s(), 0.0

    def explained(self, disarmed: PulseBoxDisarmed) -> RigError:
        """Return the error for a box that disarmed itself: it names the stage if that was waited for meanwhile."""
        if self._stage_s <= (self._rig.clock.now_s() - self._beaten_s) / 2:
            return disarmed
        return RigError(
            f"The stage was waited for during {self._stage_s:.1f} s, and without a heartbeat meanwhile the pulse box "
            "disarmed itself: check the cable of the stage and the speed of its port, and continue."
        )

    @contextmanager
    def _waiting_for_stage(self) -> Generator[None]:
        begun_s = self._rig.clock.now_s()
        try:
            with device_errors("stage"):
                yield
        finally:
            self._stage_s += self._rig.clock.now_s() - max(begun_s, self._beaten_s)

    def _beat_and_should_stop(self) -> bool:
        self._pair([])
        return self._should_stop()

    def _go_to(self, to_um: float, *, armed: bool = False) -> bool:
        """Move to `to_um` on the pass axis and to the pass position on the others; return False if stopped.

        armed: the pulse box needs its heartbeat on the way.
        """
        leg = self._leg
        goal: dict[Axis, float] = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um, leg.train.axis: to_um}
        try:
            with self._waiting_for_stage():
                move(self._rig, goal, self._beat_and_should_stop if armed else self._should_stop)
        except MotionStopped:
            return False
        return True

    def _arrived(self, deadline: Deadline) -> bool:
        """Wait for the end of the motion; return False if stopped."""
        try:
            with self._waiting_for_stage():
                await_arrival(self._rig, deadline, self._beat_and_should_stop)
        except MotionStopped:
            return False
        return True

    def _moving(self) -> bool:
        with self._waiting_for_stage():
            return self._rig.stage.moving()

    def _look(self, timeout_s: float) -> None:
        """Fetch an available image and send the heartbeat to the box."""
        with device_errors("camera"):
            image = self._rig.camera.next_image(timeout_s)
        self._pair([] if image is None else [image])

    def _pair(self, images: list[CameraImage]) -> None:
        pulses = self._rig.box.pulses()
        self._note_heartbeat()
        for frame in self._reconciler.add(images, pulses):
            self._take(frame)

    def _wait_until(self, time_s: float) -> None:
        self._rig.clock.sleep(max(0.0, time_s - self._rig.clock.now_s()))

    def _exposed_s(self) -> float:
        return (self._longest_us + self._delay_us) * 1e-6

    def _check_anything_came(self, summary: PulseSummary, pairing: Pairing) -> None:
        n, shot = self._leg.train.n_frames, self._leg.shots[0]
        if summary.emitted == 0:
            raise MissedPulse(
                f"The pulse box sent 0 of {n} pulses in the pass that begins at field {shot.field}: check the cable of "
                f"the {self._leg.train.axis} scale and its counts per um."
            )
        if pairing.n_images == 0 and n > 1:
            raise RigError(
                f"The camera gave 0 images for {summary.emitted} pulses in the pass that begins at field {shot.field}: "
                "check the trigger cable and that the camera is not in use elsewhere."
            )


def doubts_of(summary: PulseSummary, pairing: Pairing, axis: Axis, slip: int, rig: Rig) -> tuple[PassDoubt, ...]:
    """Return all reasons to doubt the frames of a pass."""
    found: list[PassDoubt] = []
    if errors := summary.quadrature_errors:
        found.append(PassDoubt(f"the pulse box reports {_n(errors, 'quadrature error')} on the {axis} scale", _SCALE))
    if slip:
        off_um = rig.limits.axis(axis).position_um(slip)
        found.append(
            PassDoubt(
                f"its count of the {axis} axis slipped by {_n(slip, 'count')} ({off_um:+.2f} um) in the pass", _SCALE
            )
        )
    if suppressed := summary.suppressed:
        found.append(PassDoubt(f"the pulse box suppressed {_n(suppressed, 'pulse')} that came too soon", _SPEED))
    least, most = pairing.n_images, pairing.n_images + pairing.n_unexposed
    if not least <= summary.exposures <= most:
        found.append(
            PassDoubt(
                f"the pulse box saw {_n(summary.exposures, 'exposure')} for {_n(summary.emitted, 'pulse')} and "
                f"{_n(pairing.n_images, 'image')}",
                _TRIGGER,
            )
        )
    if pairing.doubt:
        found.append(PassDoubt(pairing.doubt, _TRIGGER))
    return tuple(found)


_SCALE = "check the cable and the signal of the scale, and that the box can follow its speed"
_SPEED = "lower the frame rate or check the scale's signal for noise"
_TRIGGER = "check the cables between pulse box and camera, trigger and exposure signal, for noise and loose contact"
RESTARTED = PassDoubt("the pulse box restarted in the pass", "check the power of the pulse box")


def _n(number: int, what: str) -> str:
    return f"{number} {what}{'' if abs(number) == 1 else 's'}"


def _start_camera(rig: Rig, exposures_us: tuple[float, ...]) -> None:
    """Start the camera at an exposure, or at several in turn."""
    camera = rig.camera
    if len(exposures_us) == 1:
        camera.start(exposures_us[0])
    elif isinstance(camera, ExposureSequencer):
        camera.start_sequence(exposures_us)
    else:
        raise RigError(
            "The plan takes its exposures in turn, and the camera cannot change its exposure from frame to frame: plan "
            "the scan again on this rig."
        )


def _timing(
    rig: Rig, leg: Leg, exposures_us: tuple[float, ...], longest_us: float, clock: DeviceClock, delay_us: float
) -> Timing:
    period_us = rig.limits.camera.period_s(longest_us) * 1e6
    if leg.speed_um_s:
        period_us = rig.limits.axis(leg.train.axis).position_um(leg.train.counts_per_frame) / leg.speed_um_s * 1e6
    return Timing(delay_us, exposures_us, clock, period_us)


def _own_delay_us(rig: Rig) -> float:
    return rig.calibration.trigger_delay_us if rig.calibration is not None else 0.0


def image_wait_s(rig: Rig, exposure_us: float) -> float:
    """Return the longest time from a pulse to its image."""
    return rig.limits.camera.period_s(exposure_us) + (exposure_us + rig.limits.camera.readout_us) * 1e-6 + GRACE_S
