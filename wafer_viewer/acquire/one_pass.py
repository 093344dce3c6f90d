"""One pass of a scan on a rig: get there, arm, move, and hand on every frame as soon as it is known."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from wafer_viewer.acquire.reconcile import Hole, Reconciler, Timing
from wafer_viewer.model.devices import CameraImage, PulseSummary, Rig
from wafer_viewer.model.errors import MissedPulse, MotionStopped, RigError
from wafer_viewer.model.plan import Axis, Leg, PulseTrain
from wafer_viewer.model.stack import Frame

POLL_S = 0.05
"""How long a look for the next image may take before the box's heart is beaten again."""
GRACE_S = 0.25
"""How long after the last pulse's exposure and readout an image may still come."""
SYNC_TRIES = 3
NOTHING_SENT = PulseSummary(emitted=0, suppressed=0, quadrature_errors=0, exposures=0)


@dataclass(frozen=True, slots=True)
class PassResult:
    """How a pass went: what the box says, the slots left empty, and the offset of the clocks at its end."""

    summary: PulseSummary
    holes: tuple[Hole, ...]
    offset_us: float
    stopped: bool


@contextmanager
def rest_afterwards(rig: Rig) -> Generator[None]:
    """Whatever happens within: no more pulses, the stage halts, the camera waits for nothing."""
    with ExitStack() as afterwards:
        afterwards.callback(rig.camera.stop)
        afterwards.callback(rig.stage.stop)
        afterwards.callback(rig.box.halt)
        yield


def clock_offset_us(rig: Rig, exposure_us: float) -> float:
    """Camera time less box time, from a single pulse on command: proves the trigger's way, before anything moves.

    Raises RigError when no image answers.
    """
    here = rig.limits.z.counts(rig.stage.position().z_um)
    train = PulseTrain(axis="z", first_count=here, counts_per_frame=1, n_frames=1, direction=1)
    for _ in range(SYNC_TRIES):
        rig.camera.start(exposure_us)
        rig.box.arm(train, on_command=True)
        rig.box.fire()
        image = rig.camera.next_image(_image_s(rig, exposure_us))
        rig.box.disarm()
        pulses = rig.box.pulses()
        rig.camera.stop()
        if image is not None and pulses:
            return image.device_time_us - pulses[0].time_us
    raise RigError(
        f"The camera gave no image for {SYNC_TRIES} test pulses: check the trigger cable and that the camera waits for "
        "its hardware trigger."
    )


def run_pass(
    rig: Rig,
    leg: Leg,
    exposure_us: float,
    offset_us: float,
    keep: Callable[[Frame], None],
    should_stop: Callable[[], bool],
) -> PassResult:
    """Carry out a leg; every frame goes to `keep` while the pass runs, whatever fails later.

    Raises MissedPulse when the box sent no pulse at all, RigError when no image came at all or a device refuses.
    """
    one = _Pass(rig, leg, exposure_us, offset_us, keep, should_stop)
    if not one.get_there():
        return PassResult(NOTHING_SENT, (), offset_us, stopped=True)
    rig.camera.start(exposure_us)
    stopped = one.shoot() if leg.speed_um_s == 0 else one.sweep()
    result = one.finish(stopped)
    rig.camera.stop()
    return result


class _Pass:
    def __init__(
        self,
        rig: Rig,
        leg: Leg,
        exposure_us: float,
        offset_us: float,
        keep: Callable[[Frame], None],
        should_stop: Callable[[], bool],
    ) -> None:
        self._rig = rig
        self._leg = leg
        self._exposure_us = exposure_us
        self._keep = keep
        self._should_stop = should_stop
        self._reconciler = Reconciler(leg, rig.limits, _timing(rig, leg, exposure_us, offset_us))

    def get_there(self) -> bool:
        """Go to where the pass begins; returns whether it was not stopped on the way."""
        train = self._leg.train
        first_um = self._rig.limits.axis(train.axis).position_um(train.first_count)
        return self._go_to(first_um - self._run_up_um())

    def sweep(self) -> bool:
        """Move through all pulses at speed; returns whether it was stopped on the way."""
        stage, train, speed = self._rig.stage, self._leg.train, self._leg.speed_um_s
        last_um = self._rig.limits.axis(train.axis).position_um(train.last_count)
        self._rig.box.arm(train)
        stage.start(train.axis, last_um + self._run_up_um(), speed)
        while stage.moving():
            if self._should_stop():
                stage.stop()
                stage.wait()
                return True
            self._look(POLL_S)
        return False

    def shoot(self) -> bool:
        """Halt and settle at every count of the train and take a frame there; returns whether it was stopped."""
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

    def finish(self, stopped: bool) -> PassResult:
        """Wait for the images under way, end the run, and say what is missing."""
        deadline_s = self._rig.clock.now_s() + _image_s(self._rig, self._exposure_us)
        while not stopped and not self._reconciler.all_paired and self._rig.clock.now_s() < deadline_s:
            self._look(POLL_S)
        summary = self._rig.box.disarm()
        self._pair([])
        holes = tuple(self._reconciler.holes())
        if not stopped:
            self._check_anything_came(summary, holes)
        return PassResult(summary, holes, self._reconciler.offset_us, stopped)

    def _run_up_um(self) -> float:
        train = self._leg.train
        return train.direction * self._rig.limits.axis(train.axis).run_up_um(self._leg.speed_um_s)

    def _go_to(self, at_um: float) -> bool:
        """Move along the pass' axis, to the pass in the others; returns whether it was not stopped."""
        leg = self._leg
        goal: dict[Axis, float] = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um, leg.train.axis: at_um}
        try:
            self._rig.stage.move_to(x_um=goal["x"], y_um=goal["y"], z_um=goal["z"], should_stop=self._should_stop)
        except MotionStopped:
            return False
        return True

    def _look(self, timeout_s: float) -> None:
        """Fetch what has come, and beat the heart of the box."""
        image = self._rig.camera.next_image(timeout_s)
        self._pair([] if image is None else [image])

    def _pair(self, images: list[CameraImage]) -> None:
        for frame in self._reconciler.add(images, self._rig.box.pulses()):
            self._keep(frame)

    def _wait_until(self, time_s: float) -> None:
        self._rig.clock.sleep(max(0.0, time_s - self._rig.clock.now_s()))

    def _exposed_s(self) -> float:
        return (self._exposure_us + _delay_us(self._rig)) * 1e-6

    def _check_anything_came(self, summary: PulseSummary, holes: tuple[Hole, ...]) -> None:
        n, shot = self._leg.train.n_frames, self._leg.shots[0]
        if summary.emitted == 0:
            raise MissedPulse(
                f"The pulse box sent 0 of {n} pulses in the pass that begins at field {shot.field}: check the cable of "
                f"the {self._leg.train.axis} scale and its counts per um."
            )
        if len(holes) == n > 1:
            raise RigError(
                f"The camera gave 0 images for {summary.emitted} pulses in the pass that begins at field {shot.field}: "
                "check the trigger cable and that the camera is not in use elsewhere."
            )


def _timing(rig: Rig, leg: Leg, exposure_us: float, offset_us: float) -> Timing:
    period_us = rig.limits.camera.period_s(exposure_us) * 1e6
    if leg.speed_um_s:
        period_us = rig.limits.axis(leg.train.axis).position_um(leg.train.counts_per_frame) / leg.speed_um_s * 1e6
    return Timing(_delay_us(rig), exposure_us, offset_us, period_us / 2)


def _delay_us(rig: Rig) -> float:
    return rig.calibration.trigger_delay_us if rig.calibration is not None else 0.0


def _image_s(rig: Rig, exposure_us: float) -> float:
    """How long after a pulse its image may take."""
    return rig.limits.camera.period_s(exposure_us) + (exposure_us + rig.limits.camera.readout_us) * 1e-6 + GRACE_S
