"""Pulses and positions: references of the counts, and the pairing of images with the pulses that triggered them.

Never by order of arrival: one ignored trigger in 126 would shift most of a field by a step. The device time of an
image identifies its pulse, because camera and pulse box keep time far better than half a pulse period. The camera's
counter is a cross-check: noise on its input makes it count too much, and a camera that numbers its exposures counts
too little. If the two disagree, the time decides, provided that the times of the images are consistent. Undecided
cases become an empty slot, or a whole pass is taken again.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from wafer_viewer.acquire.motion import Deadline, at_um, await_arrival, device_errors, move
from wafer_viewer.model.acquisition.devices import CameraImage, Pulse, Rig
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus
from wafer_viewer.model.acquisition.plan import AXES, Axis, Leg, Shot
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

# ------------------------------------------------------------------------------------------------------- axis reference


COUNT_TOLERANCE = 2
"""Permitted difference of pulse box and stage at rest in counts, if the position of the stage cannot tell fewer."""
MARK_ORDER: tuple[Axis, ...] = ("z", "x", "y")
"""Order of the motions over the index marks: the objective first, which then stays away for the others."""


def reference_axes(rig: Rig, should_stop: ShouldStop = lambda: False) -> None:
    """Set the counts of the pulse box from the position of the stage at rest, or by the index marks of its axes.

    An axis with an index mark moves over it upward, after z went to its lower end. Raises RigError if the box meets no
    mark, or then counts otherwise than the stage; MotionStopped if `should_stop` returns True on the way.
    """
    marked = marked_axes(rig.limits)
    if marked:
        with device_errors("stage"):
            move(rig, {"z": rig.limits.z.low_um}, should_stop)
    for axis in AXES:
        if axis not in marked:
            rig.box.reference(axis, stage_count(rig, axis))
    for axis in marked:
        _reference_by_index(rig, axis, should_stop)
        if axis == "z":
            with device_errors("stage"):
                move(rig, {"z": rig.limits.z.low_um}, should_stop)


def marked_axes(limits: RigLimits) -> list[Axis]:
    """Return the axes with an index mark, in the order of their motions."""
    return [axis for axis in MARK_ORDER if limits.axis(axis).index_um is not None]


def stage_count(rig: Rig, axis: Axis) -> int:
    """Return the scale count of an axis by the position of the stage."""
    with device_errors("stage"):
        return rig.limits.axis(axis).counts(at_um(rig.stage.position(), axis))


def _reference_by_index(rig: Rig, axis: Axis, should_stop: ShouldStop) -> None:
    limits = rig.limits.axis(axis)
    mark_um, way_um = limits.index_um, limits.over_index_um(rig.limits.objective.safe_z_um if axis == "z" else None)
    if mark_um is None or way_um is None:
        return
    before_um, behind_um = way_um
    with device_errors("stage"):
        move(rig, {axis: before_um}, should_stop)
    rig.box.reference_by_index(axis, limits.counts(mark_um))
    speed_um_s = limits.index_speed_um_s(rig.limits.count_rate_hz)
    with device_errors("stage"):
        deadline = Deadline(rig, {axis: behind_um}, speed_um_s)
        rig.stage.start(axis, behind_um, speed_um_s)
        await_arrival(rig, deadline, should_stop)
        rig.stage.wait()
    if rig.box.latched(axis) is None:
        raise RigError(
            f"The pulse box met no index mark of the {axis} axis between {before_um:.2f} and {behind_um:.2f} um: check "
            "the cable of the mark, and index_um of the axis in the rig's file."
        )
    _require_agreement(rig, axis)


def _require_agreement(rig: Rig, axis: Axis) -> None:
    counted, expected = rig.box.count(axis), stage_count(rig, axis)
    if abs(counted - expected) <= COUNT_TOLERANCE:
        return
    limits = rig.limits.axis(axis)
    raise RigError(
        f"After its index mark the pulse box counts the {axis} axis at {limits.position_um(counted):.2f} um "
        f"({counted} counts), and the stage says {limits.position_um(expected):.2f} um ({expected} counts): home the "
        "stage, or correct index_um of the axis in the rig's file."
    )


# ------------------------------------------------------------------------------------------------- pulse reconciliation


@dataclass(frozen=True, slots=True)
class PairingParameters:
    """Limits of the pairing of images with pulses.

    Parameters
    ----------
    tracked : int
        Number of latest images whose median gives the current clock difference of camera and box.
    fit_from : int
        Smallest number of images for a clock fit; with fewer, the clock of the previous pass is adjusted.
    followed : float
        Largest adjustment of the clock by a few images, as a fraction of the limit for an image.
    at_once : float, pulse periods
        Distance below which an image is assigned to a pulse immediately.
    sharp : float, pulse periods
        Permitted distance of an image from its pulse, in any case: a twentieth of a step in z.
    precise : float, pulse periods
        The same for an image beside edges at the camera that the box did not send: a two-hundredth of a step in z.
    sigmas : float
        Permitted distance of an image from its pulse, in standard deviations of all images of the pass.
    one_off : tuple[float, float], pulse periods
        Distance before the first pulse, or after the last one, of an image that may belong to a pulse of the pass.
    """

    tracked: int = 9
    fit_from: int = 8
    followed: float = 0.25
    at_once: float = 0.25
    sharp: float = 0.05
    precise: float = 0.005
    sigmas: float = 5.0
    one_off: tuple[float, float] = (0.5, 1.5)


PAIRING = PairingParameters()
ALL_PAIRS = 32
"""Largest number of images of which all pairs give the drift; of more, pairs half a pass apart."""
COUNTER_WRAPS = (1 << 8, 1 << 16, 1 << 32)
"""Moduli of common counters of cameras."""
NEAR_WRAP = 0.125
"""Difference from the expected edges, as a fraction of the modulus, below which a counter that falls has wrapped."""


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """The camera's clock relative to that of the pulse box.

    offset_us: camera time minus box time, at the box time at_us; drift: relative excess rate of the camera's clock;
    spread_us: standard deviation of the images about this line.
    """

    offset_us: float
    at_us: float = 0.0
    drift: float = 0.0
    spread_us: float = 0.0

    def image_us(self, pulse: Pulse) -> float:
        """Return the expected device time of a pulse's image."""
        return pulse.time_us + self.offset_us + self.drift * (pulse.time_us - self.at_us)


@dataclass(frozen=True, slots=True)
class Timing:
    """Delay of the camera after a pulse, exposures of the plan, the camera's clock against the box's, pulse period."""

    delay_us: float
    exposures_us: tuple[float, ...]
    clock: DeviceClock
    period_us: float

    def middle_s(self, shot: Shot) -> float:
        """Return the time from the pulse to mid-exposure."""
        return (self.delay_us + self.exposures_us[shot.exposure] / 2) * 1e-6


@dataclass(frozen=True, slots=True)
class MissingFrame:
    """A slot without a frame, with the scale count of its pulse and the reason."""

    shot: Shot
    count: int
    why: str


@dataclass(frozen=True, slots=True)
class Pairing:
    """Pairing of a whole pass.

    holes: slots without a frame, including those whose image proved not to belong to their pulse;
    doubt: reason for distrusting the whole pass, or empty;
    n_images: number of distinct images; n_unexposed: pulses without an image;
    extra_edges: edges counted by the camera that the box did not send; uncounted: pulses that it did not count;
    strays: images that belong to no pulse; clock: that of the pass, for the next one.
    """

    holes: tuple[MissingFrame, ...]
    doubt: str
    n_images: int
    n_unexposed: int
    extra_edges: int
    uncounted: int
    strays: int
    clock: DeviceClock


@dataclass(frozen=True, slots=True)
class _Match:
    pulse: Pulse
    device_time_us: int
    trigger_count: int | None


class Reconciler:
    """Pairs images and pulses of one pass as they arrive, in any order; `close` checks the pass as a whole."""

    def __init__(self, leg: Leg, limits: RigLimits, timing: Timing) -> None:
        self._leg = leg
        self._limits = limits
        self._timing = timing
        self._pulses: list[Pulse] = []
        self._times_us: list[int] = []
        self._waiting: list[CameraImage] = []
        self._matches: dict[int, _Match] = {}
        self._spoilt: set[int] = set()
        self._other_exposure_us: dict[int, float] = {}
        """Reported exposures of images that are not of their slot's exposure, by place in the leg."""
        self._seen: set[tuple[int, int | None]] = set()
        self._rivals = 0
        """Images for slots that already have one."""
        self._off_us: deque[float] = deque(maxlen=PAIRING.tracked)

    @property
    def all_paired(self) -> bool:
        """True if every slot of the leg has its image."""
        return len(self._matches) == len(self._leg.shots)

    def add(self, images: Iterable[CameraImage], pulses: Iterable[Pulse]) -> list[Frame]:
        """Add images and pulses; return the frames identified so far, which `close` confirms or revokes."""
        for pulse in pulses:
            self._pulses.append(pulse)
            self._times_us.append(pulse.time_us)
        waiting, self._waiting = [*self._waiting, *(image for image in images if self._is_new(image))], []
        frames = (self._frame(image) for image in waiting)
        return [frame for frame in frames if frame is not None]

    def close(self) -> Pairing:
        """Return the pairing of the whole pass, once everything has arrived."""
        matches = sorted(self._matches.items(), key=lambda item: item[1].pulse.number)
        clock = self._fitted([match for _, match in matches])
        limit_us = self._limit_us(clock)
        revoked = {
            place: abs(off_us)
            for place, match in matches
            if abs(off_us := match.device_time_us - clock.image_us(match.pulse)) > limit_us
        }
        sure = [match for place, match in matches if place not in revoked]
        extra, uncounted, beside = _counter_steps(sure)
        if len(matches) >= PAIRING.fit_from:
            revoked |= self._off_beside_steps(matches, beside, clock)
        rejected = self._spoilt | (self._other_exposure_us.keys() - self._matches.keys())
        n_images = len(self._matches) + len(rejected) + self._rivals + len(self._waiting)
        return Pairing(
            holes=self._holes(revoked),
            doubt=self._doubt(clock, counter_differs=bool(extra or uncounted), has_counter=_has_counter(sure)),
            n_images=n_images,
            n_unexposed=len(self._pulses) - len(self._matches) - len(rejected),
            extra_edges=extra,
            uncounted=uncounted,
            strays=len(self._waiting) + self._rivals,
            clock=clock,
        )

    def _off_beside_steps(
        self, matches: Sequence[tuple[int, _Match]], beside: set[int], clock: DeviceClock
    ) -> dict[int, float]:
        """Return the images beside a step of the counter that stand out in time: an extra edge may have taken them."""
        limit_us = max(PAIRING.precise * self._timing.period_us, PAIRING.sigmas * clock.spread_us)
        off_us = {
            place: abs(m.device_time_us - clock.image_us(m.pulse)) for place, m in matches if m.pulse.number in beside
        }
        return {place: off for place, off in off_us.items() if off > limit_us}

    def _is_new(self, image: CameraImage) -> bool:
        key = image.device_time_us, image.trigger_count
        known = key in self._seen
        self._seen.add(key)
        return not known

    def _frame(self, image: CameraImage) -> Frame | None:
        pulse = self._pulse_of(image)
        if pulse is None:
            self._waiting.append(image)
            return None
        place = self._place(pulse)
        if place is None or place in self._matches:
            self._rivals += 1
            return None
        if image.status is not FrameStatus.OK:
            self._spoilt.add(place)
            return None
        if self._is_of_other_exposure(image, place):
            return None
        self._spoilt.discard(place)
        self._matches[place] = _Match(pulse, image.device_time_us, image.trigger_count)
        self._off_us.append(image.device_time_us - self._timing.clock.image_us(pulse))
        return frame_of(image, pulse, self._leg, self._leg.shots[place], self._limits, self._timing)

    def _is_of_other_exposure(self, image: CameraImage, place: int) -> bool:
        """Return whether the camera reports another exposure than the slot's, as after an ignored trigger."""
        planned_us, reported_us = self._timing.exposures_us[self._leg.shots[place].exposure], image.exposure_us
        if reported_us is None or len(self._timing.exposures_us) == 1:
            return False
        nearest_us = min(self._timing.exposures_us, key=lambda us: abs(us - reported_us))
        if nearest_us == planned_us:
            return False
        self._other_exposure_us[place] = reported_us
        return True

    def _pulse_of(self, image: CameraImage) -> Pulse | None:
        """Return the pulse at the time of an image, as far as known so far."""
        if not self._pulses:
            return None
        clock = self._timing.clock
        off_us = median(self._off_us) if self._off_us else 0.0
        shift_us = clock.image_us(self._pulses[-1]) - self._pulses[-1].time_us + off_us
        index = bisect_left(self._times_us, image.device_time_us - shift_us)
        near = self._pulses[max(0, index - 1) : index + 1]
        nearest = min(near, key=lambda p: abs(p.time_us + shift_us - image.device_time_us))
        away_us = abs(nearest.time_us + shift_us - image.device_time_us)
        return nearest if away_us < PAIRING.at_once * self._timing.period_us else None

    def _fitted(self, matches: Sequence[_Match]) -> DeviceClock:
        """Return the camera's clock fitted to the images of this pass, robust against outliers."""
        before = self._timing.clock
        if not matches:
            return before
        times_us = np.array([match.pulse.time_us for match in matches], np.float64)
        off_us = np.array([match.device_time_us - match.pulse.time_us for match in matches], np.float64)
        at_us = float(times_us.mean())
        if len(matches) < PAIRING.fit_from:
            # Few images cannot show which of them is the outlier: they change the clock estimate only a little.
            carried_us = before.offset_us + before.drift * (at_us - before.at_us)
            step_us = self._limit_us(before) * PAIRING.followed
            moved_us = min(max(float(np.median(off_us)) - carried_us, -step_us), step_us)
            return DeviceClock(carried_us + moved_us, at_us, before.drift, before.spread_us)
        drift = _slope(times_us, off_us)
        left_us = off_us - drift * (times_us - at_us)
        offset_us = float(np.median(left_us))
        spread_us = MAD_TO_SIGMA * float(np.median(np.abs(left_us - offset_us)))
        return DeviceClock(offset_us, at_us, drift, spread_us)

    def _limit_us(self, clock: DeviceClock) -> float:
        """Return the permitted time difference between an image and its pulse."""
        return max(PAIRING.sharp * self._timing.period_us, PAIRING.sigmas * clock.spread_us)

    def _doubt(self, clock: DeviceClock, *, counter_differs: bool, has_counter: bool) -> str:
        period_us = self._timing.period_us
        if self._waiting and not self._matches:
            return f"{len(self._waiting)} images came, and none of them at the time of a pulse"
        if self._shifted(clock):
            return "images came before the first or after the last pulse where others lack theirs"
        if PAIRING.sigmas * clock.spread_us > period_us / 2 and (counter_differs or not has_counter):
            return (
                f"the times of the images scatter by {clock.spread_us / 1000:.1f} ms about the pulses, "
                f"{period_us / 1000:.1f} ms apart, and no counter tells them apart"
            )
        return ""

    def _shifted(self, clock: DeviceClock) -> bool:
        """Return whether all images may be off by one pulse: one is just outside the train, whose far end is empty."""
        if not self._pulses or not self._waiting:
            return False
        first, last, period_us = self._pulses[0], self._pulses[-1], self._timing.period_us
        taken = {match.pulse.number for match in self._matches.values()}
        low, high = PAIRING.one_off
        before = any(low < (clock.image_us(first) - i.device_time_us) / period_us < high for i in self._waiting)
        after = any(low < (i.device_time_us - clock.image_us(last)) / period_us < high for i in self._waiting)
        return (before and last.number not in taken) or (after and first.number not in taken)

    def _holes(self, revoked: dict[int, float]) -> tuple[MissingFrame, ...]:
        """Return the slots without a valid frame."""
        sent = {self._place(pulse) for pulse in self._pulses}
        return tuple(
            MissingFrame(shot, self._count(i), self._why(i, sent, revoked.get(i)))
            for i, shot in enumerate(self._leg.shots)
            if i not in self._matches or i in revoked
        )

    def _place(self, pulse: Pulse) -> int | None:
        """Return the index of a pulse in the leg by its scale count; None if it is outside the train."""
        train = self._leg.train
        place = round(train.direction * (pulse.count - train.first_count) / train.counts_per_frame)
        return place if 0 <= place < train.n_frames else None

    def _count(self, place: int) -> int:
        train = self._leg.train
        return train.first_count + train.direction * train.counts_per_frame * place

    def _why(self, place: int, sent: set[int | None], off_us: float | None) -> str:
        if off_us is not None:
            return f"its image was taken {off_us / 1000:.2f} ms off its pulse"
        if place in self._spoilt:
            return "its image came incomplete"
        if place in self._other_exposure_us:
            planned_us = self._timing.exposures_us[self._leg.shots[place].exposure]
            return f"its image was exposed for {self._other_exposure_us[place]:g} us instead of {planned_us:g} us"
        return "no image came for its pulse" if place in sent else "the pulse box sent no pulse"


def _slope(times_us: np.ndarray, off_us: np.ndarray) -> float:
    """Return the drift: the median slope of pairs of images, robust against outliers (Theil and Sen)."""
    n = len(times_us)
    if n <= ALL_PAIRS:
        first, second = np.triu_indices(n, 1)
    else:
        first = np.arange(n // 2)
        second = first + n - n // 2
    run_us = times_us[second] - times_us[first]
    far = run_us > 0
    return float(np.median((off_us[second] - off_us[first])[far] / run_us[far])) if far.any() else 0.0


def _has_counter(matches: Sequence[_Match]) -> bool:
    return any(match.trigger_count is not None for match in matches)


def _counter_steps(matches: Sequence[_Match]) -> tuple[int, int, set[int]]:
    """Return how many edges the camera counted too many, and too few, relative to the pulses at the same times.

    Also the numbers of the pulses before and after them.

    A counter that falls has wrapped, or was reset: then the edges in between are unknown.
    """
    extra = uncounted = 0
    beside: set[int] = set()
    counted = [(m.pulse.number, m.trigger_count) for m in matches if m.trigger_count is not None]
    most = max((count for _, count in counted), default=0)
    wraps_at = next((wrap for wrap in COUNTER_WRAPS if wrap > most), 0)
    for (number, count), (next_number, next_count) in zip([(-1, -1), *counted], counted, strict=False):
        edges = next_count - count
        if edges <= 0:
            edges += wraps_at
        step = edges - (next_number - number)
        if next_count > count or abs(step) < wraps_at * NEAR_WRAP:
            extra += max(0, step)
            uncounted += max(0, -step)
            beside |= {number, next_number} if step else set()
    return extra, uncounted, beside


def frame_of(image: CameraImage, pulse: Pulse, leg: Leg, shot: Shot, limits: RigLimits, timing: Timing) -> Frame:
    """Return the frame of a pulse: the moving axis at the pulse's scale count, extrapolated to mid-exposure."""
    train = leg.train
    moved_um = train.direction * leg.speed_um_s * timing.middle_s(shot)
    at_um = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um}
    at_um[train.axis] = limits.axis(train.axis).position_um(pulse.count) + moved_um
    return Frame(
        shot=shot,
        pulse_count=pulse.count,
        x_um=at_um["x"],
        y_um=at_um["y"],
        z_um=at_um["z"],
        exposure_us=timing.exposures_us[shot.exposure],
        device_time_us=image.device_time_us,
        status=image.status,
        image=image.image,
    )
