"""Uncertainty of texture and roughness by the noise of heights and by what the focus window averages."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.measurement_context import WINDOW, Z_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import BIAS_SHARE, NOISE, noise_lines, own_noise_um, window_covariance
from wafer_viewer.numerics.filters.sliding_filters import mean_of_valid

NOISE_KNOWN = "Noise of {:.3g} um{}: values are not corrected for it, U covers it."
OF_HEIGHTS = ", from the uncertainty of the heights"
NOISE_UNKNOWN = (
    "U needs the noise of the heights, which have no uncertainty of their own: "
    "give it with noise_um (`calibrate noise`)."
)
LONGEST_NOISE = 4.0
"""Length over which noise may be alike, in focus windows: U is the larger of that by one and by so many.

An S-filter removes the shorter noise and passes the longer one.
"""


def noise_of(
    reading: MeasurementContext, given_um: float | None, x_um: Floats, y_um: Floats, level: int
) -> float | None:
    """Return the noise of heights in um: the given one, or by their own uncertainty; None if there is no U."""
    if not reading.calibrated:
        return None
    return own_noise_um(reading, x_um, y_um, level) if given_um is None else given_um


def noise_notes(reading: MeasurementContext, given_um: float | None, noise_um: float | None) -> tuple[str, ...]:
    """Return notes on the noise that U is evaluated with; none without a calibration."""
    if not reading.calibrated:
        return ()
    if noise_um is None:
        return (NOISE_UNKNOWN,)
    return NOISE_KNOWN.format(noise_um, OF_HEIGHTS if given_um is None else ""), *reading.not_in_budget()


def length_lines(
    reading: MeasurementContext,
    evaluate: Callable[[Floats], dict[str, float]],
    z_um: Floats,
    pixel_um: float,
    noise_um: float,
    extremes: Collection[str],
    spread: float = 0.0,
) -> dict[str, Lines]:
    """Return the lines of noise, resolution and frames of each length that heights [row, col] are evaluated to."""
    window_px = _window_px(reading, pixel_um)
    models = (window_covariance(noise_um, times * window_px) for times in (1.0, LONGEST_NOISE))
    found, coarser = evaluate(z_um), evaluate(_averaged(z_um, window_px))
    noises = [noise_lines(evaluate, z_um, covariance, extremes, spread=spread) for covariance in models]
    frames = reading.frame_lines(1 / math.sqrt(2))
    return {
        name: {
            NOISE: Scatter.largest(noise[name] for noise in noises),
            WINDOW: BIAS_SHARE * _lost_um(found[name], coarser.get(name, found[name])),
            **frames,
        }
        for name in found
    }


def _window_px(reading: MeasurementContext, pixel_um: float) -> float:
    """Return the focus window in pixels of a level; one pixel where the surface does not tell it."""
    provenance = reading.surface.provenance
    window = provenance.recipe.window
    return 1.0 if isinstance(window, str) else max(1.0, window * reading.surface.pixel_um / pixel_um)


def _averaged(z_um: Floats, window_px: float) -> Floats:
    """Return heights averaged over the focus window twice, as wide as caps show that a focus measure averages."""
    valid, size = np.isfinite(z_um), 2 * round((window_px - 1) / 2) + 1
    averaged = np.where(valid, z_um - np.nanmean(z_um), 0.0)
    for _ in range(2):
        averaged = mean_of_valid(averaged, valid, size)
    return np.where(valid, averaged, np.nan)


def _lost_um(value_um: float, coarser_um: float) -> float:
    """Return what averaging took of a length, by the share that it takes when it is done once more."""
    return value_um * max(0.0, value_um / coarser_um - 1) if coarser_um > 0 else value_um


def with_scale(reading: MeasurementContext, value_um: float, lines: Lines) -> Lines:
    """Return budget lines of a height with that of the z scale."""
    return {Z_SCALE: reading.u_z_scale * abs(value_um), **lines}
