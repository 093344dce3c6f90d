"""Checks of the camera, triggered by the pulse box on command while the stage stands."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

import numpy as np

from wafer_viewer.acquire.conformance.bench import (
    CheckOutcome,
    CheckRun,
    ConformanceBench,
    ConformanceCheck,
    DeviceRole,
    Shooting,
    figure,
    outcome,
)
from wafer_viewer.model.acquisition.devices import CameraImage
from wafer_viewer.model.acquisition.focus_stack import FrameStatus, Image
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError

N_FRAMES = 20
"""Frames on command."""
N_SMALL = 5
"""Frames on command where a few will do."""
LONG_US, LONG_FRACTION = 50_000.0, 0.5
"""Long exposure in us, and the largest fraction of the longest exposure."""
DELAY_TOLERANCE = 0.25
"""Permitted difference of the delay of an image from that of its exposure, as a fraction of the exposure."""
FACTOR = 2.0
"""Factor from one exposure to the next in search for light."""
BRIGHT, DARK = 0.25, 0.02
"""Mean grey as fractions of white: of the brightest frame at least, where there is light; and of none."""
GROWTH = (1.4, 2.8)
"""Permitted ratio of the increments of mean grey over exposures of 1/4, 1/2 and 1: 2 for a linear camera."""
CUT_FRACTION = 0.125
"""Rows of one value at the end of a frame, as a fraction, from which it counts as cut off."""


def frames(bench: ConformanceBench) -> CheckOutcome:
    """Trigger frames and count what arrives."""
    shooting = bench.shoot(N_FRAMES, bench.exposure_us)
    return outcome(
        (
            figure("triggers", shooting.summary.emitted, "1"),
            figure("frames", len(shooting.images), "1"),
            figure("exposure signals", shooting.summary.exposures, "1"),
        ),
        _number_fault(shooting),
    )


def times(bench: ConformanceBench) -> CheckOutcome:
    """Follow trigger counter and device time of frames."""
    images = [image for image in bench.shoot(N_FRAMES, bench.exposure_us).images if _is_complete(image)]
    if len(images) < 2:
        return outcome((), f"{len(images)} complete frames arrived for {N_FRAMES} triggers.")
    steps_us = [b.device_time_us - a.device_time_us for a, b in pairwise(images)]
    counts = [image.trigger_count for image in images if image.trigger_count is not None]
    wraps = sum(b < a for a, b in pairwise(counts))
    return outcome(
        (
            figure("shortest interval", min(steps_us), "us"),
            figure("counted frames", len(counts), "1"),
            figure("wraps of the counter", wraps, "1"),
        ),
        f"The device time went back by {-min(steps_us)} us from one frame to the next." if min(steps_us) <= 0 else "",
        _counter_fault(counts),
    )


def whole(bench: ConformanceBench) -> CheckOutcome:
    """Look at size, bit depth and completeness of frames."""
    images, limits = bench.shoot(N_SMALL, bench.exposure_us).images, bench.rig.limits.camera
    complete = [image.image for image in images if image.status is FrameStatus.OK and image.image is not None]
    marked = sum(image.status is not FrameStatus.OK for image in images)
    empty = sum(image.status is FrameStatus.OK and image.image is None for image in images)
    return outcome(
        (
            figure("whole frames", len(complete), "1"),
            figure("marked incomplete", marked, "1"),
            figure("rows", limits.rows, "px"),
            figure("columns", limits.cols, "px"),
        ),
        f"{empty} frames have no image and are not marked as incomplete." if empty else "",
        _form_fault(complete, limits),
        _cut_fault(complete),
        "No frame was complete." if not complete else "",
    )


def exposure_range(bench: ConformanceBench) -> CheckOutcome:
    """Ask for exposures outside of the range."""
    limits, accepted = bench.rig.limits.camera, list[float]()
    outside_us = (0.0, -1.0, limits.exposure_min_us / 2, limits.exposure_max_us * 2)
    for exposure_us in outside_us:
        try:
            bench.rig.camera.start(exposure_us)
        except RigError:
            continue
        bench.rig.camera.stop()
        accepted.append(exposure_us)
    words = " and ".join(f"{exposure_us:g} us" for exposure_us in accepted)
    return outcome(
        (
            figure("shortest exposure", limits.exposure_min_us, "us"),
            figure("longest exposure", limits.exposure_max_us, "us"),
        ),
        f"The camera accepted an exposure of {words}, outside of its range." if accepted else "",
    )


def exposure_time(bench: ConformanceBench) -> CheckOutcome:
    """Compare the delays of images of a short and a long exposure."""
    limits = bench.rig.limits.camera
    short_us = bench.exposure_us
    long_us = min(LONG_US, LONG_FRACTION * limits.exposure_max_us)
    if long_us < FACTOR * short_us:
        return CheckOutcome(skipped=f"The longest exposure, {limits.exposure_max_us:g} us, is too short to tell apart.")
    delays = [_delay_us(bench.shoot(N_SMALL, exposure_us)) for exposure_us in (short_us, long_us)]
    if None in delays:
        return outcome((), "No frame arrived at one of the exposures.")
    short_delay_us, long_delay_us = (delay or 0.0 for delay in delays)
    longer_us, wanted_us = long_delay_us - short_delay_us, long_us - short_us
    return outcome(
        (
            figure("exposures apart by", wanted_us, "us"),
            figure("images apart by", longer_us, "us"),
        ),
        f"An exposure longer by {wanted_us:.0f} us delayed the image by {longer_us:.0f} us: the camera does not expose "
        "for the time that it was given."
        if abs(longer_us - wanted_us) > DELAY_TOLERANCE * wanted_us
        else "",
    )


def brightness(bench: ConformanceBench) -> CheckOutcome:
    """Compare the mean grey of three exposures, the longest one found by its brightness."""
    limits, white = bench.rig.limits.camera, 2.0**bench.rig.limits.camera.bits - 1
    exposure_us = FACTOR**2 * limits.exposure_min_us
    grey = _grey(bench, exposure_us)
    while grey < BRIGHT * white and exposure_us * FACTOR <= min(LONG_US, limits.exposure_max_us):
        exposure_us *= FACTOR
        grey = _grey(bench, exposure_us)
    greys = [_grey(bench, exposure_us / FACTOR**2), _grey(bench, exposure_us / FACTOR), grey]
    figures = [
        figure(f"mean grey at {us:g} us", value, "counts")
        for us, value in zip((exposure_us / FACTOR**2, exposure_us / FACTOR, exposure_us), greys, strict=True)
    ]
    if greys[2] < DARK * white:
        return CheckOutcome(tuple(figures), skipped="There is no light: switch it on and run it again.")
    low, high = greys[1] - greys[0], greys[2] - greys[1]
    ratio = high / low if low > 0 else 0.0
    figures.append(figure("ratio of the increments", ratio, "1"))
    return outcome(
        figures,
        f"The mean grey went from {greys[0]:.1f} to {greys[1]:.1f} and {greys[2]:.1f} counts as the exposure doubled "
        "twice: it does not follow the exposure. Check that gain and exposure are not automatic and the light steady."
        if not GROWTH[0] <= ratio <= GROWTH[1]
        else "",
    )


def exposure_signal(bench: ConformanceBench) -> CheckOutcome:
    """Compare exposures that the box saw with frames that arrived."""
    shooting = bench.shoot(N_SMALL, bench.exposure_us)
    seen, n = shooting.summary.exposures, len(shooting.images)
    return outcome(
        (figure("exposure signals", seen, "1"), figure("frames", n, "1")),
        f"The box saw {seen} exposures for {n} frames: connect the exposure output of the camera to the box."
        if seen != n
        else "",
    )


def _number_fault(shooting: Shooting) -> str:
    n, found = shooting.summary.emitted, len(shooting.images)
    lost = [i for i, frame in enumerate(shooting.frames) if frame.image is None]
    if found > n:
        return f"{found} frames arrived for {n} triggers: the camera saw an edge that the box did not send."
    if found < n:
        which = f", the first one at trigger {lost[0]}" if lost else ""
        return f"{found} frames arrived for {n} triggers{which}: {n - found} were dropped."
    return ""


def _counter_fault(counts: list[int]) -> str:
    if counts and counts[0] != 0:
        return f"The trigger counter began at {counts[0]} instead of 0."
    steps = [(a, b) for a, b in pairwise(counts) if b > a + 1 or b == a]
    if steps:
        a, b = steps[0]
        return (
            f"The trigger counter went from {a} to {b} at one trigger: the camera saw an edge that the box did not "
            "send."
        )
    return ""


def _form_fault(images: list[Image], limits: CameraLimits) -> str:
    depth = np.dtype(np.uint8 if limits.bits == 8 else np.uint16)
    odd = [image for image in images if image.shape != (limits.rows, limits.cols) or image.dtype != depth]
    if not odd:
        return ""
    rows, cols = odd[0].shape
    return (
        f"A frame has {rows} rows, {cols} columns of {odd[0].dtype} instead of {limits.rows}, {limits.cols} of {depth}."
    )


def _cut_fault(images: list[Image]) -> str:
    """Return a sentence if a frame ends in rows of one value and another one does not."""
    ends = [_empty_rows(image) for image in images]
    if not ends or max(ends) < CUT_FRACTION * len(images[0]) or min(ends) == max(ends):
        return ""
    which = ends.index(max(ends))
    return f"Frame {which} ends in {ends[which]} rows of one value and is not marked as incomplete."


def _empty_rows(image: Image) -> int:
    """Return the number of rows at the end with the value of the last pixel alone; 0 for a frame of one value."""
    same = (image == image[-1, -1]).all(axis=1)
    return int(np.argmin(same[::-1]))


def _delay_us(shooting: Shooting) -> float | None:
    delays = [frame.arrived_s - frame.fired_s for frame in shooting.frames if frame.image is not None]
    return median(delays) * 1e6 if delays else None


def _grey(bench: ConformanceBench, exposure_us: float) -> float:
    """Return the mean grey of a frame. Raises RigError if none arrives."""
    images = [image for image in bench.shoot(2, exposure_us).images if _is_complete(image)]
    if not images:
        raise RigError(f"No complete frame arrived at an exposure of {exposure_us:g} us.")
    image = images[-1].image
    return 0.0 if image is None else float(image.mean())


def _is_complete(image: CameraImage) -> bool:
    return image.status is FrameStatus.OK and image.image is not None


TRIGGERED: tuple[DeviceRole, ...] = ("camera", "pulse box")


def _check(
    name: str, title: str, demand: str, run: CheckRun, roles: tuple[DeviceRole, ...] = TRIGGERED
) -> ConformanceCheck:
    return ConformanceCheck(name, title, "camera", roles, moves=False, demand=demand, run=run)


CHECKS = (
    _check(
        "camera_frames",
        "Frames for triggers",
        f"{N_FRAMES} triggers give {N_FRAMES} frames, and nothing more arrives after them.",
        frames,
    ),
    _check(
        "camera_times",
        "Counter and device time",
        "The device time rises from frame to frame; a trigger counter begins at 0 and rises by 1, or wraps around.",
        times,
    ),
    _check(
        "camera_whole_frames",
        "Whole frames",
        "Every frame has the size and bit depth of the limits, or is marked as incomplete.",
        whole,
    ),
    _check(
        "camera_exposure_range",
        "Exposure out of range",
        "An exposure out of range is refused.",
        exposure_range,
        ("camera",),
    ),
    _check(
        "camera_exposure_time",
        "Exposure time",
        f"A longer exposure delays its image by as much, within {DELAY_TOLERANCE:.0%}.",
        exposure_time,
    ),
    _check(
        "camera_brightness",
        "Brightness",
        "Where there is light, the mean grey follows the exposure: doubled twice, its increments have a ratio between "
        f"{GROWTH[0]:g} and {GROWTH[1]:g}.",
        brightness,
    ),
    _check(
        "camera_exposure_signal",
        "Exposure signal",
        f"The box sees as many exposures as frames arrive, for {N_SMALL} triggers.",
        exposure_signal,
    ),
)
"""Demands on the camera."""
