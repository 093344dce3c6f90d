"""Foundations of the checks: their descriptor, the ranges of their motions, and the rig under them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from wafer_viewer.acquire.motion import Deadline, at_um, come_to_rest, device_errors
from wafer_viewer.acquire.pass_runner import image_wait_s
from wafer_viewer.model.acquisition.conformance import CheckFigure, ConformanceSubject
from wafer_viewer.model.acquisition.devices import CameraImage, Position, Pulse, PulseSummary, Rig
from wafer_viewer.model.acquisition.plan import AXES, Axis, PulseTrain
from wafer_viewer.model.acquisition.rig_limits import RUN_UP_SPARE_S, AxisLimits, RigLimits
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.progress import ShouldStop, never

# --------------------------------------------------------------------------------------------------------------- travel


ORDER: tuple[Axis, ...] = ("z", "x", "y")
"""Order of motions: the objective first."""
N_PULSES = 64
"""Pulses of a pass: half a second of frames at 120 frames/s, and fewer than the records of any pulse box."""
PULSE_PERIOD_S = 0.001
"""Time between two pulses of a pass at any speed, s: ten times the shortest that a pulse of 50 us allows."""


@dataclass(frozen=True, slots=True)
class TravelLimits:
    """Ranges requested for the checks.

    longest_um: longest motion of x and y in um; None for as much as their full speed needs.
    z_um: range of z in um; None for below its position, away from the objective.
    """

    longest_um: float | None = None
    z_um: tuple[float, float] | None = None

    def require_reachable(self, limits: RigLimits) -> None:
        """Raise RigError for a range that is empty or that z cannot reach, and for a motion of no length."""
        if self.longest_um is not None and self.longest_um <= 0:
            raise RigError(f"The longest motion of x and y is {self.longest_um:g} um: it must be over 0.")
        if self.z_um is None:
            return
        for end_um in self.z_um:
            limits.z.require_reachable("z", end_um)
        if self.z_um[1] <= self.z_um[0]:
            raise RigError(
                f"The range of z from {self.z_um[0]:g} to {self.z_um[1]:g} um is empty: give the lower end first."
            )


@dataclass(frozen=True, slots=True)
class TravelWindow:
    """Range of one axis during the checks, and the fastest speed of a pass of N_PULSES in it."""

    axis: Axis
    low_um: float
    high_um: float
    speed_um_s: float
    limits: AxisLimits = field(repr=False)

    @property
    def length_um(self) -> float:
        """Length of the range."""
        return self.high_um - self.low_um

    @property
    def words(self) -> str:
        """Range, length and speed as a sentence."""
        return (
            f"{self.axis} moves by {self.length_um:.1f} um at the most, between {self.low_um:.1f} and "
            f"{self.high_um:.1f} um, with pulses at up to {self.speed_um_s:.0f} um/s"
        )

    def at_um(self, fraction: float) -> float:
        """Return the position at a fraction of the range."""
        return self.low_um + fraction * self.length_um


def travel_windows(limits: RigLimits, here: Position, travel: TravelLimits) -> dict[Axis, TravelWindow]:
    """Return the range of every axis round a position.

    x and y move to both sides. z moves below its position; where there is no room below, it moves up from its lower
    end by no more than it needs, and never over the safe height.
    """
    return {axis: _window(limits, axis, at_um(here, axis), travel) for axis in ORDER}


def speed_within_um_s(limits: AxisLimits, length_um: float, fastest_um_s: float) -> float:
    """Return the highest speed at which run-up, N_PULSES and run-out fit into a length."""
    constant_s = 2 * RUN_UP_SPARE_S + N_PULSES * PULSE_PERIOD_S
    # v^2 / a + constant v = length
    a = limits.acceleration_um_s2
    return min(fastest_um_s, (math.sqrt((constant_s * a) ** 2 + 4 * a * length_um) - constant_s * a) / 2)


def _window(limits: RigLimits, axis: Axis, here_um: float, travel: TravelLimits) -> TravelWindow:
    one, fastest_um_s = limits.axis(axis), limits.pass_speed_um_s(axis)
    needed_um = 2 * one.run_up_um(fastest_um_s) + N_PULSES * PULSE_PERIOD_S * fastest_um_s
    low_um, high_um = one.low_um, one.high_um
    if axis != "z":
        low_um, high_um = _placed(low_um, high_um, here_um, min(needed_um, travel.longest_um or needed_um), 0.5)
    elif travel.z_um is None:
        low_um, high_um = _placed(low_um, min(high_um, limits.objective.safe_z_um), here_um, needed_um, 1.0)
    else:
        low_um, high_um = travel.z_um
    return TravelWindow(axis, low_um, high_um, speed_within_um_s(one, high_um - low_um, fastest_um_s), one)


def _placed(low_um: float, high_um: float, here_um: float, length_um: float, below: float) -> tuple[float, float]:
    """Return a range with a fraction `below` of it under a position, shifted into the limits."""
    bottom_um = max(low_um, min(here_um - below * length_um, high_um - length_um))
    return bottom_um, min(high_um, bottom_um + length_um)


def words_of(windows: Mapping[Axis, TravelWindow]) -> tuple[str, ...]:
    """Return the ranges as sentences."""
    return tuple(window.words for window in windows.values())


# ---------------------------------------------------------------------------------------------------------------- bench


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


# ---------------------------------------------------------------------------------------------------------------- check


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
