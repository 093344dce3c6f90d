"""Which image belongs to which pulse, and where the stage was then. Never by the order of arrival.

One ignored trigger in 126 would mislabel most of a field by a step if images were counted off. Here an image is named
by the camera's trigger counter where it has one, else by its device time; what has no image stays an empty slot.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from wafer_viewer.model.devices import CameraImage, Pulse
from wafer_viewer.model.limits import RigLimits
from wafer_viewer.model.plan import Leg, Shot
from wafer_viewer.model.stack import Frame, FrameStatus


@dataclass(frozen=True, slots=True)
class Timing:
    """When a pulse exposes: the camera's delay and exposure; and how camera and box tell the time.

    offset_us is the camera's device time less the box's; tolerance_us is half a pulse period.
    """

    delay_us: float
    exposure_us: float
    offset_us: float
    tolerance_us: float

    @property
    def middle_s(self) -> float:
        """From the pulse to mid-exposure."""
        return (self.delay_us + self.exposure_us / 2) * 1e-6


@dataclass(frozen=True, slots=True)
class Hole:
    """A slot without a frame, the scale count of its pulse, and why."""

    shot: Shot
    count: int
    why: str


class Reconciler:
    """Pairs the images and pulses of one pass as they come, in whatever order they come."""

    def __init__(self, leg: Leg, limits: RigLimits, timing: Timing) -> None:
        self._leg = leg
        self._limits = limits
        self._timing = timing
        self._offset_us = timing.offset_us
        self._pulses: dict[int, Pulse] = {}
        self._waiting: list[CameraImage] = []
        self._taken: set[int] = set()
        self._spoilt: set[int] = set()

    @property
    def offset_us(self) -> float:
        """Camera time less box time by the last pair, so that a drift between them is followed."""
        return self._offset_us

    @property
    def all_paired(self) -> bool:
        """Whether every slot of the leg has its image."""
        return len(self._taken) == len(self._leg.shots)

    def add(self, images: Iterable[CameraImage], pulses: Iterable[Pulse]) -> list[Frame]:
        """Take what has come; returns the frames that are known by it."""
        self._pulses |= {pulse.number: pulse for pulse in pulses}
        waiting, self._waiting = [*self._waiting, *images], []
        frames = (self._frame(image) for image in waiting)
        return [frame for frame in frames if frame is not None]

    def holes(self) -> list[Hole]:
        """The slots that have no frame as yet."""
        sent = {self._place(pulse) for pulse in self._pulses.values()}
        return [
            Hole(shot, self._count(i), self._why(i, sent))
            for i, shot in enumerate(self._leg.shots)
            if i not in self._taken
        ]

    def _frame(self, image: CameraImage) -> Frame | None:
        pulse = self._pulse_of(image)
        if pulse is None:
            self._waiting.append(image)
            return None
        place = self._place(pulse)
        if place is None or place in self._taken:
            return None
        if image.status is not FrameStatus.OK:
            self._spoilt.add(place)
            return None
        self._taken.add(place)
        self._offset_us = image.device_time_us - pulse.time_us
        return frame_of(image, pulse, self._leg, self._leg.shots[place], self._limits, self._timing)

    def _pulse_of(self, image: CameraImage) -> Pulse | None:
        """The pulse that took an image; the counter of a damaged image is not to be trusted."""
        if image.trigger_count is not None and image.status is FrameStatus.OK:
            return self._pulses.get(image.trigger_count)
        time_us = image.device_time_us - self._offset_us
        nearest = min(self._pulses.values(), key=lambda p: abs(p.time_us - time_us), default=None)
        if nearest is None or abs(nearest.time_us - time_us) >= self._timing.tolerance_us:
            return None
        return nearest

    def _place(self, pulse: Pulse) -> int | None:
        """The place in the leg of a pulse, by its scale count; None when it is none of the train's."""
        train = self._leg.train
        place = round(train.direction * (pulse.count - train.first_count) / train.counts_per_frame)
        return place if 0 <= place < train.n_frames else None

    def _count(self, place: int) -> int:
        train = self._leg.train
        return train.first_count + train.direction * train.counts_per_frame * place

    def _why(self, place: int, sent: set[int | None]) -> str:
        if place in self._spoilt:
            return "its image came incomplete"
        return "no image came for its pulse" if place in sent else "the pulse box sent no pulse"


def frame_of(image: CameraImage, pulse: Pulse, leg: Leg, shot: Shot, limits: RigLimits, timing: Timing) -> Frame:
    """The frame of a pulse: the axis in motion at the pulse's scale count, moved on to mid-exposure."""
    train = leg.train
    moved_um = train.direction * leg.speed_um_s * timing.middle_s
    at_um = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um}
    at_um[train.axis] = limits.axis(train.axis).position_um(pulse.count) + moved_um
    return Frame(
        shot=shot,
        pulse_count=pulse.count,
        x_um=at_um["x"],
        y_um=at_um["y"],
        z_um=at_um["z"],
        exposure_us=timing.exposure_us,
        device_time_us=image.device_time_us,
        status=image.status,
        image=image.image,
    )
