"""Automatic exposure from frames over the z range of some fields: what is brightest in focus stays below white.

A pixel of a bright detail is brightest in the frame where it is in focus, so each pixel counts by its largest value
over z. Where that leaves a part of the sample too dark, longer exposures are tried for a bracket.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.acquire.commanded_frames import commanded_frames, frames_at_places
from wafer_viewer.acquire.motion import device_errors, move
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.acquisition.procedure import ExposureLevels, FoundExposure, ProcedureControl, ProcedureStep
from wafer_viewer.model.acquisition.rig_limits import CameraLimits, RigLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop

Look = Callable[[float], ExposureLevels]
"""Measures the brightness in focus at an exposure in us."""


@dataclass(frozen=True, slots=True)
class ExposureParameters:
    """Goal of the automatic exposure, limits of its search, and the rule for a bracket.

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
    dark_level : float
        Fraction of white below which a pixel is dark: 13 of 255 counts, where a contrast of 8 % is one count.
    dark_fraction : float
        Fraction of dark pixels from which a bracket is tried.
    bracket_level : float
        Goal of the next longer exposure of a bracket for the median of the dark pixels.
    bracket_step : float
        Largest ratio of two exposures of a bracket: the fusion compares pixels that are well exposed in both.
    bracket_gain : float
        Fraction of the dark pixels that a longer exposure must bring to light to belong to the bracket.
    bracket_exposures : int
        Largest number of exposures of a bracket.
    """

    level: float = 0.8
    tolerance: float = 0.05
    ignored: float = 1e-4
    longest_step: float = 8.0
    overexposed_step: float = 0.35
    tries: int = 15
    dark_level: float = 0.05
    dark_fraction: float = 0.02
    bracket_level: float = 0.25
    bracket_step: float = 8.0
    bracket_gain: float = 0.3
    bracket_exposures: int = 3


EXPOSURE = ExposureParameters()
POSITIONS = 40
"""Largest number of z positions in a field, which are a depth of field apart as long as the range permits."""
SPREAD = ((0.5, 0.5), (0.2, 0.2), (0.8, 0.2), (0.2, 0.8), (0.8, 0.8))
"""Places in the rectangle around all fields, as fractions of its width and height, whose nearest fields are looked at;
the corners are left out, for they often lie beside the wafer."""
FIRST_EXPOSURE_US = 200.0
"""First exposure that is tried where nothing is known of the light."""
USUAL_TRIES = 4
"""Number of exposures that a search usually takes, for its progress."""


@dataclass(frozen=True)
class FindExposure:
    """Procedure that finds the exposure for the brightest of some fields over the z range of a sweep.

    fields: those to look at; exposure_us: the first one to try.
    """

    fields: tuple[Field, ...]
    sweep: FocusSweep
    exposure_us: float
    parameters: ExposureParameters = EXPOSURE

    @property
    def title(self) -> str:
        """Title of the running work."""
        return "Find the exposure"

    def run(self, rig: Rig, control: ProcedureControl) -> FoundExposure:
        """Find the exposure; the stage stays at the last field.

        Raises RigError if no exposure suits, or a device fails; MotionStopped if stopped.
        """
        z_um = z_positions_um(self.sweep, rig.limits)
        search = _Search(self, rig, control, z_um)
        single = settle_exposure(search.look, self.exposure_us, rig.limits.camera, self.parameters)
        bracket = bracket_from(single, search.look, rig.limits.camera, self.parameters)
        return FoundExposure(single, bracket, tuple(f.number for f in self.fields), z_um, search.n_frames)


def exposure_at(
    rig: Rig,
    x_um: float,
    y_um: float,
    positions_um: Iterable[float],
    should_stop: ShouldStop,
    tell: Callable[[float], None] = lambda exposure_us: None,
) -> float:
    """Return the exposure in us at which the brightest pixels of a place, over positions in z, are below white.

    tell: receives every exposure that is tried. Raises RigError if no exposure suits, MotionStopped if stopped.
    """
    places_um = tuple(positions_um)

    def look(exposure_us: float) -> ExposureLevels:
        tell(exposure_us)
        with frames_at_places(rig, exposure_us, should_stop) as take:
            picture = in_focus(take(x_um, y_um, float(z_um)) for z_um in places_um)
        return levels_of([(1, picture)], exposure_us)

    return settle_exposure(look, FIRST_EXPOSURE_US, rig.limits.camera).exposure_us


def spread_fields(fields: Sequence[Field]) -> tuple[Field, ...]:
    """Return up to five fields spread over all of them, in the order of their numbers."""
    x_um, y_um = np.array([f.x_um for f in fields]), np.array([f.y_um for f in fields])
    chosen: set[int] = set()
    for across, up in SPREAD:
        x, y = x_um.min() + across * np.ptp(x_um), y_um.min() + up * np.ptp(y_um)
        chosen.add(int(np.argmin((x_um - x) ** 2 + (y_um - y) ** 2)))
    return tuple(sorted((fields[i] for i in chosen), key=lambda f: f.number))


def z_positions_um(sweep: FocusSweep, limits: RigLimits) -> tuple[float, ...]:
    """Return positions over the range of a sweep, from its start on, a depth of field apart."""
    n = min(math.ceil(sweep.range_um / limits.depth_of_field_um) + 1, POSITIONS, sweep.n_frames)
    return tuple(float(z) for z in np.linspace(0.0, sweep.range_um, max(2, n)))


def in_focus(frames: Iterable[Image]) -> Image:
    """Return the largest value of each pixel over the frames [row, col]. Raises RigError if there is no frame."""
    brightest: Image | None = None
    for frame in frames:
        brightest = frame.copy() if brightest is None else np.maximum(brightest, frame, out=brightest)
    if brightest is None:
        raise RigError("The camera gave no frame to find the exposure by: check its trigger.")
    return brightest


def levels_of(
    pictures: Iterable[tuple[int, Image]], exposure_us: float, parameters: ExposureParameters = EXPOSURE
) -> ExposureLevels:
    """Return the brightness of pictures in focus, each with the number of its field, taken at one exposure."""
    levels: dict[int, float] = {}
    histogram, white = np.zeros(1, np.int64), 1
    for number, picture in pictures:
        white = int(np.iinfo(picture.dtype).max)
        counts = np.bincount(picture.ravel(), minlength=white + 1)
        histogram = histogram + counts
        n_over = int(parameters.ignored * picture.size)
        levels[number] = float(np.searchsorted(np.cumsum(counts), picture.size - n_over)) / white
    total, n_dark_greys = int(histogram.sum()), math.ceil(parameters.dark_level * white)
    below = np.cumsum(histogram[:n_dark_greys])
    n_dark = int(below[-1])
    brightest = max(levels, key=levels.__getitem__)
    return ExposureLevels(
        exposure_us=exposure_us,
        level=levels[brightest],
        clipped_fraction=int(histogram[-1]) / total,
        dark_fraction=n_dark / total,
        dark_level=float(np.searchsorted(below, n_dark / 2)) / white if n_dark else 0.0,
        brightest_field=brightest,
    )


def next_exposure_us(
    exposure_us: float, level: float, limits: CameraLimits, parameters: ExposureParameters = EXPOSURE
) -> float:
    """Return the next exposure to try; the same one if the level is within the tolerance or a limit is reached."""
    if abs(level - parameters.level) <= parameters.tolerance:
        return exposure_us
    if level >= 1:
        factor = parameters.overexposed_step
    else:
        factor = min(parameters.level / max(level, 1e-6), parameters.longest_step)
    return _within(exposure_us * factor, limits)


def settle_exposure(
    look: Look, exposure_us: float, limits: CameraLimits, parameters: ExposureParameters = EXPOSURE
) -> ExposureLevels:
    """Return the brightness at the exposure at which the brightest pixels in focus reach the goal.

    Raises RigError if the sample is too bright or too dark for the camera, or the brightness does not follow.
    """
    exposure_us, level = _within(exposure_us, limits), 0.0
    for _ in range(parameters.tries):
        levels = look(exposure_us)
        level = levels.level
        following_us = next_exposure_us(exposure_us, level, limits, parameters)
        if following_us == exposure_us:
            _require_goal(exposure_us, level, parameters)
            return levels
        exposure_us = following_us
    raise RigError(
        f"The exposure did not settle in {parameters.tries} tries: at the last one, the brightest pixels reached "
        f"{level:.0%} of white. Check that the light is steady and that the camera's gain is not automatic."
    )


def bracket_from(
    single: ExposureLevels, look: Look, limits: CameraLimits, parameters: ExposureParameters = EXPOSURE
) -> tuple[ExposureLevels, ...]:
    """Return the brightness at the exposures of a bracket that begins with a single one; empty if that suffices.

    A longer exposure is added while many pixels are dark and it brings enough of them to light.
    """
    bracket = [single]
    while bracket[-1].dark_fraction > parameters.dark_fraction and len(bracket) < parameters.bracket_exposures:
        last = bracket[-1]
        factor = min(parameters.bracket_level / max(last.dark_level, 1e-6), parameters.bracket_step)
        longer_us = _within(last.exposure_us * factor, limits)
        if longer_us <= last.exposure_us:
            break
        longer = look(longer_us)
        if longer.dark_fraction > (1 - parameters.bracket_gain) * last.dark_fraction:
            break
        bracket.append(longer)
    return tuple(bracket) if len(bracket) > 1 else ()


class _Search:
    """Frames at the fields of a search, and their number and progress."""

    def __init__(self, task: FindExposure, rig: Rig, control: ProcedureControl, z_um: tuple[float, ...]) -> None:
        self._task, self._rig, self._control, self._z_um = task, rig, control, z_um
        self.n_frames = 0

    def look(self, exposure_us: float) -> ExposureLevels:
        """Measure the brightness in focus over all fields."""
        pictures = ((field.number, in_focus(self._frames(field, exposure_us))) for field in self._task.fields)
        return levels_of(pictures, exposure_us, self._task.parameters)

    def _frames(self, field: Field, exposure_us: float) -> Iterator[Image]:
        """Halt at every z position of a field and take a frame on command; frames that are lost are left out."""
        rig, should_stop = self._rig, self._control.should_stop
        with device_errors("stage"):
            move(rig, {"x": field.x_um, "y": field.y_um, "z": field.z_start_um}, should_stop)
        with commanded_frames(rig, exposure_us) as frames:
            for above_um in self._z_um:
                with device_errors("stage"):
                    move(rig, {"z": field.z_start_um + above_um}, should_stop)
                taken = frames.take()
                self._report(field, field.z_start_um + above_um, exposure_us)
                if taken is not None:
                    yield taken.image

    def _report(self, field: Field, z_um: float, exposure_us: float) -> None:
        self.n_frames += 1
        tries = self.n_frames / (len(self._task.fields) * len(self._z_um))
        words = f"Field {field.number}, z {z_um:.1f} um, {exposure_us:g} us"
        self._control.report(ProcedureStep(tries / (tries + USUAL_TRIES / 2), words))


def _within(exposure_us: float, limits: CameraLimits) -> float:
    """Return an exposure with three digits within the limits of the camera."""
    return min(max(float(f"{exposure_us:.3g}"), limits.exposure_min_us), limits.exposure_max_us)


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
