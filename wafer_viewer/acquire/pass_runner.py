"""Execution of one pass of a scan: approach, arming, motion, delivery of frames, and final checks."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from wafer_viewer.acquire.motion import Deadline, at_um, await_arrival, come_to_rest, device_errors, move
from wafer_viewer.acquire.pulse_reconciliation import DeviceClock, Pairing, Reconciler, Timing
from wafer_viewer.model.acquisition.devices import CameraImage, PulseSummary, Rig
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import Axis, Leg, PulseTrain
from wafer_viewer.model.errors import MissedPulse, MotionStopped, PulseBoxRestarted, RigError
from wafer_viewer.model.progress import ShouldStop

AXES: tuple[Axis, ...] = ("x", "y", "z")
POLL_S = 0.05
"""Longest wait for an image before the next heartbeat to the pulse box."""
GRACE_S = 0.25
"""Extra time for an image after the last pulse's exposure and readout."""
SYNC_TRIES = 3
"""Largest number of test pulses for the clock of the camera."""
COUNT_TOLERANCE = 2
"""Permitted difference of pulse box and stage at rest in counts: both round, and an axis at rest still vibrates."""
NOTHING_SENT = PulseSummary(emitted=0, suppressed=0, quadrature_errors=0, exposures=0)
"""Counts of a pass that was stopped before its pulses."""


@dataclass(frozen=True, slots=True)
class PassDoubt:
    """Reason for discarding the frames of a pass, and the remedy if it recurs."""

    why: str
    mend: str


@dataclass(frozen=True, slots=True)
class PassResult:
    """Outcome of a pass.

    doubts: reasons for discarding all of its frames; pairing: None if it was stopped on the approach or the pulse box
    restarted; count_mended: difference of box and stage counts before the pass, which was corrected.
    """

    summary: PulseSummary
    pairing: Pairing | None
    doubts: tuple[PassDoubt, ...]
    count_mended: int
    stopped: bool


@contextmanager
def rig_at_rest(rig: Rig) -> Generator[None]:
    """Leave the rig at rest on exit: no pulses, stage halted, camera stopped."""
    with ExitStack() as afterwards:
        afterwards.callback(rig.camera.stop)
        afterwards.callback(rig.stage.stop)
        afterwards.callback(rig.box.halt)
        yield


def reference_axes(rig: Rig) -> None:
    """Set the counts of the pulse box from the position of the stage at rest."""
    with device_errors("stage"):
        here = rig.stage.position()
    for axis in AXES:
        rig.box.reference(axis, rig.limits.axis(axis).counts(at_um(here, axis)))


def device_clock(rig: Rig, exposure_us: float, before: DeviceClock | None = None) -> DeviceClock:
    """Measure the camera's clock against the box's by one pulse on command, which also tests the trigger line.

    Raises RigError if no image arrives.
    """
    here = rig.limits.z.counts(rig.stage.position().z_um)
    train = PulseTrain(axis="z", first_count=here, counts_per_frame=1, n_frames=1, direction=1)
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
    exposure_us: float,
    clock: DeviceClock,
    take: Callable[[Frame], None],
    should_stop: ShouldStop,
) -> PassResult:
    """Execute a leg; frames go to `take` during the pass and are valid only by its result.

    A restart of the pulse box leaves stage and camera at rest and is a doubt of the result. Raises MissedPulse if the
    box sent no pulse at all, RigTimeout if the stage does not arrive in time, RigError if no image arrived at all or a
    device refuses.
    """
    one = _Pass(rig, leg, exposure_us, clock, take, should_stop)
    try:
        return one.run()
    except PulseBoxRestarted:
        one.abort()
        return PassResult(NOTHING_SENT, None, (RESTARTED,), count_mended=0, stopped=False)


class _Pass:
    def __init__(
        self,
        rig: Rig,
        leg: Leg,
        exposure_us: float,
        clock: DeviceClock,
        take: Callable[[Frame], None],
        should_stop: ShouldStop,
    ) -> None:
        self._rig = rig
        self._leg = leg
        self._exposure_us = exposure_us
        self._take = take
        self._should_stop = should_stop
        self._reconciler = Reconciler(leg, rig.limits, _timing(rig, leg, exposure_us, clock))

    def run(self) -> PassResult:
        """Execute the pass from approach to checks."""
        if not self.move_to_start():
            return PassResult(NOTHING_SENT, None, (), count_mended=0, stopped=True)
        mended = self.mend_count()
        with device_errors("camera"):
            self._rig.camera.start(self._exposure_us)
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
        if abs(off) <= COUNT_TOLERANCE:
            return 0
        self._rig.box.reference(self._leg.train.axis, self._stage_count())
        return off

    def sweep(self) -> bool:
        """Move through all pulses at speed; return True if stopped on the way."""
        stage, train, speed = self._rig.stage, self._leg.train, self._leg.speed_um_s
        end_um = self._rig.limits.axis(train.axis).position_um(train.last_count) + self._run_up_um()
        deadline = Deadline(self._rig, {train.axis: end_um}, speed)
        self._rig.box.arm(train, min_gap_us=self._rig.limits.camera.period_s(self._exposure_us) * 1e6)
        with device_errors("stage"):
            stage.start(train.axis, end_um, speed)
        while self._moving():
            if self._should_stop():
                come_to_rest(self._rig)
                return True
            if deadline.passed:
                raise deadline.give_up()
            self._look(POLL_S)
        return not self._arrived(deadline)

    def shoot(self) -> bool:
        """Halt and settle at every count of the train and take a frame there; return True if stopped."""
        train = self._leg.train
        axis, exposed_s = self._rig.limits.axis(train.axis), self._exposed_s()
        self._rig.box.arm(train, on_command=True)
        last_s = -1.0
        for i in range(train.n_frames):
            count = train.first_count + train.direction * train.counts_per_frame * i
            if not self._go_to(axis.position_um(count)):
                return True
            self._wait_until(last_s + self._rig.limits.camera.period_s(self._exposure_us))
            last_s = self._rig.clock.now_s()
            self._rig.box.fire()
            self._wait_until(last_s + exposed_s)
            self._look(0.0)
        return False

    def finish(self, stopped: bool, mended: int) -> PassResult:
        """Wait for outstanding images, end the run and check it."""
        deadline_s = self._rig.clock.now_s() + image_wait_s(self._rig, self._exposure_us)
        while not stopped and not self._reconciler.all_paired and self._rig.clock.now_s() < deadline_s:
            self._look(POLL_S)
        summary = self._rig.box.disarm()
        self._pair([])
        with device_errors("camera"):
            self._rig.camera.stop()
        pairing = self._reconciler.close()
        doubts = doubts_of(summary, pairing, self._leg.train.axis, self._slip(), self._rig)
        if not stopped:
            self._check_anything_came(summary, pairing)
        return PassResult(summary, pairing, doubts, mended, stopped)

    def _slip(self) -> int:
        """Return the count error of the box after the pass, measured again after settling."""
        off = self._count_error()
        if abs(off) <= COUNT_TOLERANCE:
            return 0
        self._wait_until(self._rig.clock.now_s() + self._rig.limits.axis(self._leg.train.axis).settle_s)
        off = self._count_error()
        return off if abs(off) > COUNT_TOLERANCE else 0

    def _count_error(self) -> int:
        """Return the box's count of the pass axis minus that of the stage's position; valid only at rest."""
        return self._rig.box.count(self._leg.train.axis) - self._stage_count()

    def _stage_count(self) -> int:
        axis = self._leg.train.axis
        with device_errors("stage"):
            return self._rig.limits.axis(axis).counts(at_um(self._rig.stage.position(), axis))

    def _run_up_um(self) -> float:
        train = self._leg.train
        return train.direction * self._rig.limits.axis(train.axis).run_up_um(self._leg.speed_um_s)

    def _go_to(self, to_um: float) -> bool:
        """Move to `to_um` on the pass axis and to the pass position on the others; return False if stopped."""
        leg = self._leg
        goal: dict[Axis, float] = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um, leg.train.axis: to_um}
        try:
            with device_errors("stage"):
                move(self._rig, goal, self._should_stop)
        except MotionStopped:
            return False
        return True

    def _arrived(self, deadline: Deadline) -> bool:
        """Wait for the end of the motion; return False if stopped."""
        try:
            with device_errors("stage"):
                await_arrival(self._rig, deadline, self._should_stop)
        except MotionStopped:
            return False
        return True

    def _moving(self) -> bool:
        with device_errors("stage"):
            return self._rig.stage.moving()

    def _look(self, timeout_s: float) -> None:
        """Fetch an available image and send the heartbeat to the box."""
        with device_errors("camera"):
            image = self._rig.camera.next_image(timeout_s)
        self._pair([] if image is None else [image])

    def _pair(self, images: list[CameraImage]) -> None:
        for frame in self._reconciler.add(images, self._rig.box.pulses()):
            self._take(frame)

    def _wait_until(self, time_s: float) -> None:
        self._rig.clock.sleep(max(0.0, time_s - self._rig.clock.now_s()))

    def _exposed_s(self) -> float:
        return (self._exposure_us + _delay_us(self._rig)) * 1e-6

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


def _timing(rig: Rig, leg: Leg, exposure_us: float, clock: DeviceClock) -> Timing:
    period_us = rig.limits.camera.period_s(exposure_us) * 1e6
    if leg.speed_um_s:
        period_us = rig.limits.axis(leg.train.axis).position_um(leg.train.counts_per_frame) / leg.speed_um_s * 1e6
    return Timing(_delay_us(rig), exposure_us, clock, period_us)


def _delay_us(rig: Rig) -> float:
    return rig.calibration.trigger_delay_us if rig.calibration is not None else 0.0


def image_wait_s(rig: Rig, exposure_us: float) -> float:
    """Return the longest time from a pulse to its image."""
    return rig.limits.camera.period_s(exposure_us) + (exposure_us + rig.limits.camera.readout_us) * 1e-6 + GRACE_S
