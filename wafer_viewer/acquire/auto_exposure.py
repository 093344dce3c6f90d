"""Automatic exposure from frames over a z range, so that what is brightest in focus stays below white."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.acquire.motion import device_errors, move
from wafer_viewer.acquire.pass_runner import image_wait_s, rig_at_rest
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop

TakeFrames = Callable[[float], Iterable[Image]]
"""Takes frames over the z range at an exposure in us."""


@dataclass(frozen=True, slots=True)
class ExposureParameters:
    """Goal of the automatic exposure and limits of its search.

    Parameters
    ----------
    level : float
        Goal for the brightest pixels as a fraction of white.
    tolerance : float
        Permitted difference from the goal: 0.8 +- 0.05 leaves a margin of 15 to 25 % below white.
    ignored : float
        Fraction of pixels that may be brighter: dust, defects of the sensor and noise.
    longest_step : float
        Largest factor from one exposure to the next, where the light reveals little about the right one.
    overexposed_step : float
        Factor when the brightest pixels are white, so that their true brightness is unknown.
    tries : int
        Largest number of exposures.
    """

    level: float = 0.8
    tolerance: float = 0.05
    ignored: float = 1e-4
    longest_step: float = 8.0
    overexposed_step: float = 0.35
    tries: int = 15


EXPOSURE = ExposureParameters()


def focused_level(frames: Iterable[Image], ignored: float = EXPOSURE.ignored) -> float:
    """Return the brightness of the brightest pixels in focus.

    A pixel of a bright detail is brightest in the frame where it is in focus, so each pixel counts by its largest
    value over z.

    Parameters
    ----------
    frames : iterable of uint8 or uint16 [row, col]
        Frames over the z range at one exposure.
    ignored : float
        Fraction of pixels that may be brighter.

    Returns
    -------
    float
        Fraction of white, 0 to 1.

    Raises
    ------
    RigError
        If there is no frame.
    """
    brightest: Image | None = None
    for frame in frames:
        brightest = frame.copy() if brightest is None else np.maximum(brightest, frame, out=brightest)
    if brightest is None:
        raise RigError("The camera gave no frame to find the exposure by: check its trigger.")
    n_over = int(ignored * brightest.size)
    values = np.partition(brightest, brightest.size - 1 - n_over, axis=None)
    return float(values[brightest.size - 1 - n_over]) / np.iinfo(brightest.dtype).max


def next_exposure_us(
    exposure_us: float, level: float, limits: CameraLimits, parameters: ExposureParameters = EXPOSURE
) -> float:
    """Return the next exposure to try; the same one if the level is within the tolerance or a limit is reached.

    Parameters
    ----------
    exposure_us : float
        Exposure of the frames.
    level : float
        Brightness of the brightest pixels in focus, as a fraction of white.
    limits : CameraLimits
        Range of the exposure.
    parameters : ExposureParameters
        Goal and limits of the search.

    Returns
    -------
    float
        Exposure in us, within the limits of the camera.
    """
    if abs(level - parameters.level) <= parameters.tolerance:
        return exposure_us
    if level >= 1:
        factor = parameters.overexposed_step
    else:
        factor = min(parameters.level / max(level, 1e-6), parameters.longest_step)
    return min(max(exposure_us * factor, limits.exposure_min_us), limits.exposure_max_us)


def settle_exposure(
    take: TakeFrames, exposure_us: float, limits: CameraLimits, parameters: ExposureParameters = EXPOSURE
) -> float:
    """Return the exposure at which the brightest pixels in focus reach the goal.

    Parameters
    ----------
    take : callable
        Takes frames over the z range at an exposure in us.
    exposure_us : float
        First exposure to try.
    limits : CameraLimits
        Range of the exposure.
    parameters : ExposureParameters
        Goal and limits of the search.

    Returns
    -------
    float
        Exposure in us.

    Raises
    ------
    RigError
        If the sample is too bright or too dark for the camera, or the brightness does not follow the exposure.
    """
    level = 0.0
    for _ in range(parameters.tries):
        level = focused_level(take(exposure_us), parameters.ignored)
        following_us = next_exposure_us(exposure_us, level, limits, parameters)
        if following_us == exposure_us:
            _require_goal(exposure_us, level, parameters)
            return exposure_us
        exposure_us = following_us
    raise RigError(
        f"The exposure did not settle in {parameters.tries} tries: at the last one, the brightest pixels reached "
        f"{level:.0%} of white. Check that the light is steady and that the camera's gain is not automatic."
    )


def exposure_over_range(
    rig: Rig,
    z_um: Sequence[float],
    exposure_us: float,
    should_stop: ShouldStop,
    parameters: ExposureParameters = EXPOSURE,
) -> float:
    """Return the exposure for the current field by frames at several z positions.

    Parameters
    ----------
    rig : Rig
        Rig at the field; it is left at rest.
    z_um : sequence of float
        Positions over the z range, in um, a few depths of field apart.
    exposure_us : float
        First exposure to try.
    should_stop : ShouldStop
        Polled during the moves.
    parameters : ExposureParameters
        Goal and limits of the search.

    Returns
    -------
    float
        Exposure in us.

    Raises
    ------
    RigError
        If no exposure suits, or a device fails. MotionStopped if stopped.
    """
    with rig_at_rest(rig):
        return settle_exposure(
            lambda tried_us: _frames(rig, z_um, tried_us, should_stop), exposure_us, rig.limits.camera, parameters
        )


def _frames(rig: Rig, z_um: Sequence[float], exposure_us: float, should_stop: ShouldStop) -> Iterator[Image]:
    """Halt at every z position and take a frame on command; frames that are lost are left out."""
    here = rig.limits.z.counts(rig.stage.position().z_um)
    train = PulseTrain(axis="z", first_count=here, counts_per_frame=1, n_frames=len(z_um), direction=1)
    with device_errors("camera"):
        rig.camera.start(exposure_us)
    rig.box.reference("z", here)
    rig.box.arm(train, on_command=True)
    for position_um in z_um:
        with device_errors("stage"):
            move(rig, {"z": position_um}, should_stop)
        rig.box.fire()
        with device_errors("camera"):
            taken = rig.camera.next_image(image_wait_s(rig, exposure_us))
        rig.box.pulses()
        if taken is not None and taken.image is not None:
            yield taken.image
    rig.box.disarm()
    with device_errors("camera"):
        rig.camera.stop()


def _require_goal(exposure_us: float, level: float, parameters: ExposureParameters) -> None:
    if level > parameters.level + parameters.tolerance:
        raise RigError(
            f"The sample is too bright: at the shortest exposure, {exposure_us:g} us, the brightest pixels reach "
            f"{level:.0%} of white. Lower the light or the gain."
        )
    if level < parameters.level - parameters.tolerance:
        raise RigError(
            f"The sample is too dark: at the longest exposure, {exposure_us:g} us, the brightest pixels reach only "
            f"{level:.0%} of white. Raise the light or the gain."
        )
