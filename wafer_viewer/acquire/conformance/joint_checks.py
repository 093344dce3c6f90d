"""Checks of devices together: slips and scales, frames at the full rate, latency of images, and clocks."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

import numpy as np

from wafer_viewer.acquire.conformance.bench import (
    CheckOutcome,
    ConformanceBench,
    ConformanceCheck,
    DeviceRole,
    TravelWindow,
    figure,
    outcome,
)
from wafer_viewer.acquire.motion import device_errors
from wafer_viewer.acquire.pass_runner import COUNT_TOLERANCE, image_wait_s
from wafer_viewer.acquire.pulse_reconciliation import PAIRING
from wafer_viewer.model.acquisition.devices import CameraImage
from wafer_viewer.model.acquisition.plan import Axis, PulseTrain
from wafer_viewer.model.errors import RigError

N_TURNS = 20
"""Motions there and back of the slip test on every axis."""
SCALE_FRACTION = 0.002
"""Permitted difference of counts and position, as a fraction of the motion: as in doctor."""
N_RATE = 40
"""Frames at the full rate."""
RATE_ROOM = 0.5
"""Fraction of the range of z in which these frames are taken."""
N_LATENCY = 20
"""Frames of which the latency is measured."""
N_CLOCK, CLOCK_SPACING_S = 21, 0.5
"""Frames by which the clocks are compared, and the time between them in s: 10 s in all."""
DRIFT_PPM = 200.0
"""Permitted drift of the camera's clock against the box's in parts per million: two quartzes of 100 each."""
PPM = 1e6
"""Parts per million in one."""


def slips(bench: ConformanceBench) -> CheckOutcome:
    """Move every axis there and back at the fastest speed and compare count and position at each end."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        errors, quadrature = _turns(bench, window)
        off = [error - errors[i % 2] for i, error in enumerate(errors)]
        drift = max(map(abs, off))
        n_slips = sum(abs(after - before) > COUNT_TOLERANCE for before, after in pairwise(off))
        figures += [
            figure(f"{axis} motions", 2 * N_TURNS, "1"),
            figure(f"{axis} distance", 2 * N_TURNS * window.length_um / 1000, "mm"),
            figure(f"{axis} speed", window.speed_um_s, "um/s"),
            figure(f"{axis} slips", n_slips, "1"),
            figure(f"{axis} count off by", drift, "counts"),
        ]
        if drift > COUNT_TOLERANCE:
            faults.append(
                f"The box's count of the {axis} axis left the stage's position by {drift} counts "
                f"({window.limits.position_um(drift):.2f} um) in {2 * N_TURNS} motions, by {n_slips} slips: check "
                "the scale, its cable and its signal at this speed."
            )
        if quadrature:
            faults.append(f"The box reports {quadrature} quadrature errors on the {axis} scale.")
    return outcome(figures, *faults)


def scales(bench: ConformanceBench) -> CheckOutcome:
    """Compare what the box counted over the range of every axis with what the stage moved."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        limits = window.limits
        bench.go(axis, window.low_um)
        bench.reference()
        begin_um, before = bench.position_um(axis), bench.rig.box.count(axis)
        bench.sweep(axis, window.high_um, window.speed_um_s)
        moved_um, counted = bench.position_um(axis) - begin_um, bench.rig.box.count(axis) - before
        expected = moved_um * limits.counts_per_um
        found_per_um = counted / moved_um if moved_um else 0.0
        figures += [
            figure(f"{axis} counted", counted, "counts"),
            figure(f"{axis} expected", expected, "counts"),
            figure(f"{axis} scale", found_per_um, "counts/um"),
        ]
        if abs(counted - expected) > max(COUNT_TOLERANCE, SCALE_FRACTION * abs(expected)):
            faults.append(
                f"counts_per_um of the {axis} axis is {limits.counts_per_um:g} in the rig's file and "
                f"{found_per_um:.4f} by this motion: wafer-viewer doctor --move says what to mend."
            )
    return outcome(figures, *faults)


def full_rate(bench: ConformanceBench) -> CheckOutcome:
    """Take frames at the highest rate in a pass of z."""
    rig, window = bench.rig, bench.windows["z"]
    exposure_us = rig.limits.camera.exposure_min_us
    train, speed = _train_at_rate(window, rig.limits.camera.period_s(exposure_us))
    period_us = window.limits.position_um(train.counts_per_frame) / speed * 1e6
    images: list[CameraImage] = []

    def take(timeout_s: float) -> bool:
        with device_errors("camera"):
            image = rig.camera.next_image(timeout_s)
        images.extend([] if image is None else [image])
        return image is not None

    def look() -> None:
        while take(0.0):
            pass

    bench.go("z", window.low_um)
    bench.reference()
    with device_errors("camera"):
        rig.camera.start(exposure_us)
    rig.box.arm(train, min_gap_us=rig.limits.camera.period_s(exposure_us) * 1e6)
    bench.sweep("z", window.high_um, speed, look)
    summary = rig.box.disarm()
    while len(images) < 2 * N_RATE and take(image_wait_s(rig, exposure_us)):
        pass
    with device_errors("camera"):
        rig.camera.stop()
    return outcome(
        (
            figure("rate", 1e6 / period_us, "frames/s"),
            figure("exposure", exposure_us, "us"),
            figure("triggers", summary.emitted, "1"),
            figure("frames", len(images), "1"),
        ),
        f"{summary.emitted} of {N_RATE} pulses came, {summary.suppressed} came too soon: the speed of z is not even."
        if summary.emitted != N_RATE
        else "",
        f"{len(images)} frames arrived for {summary.emitted} triggers at {1e6 / period_us:.1f} frames/s: lower "
        "frame_rate_hz of the camera, or raise its readout_us."
        if len(images) != summary.emitted
        else "",
    )


def latency(bench: ConformanceBench) -> CheckOutcome:
    """Time images from the command to the arrival."""
    exposure_us = bench.exposure_us
    shooting = bench.shoot(N_LATENCY, exposure_us)
    took_s = [frame.arrived_s - frame.fired_s for frame in shooting.frames if frame.image is not None]
    limit_s = image_wait_s(bench.rig, exposure_us)
    lost = N_LATENCY - len(took_s)
    if not took_s:
        return outcome((), f"No image arrived within {limit_s:.2f} s of its trigger.")
    return outcome(
        (
            figure("median", median(took_s) * 1e3, "ms"),
            figure("longest", max(took_s) * 1e3, "ms"),
            figure("allowed", limit_s * 1e3, "ms"),
        ),
        f"{lost} images did not arrive within {limit_s:.2f} s of their triggers." if lost else "",
    )


def clocks(bench: ConformanceBench) -> CheckOutcome:
    """Compare the device times of frames with the times of their pulses."""
    shooting = bench.shoot(N_CLOCK, bench.exposure_us, CLOCK_SPACING_S)
    images = shooting.images
    if len(images) != len(shooting.pulses):
        return outcome(
            (), f"{len(images)} images arrived for {len(shooting.pulses)} pulses: the clocks cannot be compared."
        )
    box_us = np.array([pulse.time_us for pulse in shooting.pulses], np.float64)
    camera_us = np.array([image.device_time_us for image in images], np.float64)
    box_us, camera_us = box_us - box_us[0], camera_us - camera_us[0]
    slope, offset_us = np.polyfit(box_us, camera_us, 1)
    drift_ppm = (float(slope) - 1) * PPM
    spread_us = float(np.std(camera_us - slope * box_us - offset_us))
    limit_us = PAIRING.sharp * bench.rig.limits.camera.period_s(bench.exposure_us) * 1e6
    return outcome(
        (
            figure("drift", drift_ppm, "ppm"),
            figure("spread", spread_us, "us"),
            figure("allowed spread", limit_us, "us"),
            figure("time compared", box_us[-1] * 1e-6, "s"),
        ),
        f"The clock of the camera runs {drift_ppm:+.0f} ppm off that of the box." if abs(drift_ppm) > DRIFT_PPM else "",
        f"The device times scatter by {spread_us:.0f} us round those of the pulses, where {limit_us:.0f} us are "
        "allowed: images at the full rate may not find their pulses."
        if spread_us > limit_us
        else "",
    )


def _turns(bench: ConformanceBench, window: TravelWindow) -> tuple[list[int], int]:
    """Return count minus position at each end of every motion, in counts, and the quadrature errors."""
    axis, box = window.axis, bench.rig.box
    bench.go(axis, window.low_um)
    bench.reference()
    bench.arm_on_command(axis, 1)
    errors = [_count_error(bench, axis)]
    for _ in range(N_TURNS):
        for to_um in (window.high_um, window.low_um):
            bench.sweep(axis, to_um, window.speed_um_s)
            errors.append(_count_error(bench, axis))
    return errors, box.disarm().quadrature_errors


def _count_error(bench: ConformanceBench, axis: Axis) -> int:
    return bench.rig.box.count(axis) - bench.rig.limits.axis(axis).counts(bench.position_um(axis))


def _train_at_rate(window: TravelWindow, period_s: float) -> tuple[PulseTrain, float]:
    """Return a train in the middle of a range and the speed at which its pulses have a period."""
    limits = window.limits
    speed_um_s = min(RATE_ROOM * window.length_um / (N_RATE * period_s), window.speed_um_s)
    pitch = limits.counts(speed_um_s * period_s)
    if pitch < 1:
        raise RigError(
            f"The range of z, {window.length_um:g} um, is too short for {N_RATE} frames at {1 / period_s:.1f} "
            "frames/s: give a longer one with --z-um."
        )
    speed_um_s = limits.position_um(pitch) / period_s
    first_um = window.at_um(0.5) - limits.position_um(pitch * (N_RATE - 1)) / 2
    train = PulseTrain(
        axis="z", first_count=limits.counts(first_um), counts_per_frame=pitch, n_frames=N_RATE, direction=1
    )
    return train, speed_um_s


BOX_AND_STAGE: tuple[DeviceRole, ...] = ("pulse box", "stage")
BOX_AND_CAMERA: tuple[DeviceRole, ...] = ("pulse box", "camera")
ALL: tuple[DeviceRole, ...] = ("pulse box", "stage", "camera")
AT_REST = (
    ConformanceCheck(
        "latency",
        "From trigger to image",
        "together",
        BOX_AND_CAMERA,
        False,
        "Every image arrives within the time that a scan waits for it: a period, exposure, readout and 0.25 s.",
        latency,
    ),
    ConformanceCheck(
        "clocks",
        "Clocks of camera and box",
        "together",
        BOX_AND_CAMERA,
        False,
        f"The camera's clock drifts by {DRIFT_PPM:g} ppm at most against the box's, and scatters by a twentieth of the "
        "shortest period at most.",
        clocks,
    ),
)
"""Demands on devices together while the stage stands."""
IN_MOTION = (
    ConformanceCheck(
        "scales",
        "Counts and positions",
        "together",
        BOX_AND_STAGE,
        True,
        f"Over the range of each axis the box counts what the stage moved, within {COUNT_TOLERANCE} counts or "
        f"{SCALE_FRACTION:.1%}.",
        scales,
    ),
    ConformanceCheck(
        "slips",
        "Slip test",
        "together",
        BOX_AND_STAGE,
        True,
        f"Every axis makes {2 * N_TURNS} motions there and back at the fastest speed of a pass. After each the box's "
        f"count is where it was at that end before, within {COUNT_TOLERANCE} counts, without quadrature errors.",
        slips,
    ),
    ConformanceCheck(
        "full_rate",
        "Frames at the full rate",
        "together",
        ALL,
        True,
        f"A pass of z with {N_RATE} pulses at the highest frame rate gives {N_RATE} frames.",
        full_rate,
    ),
)
"""Demands on devices together that need motion."""
