"""Single frames on command, at rest or during a motion that nothing times by pulses."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass

from wafer_viewer.acquire.motion import device_errors, move
from wafer_viewer.acquire.pass_runner import image_wait_s, rig_at_rest
from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.acquisition.focus_stack import FrameStatus, Image
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.errors import PulseBoxRestarted, RigError
from wafer_viewer.model.progress import ShouldStop

RUN_FRAMES = 500
"""Frames for which the pulse box is armed at a time: about ten seconds, so that its records stay few."""
TRIES = 3
"""Largest number of commands for one frame that must come."""
TakeFrame = Callable[[float, float, float], Image]
"""Moves the stage to x, y, z in um and takes a frame there."""


@dataclass(frozen=True, slots=True, eq=False)
class CommandedFrame:
    """Frame taken on command, and the stage position halfway between its command and the next look at the stage."""

    image: Image
    position: Position


class CommandedFrames:
    """Camera and pulse box, armed for frames on command; made by `commanded_frames` or `open`."""

    def __init__(self, rig: Rig, exposure_us: float) -> None:
        self._rig, self._exposure_us = rig, exposure_us
        self._wait_s = image_wait_s(rig, exposure_us)
        self._remaining = 0
        self._next_s = 0.0

    def open(self) -> None:
        """Start the camera and arm the pulse box; the stage must be at rest."""
        with device_errors("camera"):
            self._rig.camera.start(self._exposure_us)
        self._rig.box.reference("z", self._here())
        self._arm()

    def take(self) -> CommandedFrame | None:
        """Take a frame, no sooner after the last one than the camera allows; return None if none came whole in time."""
        rig = self._rig
        if self._remaining == 0:
            rig.box.disarm()
            self._arm()
        rig.clock.sleep(max(0.0, self._next_s - rig.clock.now_s()))
        self._next_s = rig.clock.now_s() + rig.limits.camera.period_s(self._exposure_us)
        self._remaining -= 1
        with device_errors("stage"):
            before = rig.stage.position()
        rig.box.fire()
        with device_errors("stage"):
            after = rig.stage.position()
        with device_errors("camera"):
            taken = rig.camera.next_image(self._wait_s)
        self.beat()
        if taken is None or taken.image is None or taken.status is not FrameStatus.OK:
            return None
        return CommandedFrame(taken.image, _between(before, after))

    def beat(self) -> None:
        """Send the heartbeat; a box that disarmed itself meanwhile is armed again for the next frame."""
        try:
            self._rig.box.pulses()
        except PulseBoxRestarted:
            raise
        except RigError:
            self._remaining = 0

    def close(self) -> None:
        """Disarm the pulse box and stop the camera."""
        self._rig.box.disarm()
        with device_errors("camera"):
            self._rig.camera.stop()

    def _arm(self) -> None:
        train = PulseTrain(axis="z", first_count=self._here(), counts_per_frame=1, n_frames=RUN_FRAMES, direction=1)
        self._rig.box.arm(train, on_command=True)
        self._remaining = RUN_FRAMES

    def _here(self) -> int:
        with device_errors("stage"):
            return self._rig.limits.z.counts(self._rig.stage.position().z_um)


@contextmanager
def commanded_frames(rig: Rig, exposure_us: float) -> Generator[CommandedFrames]:
    """Arm camera and pulse box for frames on command; they are at rest again afterwards unless a device failed."""
    frames = CommandedFrames(rig, exposure_us)
    frames.open()
    yield frames
    frames.close()


@contextmanager
def frames_at_places(rig: Rig, exposure_us: float, should_stop: ShouldStop) -> Generator[TakeFrame]:
    """Arm camera and pulse box for frames at places; the rig is left at rest on exit.

    Parameters
    ----------
    rig : Rig
        Rig whose stage moves.
    exposure_us : float
        Exposure of the frames.
    should_stop : ShouldStop
        Polled during the moves.

    Yields
    ------
    TakeFrame
        Moves to a position and returns the frame there. Raises MotionStopped if stopped, RigError if the camera gives
        no image.
    """
    with rig_at_rest(rig), commanded_frames(rig, exposure_us) as frames:

        def take(x_um: float, y_um: float, z_um: float) -> Image:
            with device_errors("stage"):
                move(rig, {"x": x_um, "y": y_um, "z": z_um}, should_stop)
            for _ in range(TRIES):
                if (frame := frames.take()) is not None:
                    return frame.image
            raise RigError(
                f"The camera gave no image for {TRIES} pulses: check the trigger cable and that the camera waits for "
                "its hardware trigger."
            )

        yield take


def _between(a: Position, b: Position) -> Position:
    return Position((a.x_um + b.x_um) / 2, (a.y_um + b.y_um) / 2, (a.z_um + b.z_um) / 2)
