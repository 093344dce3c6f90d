"""Places, focus and sweeps that the calibration procedures share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.auto_exposure import exposure_at
from wafer_viewer.acquire.commanded_frames import TakeFrame, frames_at_places
from wafer_viewer.acquire.motion import device_errors, move
from wafer_viewer.acquire.pass_runner import PassSettings, device_clock, rig_at_rest, run_pass
from wafer_viewer.acquire.pulse_reconciliation import DeviceClock, reference_axes
from wafer_viewer.calibrate.trigger_delay import sharpness
from wafer_viewer.model.acquisition.characteristics import FOCUS_RANGE_UM
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.focus_stack import Frame, Image
from wafer_viewer.model.acquisition.plan import Leg, PulseTrain, Shot
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.progress import ShouldStop

FOCUS_STEP = 0.5
"""Step of the search for the focus, in depths of field."""
PASS_TRIES = 3
"""Attempts at a sweep with doubtful frames."""
LEAST_PEAK = 1.1
"""Smallest ratio of the highest to the lowest sharpness over a range that holds the focus."""
RATE = 0.8
"""Frame rate of a sweep, as a fraction of the camera's fastest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSite:
    """Place of a calibration in stage um, None for where the stage stands.

    z_range_um: range about z in which the focus is searched; exposure_us: None for an automatic exposure.
    """

    x_um: float | None = None
    y_um: float | None = None
    z_um: float | None = None
    z_range_um: float = FOCUS_RANGE_UM
    exposure_us: float | None = None


@dataclass(frozen=True, slots=True)
class FocusedSite:
    """Place in focus, or in the middle of a range that holds the focus, with its exposure."""

    x_um: float
    y_um: float
    z_um: float
    exposure_us: float


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Frames of one sweep along z: z_um, rising, and the images in this order."""

    z_um: NDArray[np.float64]
    images: list[Image]


def focused_site(rig: Rig, site: CalibrationSite, should_stop: ShouldStop) -> FocusedSite:
    """Move to a place, and find its exposure and its focus."""
    at = exposed_site(rig, site, should_stop)
    with frames_at_places(rig, at.exposure_us, should_stop) as take:
        focus_um = focus_at(rig, take, at.x_um, at.y_um, at.z_um, site.z_range_um)
    return replace(at, z_um=focus_um)


def exposed_site(rig: Rig, site: CalibrationSite, should_stop: ShouldStop) -> FocusedSite:
    """Move to a place, and find its exposure over the range about its z."""
    here = rig.stage.position()
    x_um, y_um, z_um = (
        now if wish is None else wish
        for now, wish in ((here.x_um, site.x_um), (here.y_um, site.y_um), (here.z_um, site.z_um))
    )
    with device_errors("stage"):
        move(rig, {"x": x_um, "y": y_um}, should_stop)
    exposure_us = site.exposure_us
    if exposure_us is None:
        exposure_us = exposure_at(rig, x_um, y_um, focus_positions_um(rig, z_um, site.z_range_um), should_stop)
    return FocusedSite(x_um, y_um, z_um, exposure_us)


def focus_positions_um(rig: Rig, z_um: float, z_range_um: float) -> list[float]:
    """Return the positions of a search for the focus, within the range of the axis."""
    n_steps = max(4, round(z_range_um / (FOCUS_STEP * rig.limits.depth_of_field_um)))
    low, high = max(rig.limits.z.low_um, z_um - z_range_um / 2), min(rig.limits.z.high_um, z_um + z_range_um / 2)
    return [float(z) for z in np.linspace(low, high, n_steps + 1)]


def focus_at(rig: Rig, take: TakeFrame, x_um: float, y_um: float, z_um: float, z_range_um: float) -> float:
    """Return the z in um at which a place is sharpest. Raises RigError if that is not within the range."""
    positions_um = focus_positions_um(rig, z_um, z_range_um)
    return _peak_position_um(positions_um, [sharpness(take(x_um, y_um, z)) for z in positions_um])


def _peak_position_um(z_um: Sequence[float], sharpness: Sequence[float]) -> float:
    """Return the equidistant position of the highest sharpness, by a parabola through the logarithms about it."""
    best = int(np.argmax(sharpness))
    if best in (0, len(sharpness) - 1) or sharpness[best] < LEAST_PEAK * min(sharpness):
        raise RigError(
            f"The focus is not between {min(z_um):.1f} and {max(z_um):.1f} um: move the stage nearer to it, or search "
            "over a longer range."
        )
    below, top, above = np.log(np.maximum(sharpness[best - 1 : best + 2], 1e-30))
    curvature = below - 2 * top + above
    part = 0.0 if curvature >= 0 else float((below - above) / (2 * curvature))
    return float(z_um[best]) + part * float(z_um[1] - z_um[0])


def sweep_speed_um_s(rig: Rig, spacing_um: float, exposure_us: float) -> float:
    """Return the speed of a sweep with a frame at every spacing."""
    return min(RATE * spacing_um / rig.limits.camera.period_s(exposure_us), rig.limits.pass_speed_um_s("z"))


def take_sweep(
    rig: Rig,
    site: FocusedSite,
    z_um: tuple[float, float],
    step_um: float,
    delay_us: float,
    should_stop: ShouldStop,
    direction: Literal[-1, 1] = 1,
    interleaved: int = 1,
) -> tuple[Sweep, float]:
    """Take frames about every step over a range of z in motion; return them and the speed in um/s.

    interleaved: number of passes that share the frames, each with every n-th of them: the speed is as much higher.
    """
    axis = rig.limits.z
    step, low = max(1, round(step_um * axis.counts_per_um)), axis.counts(z_um[0])
    n_frames = (axis.counts(z_um[1]) - low) // step + 1
    speed_um_s = sweep_speed_um_s(rig, axis.position_um(step * interleaved), site.exposure_us)
    frames: list[Frame] = []
    with rig_at_rest(rig):
        with device_errors("stage"):
            move(rig, {"x": site.x_um, "y": site.y_um}, should_stop)
        reference_axes(rig)
        clock = device_clock(rig, site.exposure_us)
        for part in range(interleaved):
            counts = range(low + part * step, low + n_frames * step, interleaved * step)
            leg = _leg(rig, site, counts, direction, speed_um_s)
            frames += _pass_frames(rig, leg, site.exposure_us, clock, delay_us, should_stop)
    frames.sort(key=lambda frame: frame.z_um)
    images = [frame.image for frame in frames if frame.image is not None]
    return Sweep(np.array([frame.z_um for frame in frames if frame.image is not None]), images), speed_um_s


def _leg(rig: Rig, site: FocusedSite, counts: range, direction: Literal[-1, 1], speed_um_s: float) -> Leg:
    ordered = counts if direction > 0 else counts[::-1]
    train = PulseTrain(
        axis="z", first_count=ordered[0], counts_per_frame=counts.step, n_frames=len(counts), direction=direction
    )
    return Leg(
        train=train,
        shots=tuple(Shot(1, k) for k in range(len(counts))),
        x_um=site.x_um,
        y_um=site.y_um,
        z_um=rig.limits.z.position_um(train.first_count),
        speed_um_s=speed_um_s,
    )


def _pass_frames(
    rig: Rig, leg: Leg, exposure_us: float, clock: DeviceClock, delay_us: float, should_stop: ShouldStop
) -> list[Frame]:
    """Return all frames of a pass, taken again while they are doubtful."""
    why = ""
    for _ in range(PASS_TRIES):
        frames: list[Frame] = []
        settings = PassSettings((exposure_us,), clock, delay_us=delay_us)
        result = run_pass(rig, leg, settings, frames.append, should_stop)
        if result.stopped:
            here = rig.stage.position()
            raise MotionStopped.at(here.x_um, here.y_um, here.z_um)
        holes = result.pairing.holes if result.pairing is not None else ()
        if not result.doubts and not holes:
            return frames
        why = "; ".join([*(doubt.why for doubt in result.doubts), *(hole.why for hole in holes)])
        reference_axes(rig)
    raise RigError(f"The sweep cannot be trusted after {PASS_TRIES} tries: {why}.")
