"""The rig under the checks: motions with a deadline, passes with pulses, and frames taken on command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from wafer_viewer.acquire.conformance.travel import TravelLimits, TravelWindow, travel_windows
from wafer_viewer.acquire.motion import Deadline, at_um, come_to_rest, device_errors
from wafer_viewer.acquire.pass_runner import image_wait_s
from wafer_viewer.model.acquisition.devices import CameraImage, Pulse, PulseSummary, Rig
from wafer_viewer.model.acquisition.plan import AXES, Axis, PulseTrain
from wafer_viewer.model.errors import MotionStopped
from wafer_viewer.model.progress import ShouldStop, never

POLL_S = 0.005
"""Time between two looks at a moving stage, s."""
SPACING_S = 0.05
"""Least time between two frames on command, s: noise up to 35 ms after a trigger shows as a frame of its own."""
COMFORTABLE_US = 1_000.0
"""Exposure where none is given, us, within the limits of the camera."""


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """Frame on command: times of the command and of the arrival on the clock of the rig; None for no image."""

    fired_s: float
    arrived_s: float
    image: CameraImage | None


@dataclass(frozen=True, slots=True)
class Shooting:
    """Frames on command, what arrived beyond them, the pulses and the summary of the box."""

    frames: tuple[TimedFrame, ...]
    surplus: tuple[CameraImage, ...]
    pulses: tuple[Pulse, ...]
    summary: PulseSummary

    @property
    def images(self) -> list[CameraImage]:
        """All images in the order of their arrival."""
        return [*(frame.image for frame in self.frames if frame.image is not None), *self.surplus]


@dataclass(slots=True)
class ConformanceBench:
    """A rig with the ranges in which it may move."""

    rig: Rig
    travel: TravelLimits = field(default_factory=TravelLimits)
    should_stop: ShouldStop = never
    _windows: dict[Axis, TravelWindow] = field(default_factory=dict[Axis, TravelWindow])

    @property
    def windows(self) -> dict[Axis, TravelWindow]:
        """Ranges of the axes, set where the stage stands when they are first asked for."""
        if not self._windows:
            self._windows = travel_windows(self.rig.limits, self.rig.stage.position(), self.travel)
        return self._windows

    @property
    def exposure_us(self) -> float:
        """Exposure of frames for which any exposure will do."""
        camera = self.rig.limits.camera
        return min(max(COMFORTABLE_US, camera.exposure_min_us), camera.exposure_max_us)

    def require_running(self) -> None:
        """Raise MotionStopped when the user has stopped the checks."""
        if self.should_stop():
            with device_errors("stage"):
                here = self.rig.stage.position()
            raise MotionStopped.at(here.x_um, here.y_um, here.z_um)

    def position_um(self, axis: Axis) -> float:
        """Return the position of an axis by the stage."""
        with device_errors("stage"):
            return at_um(self.rig.stage.position(), axis)

    def reference(self) -> None:
        """Set the counts of the pulse box from the position of the stage at rest."""
        for axis in AXES:
            self.rig.box.reference(axis, self.rig.limits.axis(axis).counts(self.position_um(axis)))

    def go(self, axis: Axis, to_um: float) -> None:
        """Move an axis at full speed; that it arrived is another check's demand.

        Raises MotionStopped when the user stops the checks, RigTimeout when the stage does not end its motion in time.
        """
        self.require_running()
        deadline = Deadline(self.rig, {axis: to_um})
        goal: dict[Axis, float | None] = {"x": None, "y": None, "z": None, axis: to_um}
        try:
            with device_errors("stage"):
                self.rig.stage.move_to(
                    x_um=goal["x"],
                    y_um=goal["y"],
                    z_um=goal["z"],
                    should_stop=lambda: self.should_stop() or deadline.passed,
                )
        except MotionStopped:
            if deadline.passed and not self.should_stop():
                raise deadline.give_up() from None
            raise

    def sweep(
        self, axis: Axis, to_um: float, speed_um_s: float, look: Callable[[], None] = lambda: None
    ) -> list[Pulse]:
        """Move an axis at a speed, with the heartbeat of the box and `look` on the way; return the pulses."""
        self.require_running()
        rig, pulses = self.rig, list[Pulse]()
        deadline = Deadline(rig, {axis: to_um}, speed_um_s)
        with device_errors("stage"):
            rig.stage.start(axis, to_um, speed_um_s)
            while rig.stage.moving():
                if self.should_stop():
                    come_to_rest(rig)
                    self.require_running()
                if deadline.passed:
                    raise deadline.give_up()
                rig.clock.sleep(POLL_S)
                look()
                pulses += rig.box.pulses()
        rig.clock.sleep(rig.limits.axis(axis).settle_s)
        return pulses

    def shoot(self, n: int, exposure_us: float, spacing_s: float = SPACING_S) -> Shooting:
        """Take frames on command at rest."""
        rig, wait_s = self.rig, image_wait_s(self.rig, exposure_us)
        spacing_s = max(spacing_s, rig.limits.camera.period_s(exposure_us))
        with device_errors("camera"):
            rig.camera.start(exposure_us)
        self.arm_on_command("z", n)
        frames: list[TimedFrame] = []
        pulses: list[Pulse] = []
        for _ in range(n):
            self.require_running()
            fired_s = rig.clock.now_s()
            rig.box.fire()
            with device_errors("camera"):
                image = rig.camera.next_image(wait_s)
            frames.append(TimedFrame(fired_s, rig.clock.now_s(), image))
            pulses += self._wait(max(0.0, spacing_s - (rig.clock.now_s() - fired_s)))
        surplus = self._surplus(wait_s)
        summary = rig.box.disarm()
        with device_errors("camera"):
            rig.camera.stop()
        return Shooting(tuple(frames), tuple(surplus), (*pulses, *rig.box.pulses()), summary)

    def arm_on_command(self, axis: Axis, n: int, *, min_gap_us: float = 0.0) -> None:
        """Arm the box for pulses on command only; the count of the axis is set to 0 where it is not known."""
        if not self.rig.box.referenced(axis):
            self.rig.box.reference(axis, 0)
        train = PulseTrain(axis=axis, first_count=0, counts_per_frame=1, n_frames=n, direction=1)
        self.rig.box.arm(train, min_gap_us=min_gap_us, on_command=True)

    def _wait(self, seconds: float) -> list[Pulse]:
        """Wait with heartbeats; return the pulses."""
        clock, pulses = self.rig.clock, self.rig.box.pulses()
        until_s = clock.now_s() + seconds
        while (left_s := until_s - clock.now_s()) > 0:
            clock.sleep(min(left_s, SPACING_S))
            pulses += self.rig.box.pulses()
        return pulses

    def _surplus(self, wait_s: float) -> list[CameraImage]:
        found: list[CameraImage] = []
        with device_errors("camera"):
            while len(found) < self.rig.limits.camera.queue_frames:
                image = self.rig.camera.next_image(wait_s)
                if image is None:
                    break
                found.append(image)
        return found
