"""Live view and jog handle in the rig process: both end by themselves when nobody renews them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

import numpy as np

from wafer_viewer.acquire.commanded_frames import CommandedFrame, CommandedFrames
from wafer_viewer.acquire.motion import LOOK_S, REST, JogVelocity
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import RigError
from wafer_viewer.session.acquisition.rig_messages import Jog, LiveFailed
from wafer_viewer.session.state.instrument_state import LiveFrame

WORD_S = 0.4
"""Time after the last word of a jog at which the stage is stopped: the page repeats the word every 0.15 s."""
WATCHED_S = 3.0
"""Time after the last word of a viewer at which the live view ends: the page repeats it every second."""
FIRST_FRAME_S = 0.1
"""Assumed duration of a frame during a motion before one was taken."""
LIVE_HZ = 25.0
"""Most frames in a second of the wall clock; a simulated rig would otherwise fill a processor with them."""
MOST_FAILURES = 3
"""Failures in a row after which the view ends: a box that waited too long for a heartbeat is armed again."""
BINS = 64
"""Classes of the histogram of a frame."""


class JogHandle:
    """Dead man's handle: a velocity that is zero as soon as it is not renewed. Set by one thread, read by another."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._word = Jog(0)
        self._until_s = -1.0
        self._broken_hold: int | None = None
        self.taken = False
        """True from the first word of a jog until the executor has ended it."""

    def tell(self, word: Jog) -> bool:
        """Set the velocity for the next `WORD_S`; return True if the executor has to begin a jog."""
        if word.hold == self._broken_hold:
            return False
        self._word, self._until_s = word, self._now_s() + WORD_S
        begins = not self.taken and not word.velocity.at_rest
        self.taken = self.taken or begins
        return begins

    def break_off(self) -> None:
        """End the jog; further words of the same hold are ignored, until the key is pressed again."""
        self._broken_hold, self._until_s = self._word.hold, -1.0

    @property
    def left_s(self) -> float:
        """Time in s until the stage must be stopped, unless a word comes."""
        return self._until_s - self._now_s()

    @property
    def highest_um(self) -> float | None:
        """Highest known z of the sample, by the last word."""
        return self._word.highest_um

    def velocity(self) -> JogVelocity:
        """Return the wanted velocity."""
        return self._word.velocity if self.left_s > 0 else REST


class LiveCamera:
    """Frames on command for as long as somebody watches; a frame is sent once the last one was acknowledged."""

    def __init__(self, rig: Rig, tell: Callable[[object], None], now_s: Callable[[], float] = time.monotonic) -> None:
        self._rig, self._tell, self._now_s = rig, tell, now_s
        self._until_s = -1.0
        self._exposure_us = 0.0
        self._frames: CommandedFrames | None = None
        self._open_us = 0.0
        self._has_room = True
        self._frame_s = FIRST_FRAME_S
        self._next_s = 0.0
        self._failures = 0
        self._origin_s = (0.0, 0.0)
        """Time of the wall clock and of the rig's at the beginning of a motion."""

    # --- from the listening thread

    def watch(self, exposure_us: float) -> None:
        """Show frames at an exposure for the next `WATCHED_S`."""
        self._exposure_us, self._until_s = exposure_us, self._now_s() + WATCHED_S

    def acknowledge(self) -> None:
        """Allow the next frame to be sent."""
        self._has_room = True

    # --- on the thread that uses the devices

    @property
    def watched(self) -> bool:
        """True while frames are wanted."""
        return self._now_s() < self._until_s

    def end(self) -> None:
        """End the view until somebody watches again."""
        self._until_s = -1.0
        self.suspend()

    def suspend(self) -> None:
        """Disarm the pulse box and stop the camera, as before a scan or a move."""
        if (frames := self._frames) is None:
            return
        self._frames = None
        try:
            frames.close()
        except (RigError, OSError):
            self._release()

    @property
    def wait_s(self) -> float:
        """Time in s until the next frame is due."""
        return max(0.0, self._next_s - self._now_s())

    def take(self) -> None:
        """Take a frame and send it, if the last one was received; repeated failures end the view and are reported."""
        self._next_s = self._now_s() + 1 / LIVE_HZ
        try:
            frames = self._opened()
            if not self._has_room:
                frames.beat()
                return
            frame = frames.take()
        except (RigError, OSError) as fault:
            self._fail(str(fault))
            return
        self._failures = 0
        if frame is not None:
            self._has_room = False
            self._tell(live_frame(frame, self._open_us))

    def begin_motion(self) -> None:
        """Set the clocks for a motion: that of a simulated rig may run faster than the wall clock."""
        self._origin_s = self._now_s(), self._rig.clock.now_s()

    def take_within(self, left_s: float) -> None:
        """Take a frame during a motion if it is due and over before `left_s`; otherwise wait a moment."""
        is_open = self._frames is not None and self._open_us == self._exposure_us
        due = self.watched and is_open and self._has_room and self.wait_s == 0 and self._behind_s > -LOOK_S
        if not due or left_s < 1.5 * self._frame_s:
            time.sleep(LOOK_S)
        else:
            begun_s = self._now_s()
            self.take()
            self._frame_s = self._now_s() - begun_s
        if self._behind_s > 0:
            self._rig.clock.sleep(self._behind_s)

    @property
    def _behind_s(self) -> float:
        """Time by which the rig's clock is behind the wall clock since the beginning of the motion, s."""
        wall_s, rig_s = self._origin_s
        return (self._now_s() - wall_s) - (self._rig.clock.now_s() - rig_s)

    def _fail(self, why: str) -> None:
        self._frames = None
        self._release()
        self._failures += 1
        if self._failures >= MOST_FAILURES:
            self._failures, self._until_s = 0, -1.0
            self._tell(LiveFailed(why))

    def _opened(self) -> CommandedFrames:
        if self._frames is not None and self._open_us != self._exposure_us:
            self.suspend()
        if self._frames is None:
            frames = CommandedFrames(self._rig, self._exposure_us)
            frames.open()
            self._frames, self._open_us = frames, self._exposure_us
        return self._frames

    def _release(self) -> None:
        """Leave box and camera at rest after a failure, as far as they answer."""
        with contextlib.suppress(RigError, OSError):
            self._rig.box.halt()
        with contextlib.suppress(RigError, OSError):
            self._rig.camera.stop()


def live_frame(frame: CommandedFrame, exposure_us: float) -> LiveFrame:
    """Return a frame with its score, brightest pixel, saturated pixels and histogram."""
    from wafer_viewer.numerics.filters.frame_focus import frame_focus

    image, white = frame.image, int(np.iinfo(frame.image.dtype).max)
    counts = np.bincount((image >> (8 * image.itemsize - 6)).ravel(), minlength=BINS)
    return LiveFrame(
        image=image,
        position=frame.position,
        taken_s=time.time(),
        exposure_us=exposure_us,
        score=frame_focus(image),
        brightest=int(image.max()),
        saturated=saturated_fraction(image, white),
        histogram=tuple(counts.tolist()),
    )


def saturated_fraction(image: Image, white: int) -> float:
    """Return the fraction of pixels at the limit."""
    return float(np.count_nonzero(image == white)) / image.size
