"""Noise of pixels in results: of weighted sums, and the bias and uncertainty of extremes and roughness.

The residuals of a fit tell the errors of a small area badly: it holds few independent ones, and a faint place has more
noise than what surrounds it. The uncertainty that each pixel was given by its own focus curve is a lower bound.

Noise makes the range and the roughness of a surface larger. The value by definition is not corrected: its uncertainty
covers the bias. Realisations of the noise are added to the measured surface once more, and each is evaluated like the
surface itself. The square of a roughness grows by the square of the noise: the second noise adds to it what the first
one added. Extremes grow in proportion to the noise, which the second one makes sqrt(2) times as large.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping

import numpy as np

from wafer_viewer.measure.base.correlated_errors import LEAST_FREEDOM, LOST_PER_PARAMETER, Scatter
from wafer_viewer.measure.base.error_covariance import MOST_PX, WeightedHeights, area_correlation
from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.numerics.fourier import fast_length

# ----------------------------------------------------------------------------------------------------------- noise bias


REPEATS = 8
"""Number of realisations of the noise."""
MOST_SIDE = 512
"""Largest side, in pixels, of the lattice on which the noise is evaluated; larger surfaces are thinned to it."""
BIAS_SHARE = 0.75
"""Standard uncertainty of a value that is not corrected for a bias, over the estimate of the bias.

U then covers one and a half of the estimate, which is itself uncertain: bench_coverage, seeds below 1000.
"""
NOISE = "noise of the heights"
FORM_ORDER = 2
"""Order of the polynomial about which the scatter of a face is taken as noise."""
EXTREMES_GROW = 1 / (math.sqrt(2) - 1)
"""Growth of an extreme by noise, over what the same noise once more adds."""
Values = Mapping[str, float]


def noise_lines(
    evaluate: Callable[[Floats], Values],
    z_um: Floats,
    covariance_um2: Floats,
    extremes: Collection[str],
    repeats: int = REPEATS,
    spread: float = 0.0,
) -> dict[str, Scatter]:
    """Return the uncertainty due to noise of each length that a surface is evaluated to.

    Parameters
    ----------
    evaluate : callable
        Function of heights [row, col] that returns lengths in um by name.
    z_um : ndarray
        Measured heights [row, col], NaN where unmeasured.
    covariance_um2 : ndarray
        Covariance of their noise by lag in pixels, [2 r + 1, 2 c + 1], the variance in the middle.
    extremes : collection of str
        Names of the lengths that are extreme heights or ranges; the others are means.
    repeats : int, optional
        Number of realisations of the noise.
    spread : float, optional
        Standard deviations of a value that are added to the bias of extremes, of which it is one realisation; noise may
        then make them smaller as well.

    Returns
    -------
    dict
        Uncertainty of each length, um: BIAS_SHARE of its bias by noise, and the scatter between
        realisations.
    """
    found = evaluate(z_um)
    again = [evaluate(z_um + noise) for noise in noise_of(covariance_um2, z_um.shape, repeats)]
    lines = dict[str, Scatter]()
    for name, value in found.items():
        each = np.array([one[name] for one in again])
        if name in extremes:
            added = float(each.mean()) - value
            bias = EXTREMES_GROW * (abs(added) + spread * float(each.std(ddof=1)) if spread else added)
        else:
            bias = value - math.sqrt(max(0.0, 2 * value**2 - float(np.mean(each**2))))
        scatter = Scatter(float(each.std(ddof=1)), repeats - 1)
        lines[name] = Scatter.joined(BIAS_SHARE * (bias if spread else min(max(0.0, bias), value)), scatter)
    return lines


def noise_of(covariance_um2: Floats, shape: tuple[int, ...], repeats: int) -> Iterator[Floats]:
    """Yield realisations [row, col] of normal noise with a covariance by lag, of a fixed seed."""
    from scipy.fft import irfft2, rfft2

    rng = np.random.default_rng(0)
    reach = tuple(n // 2 for n in covariance_um2.shape)
    size = tuple(fast_length(max(n, r) + r + 1) for n, r in zip(shape, reach, strict=True))
    table = np.zeros(size)
    table[: covariance_um2.shape[0], : covariance_um2.shape[1]] = covariance_um2
    power = np.maximum(np.real(np.asarray(rfft2(np.roll(table, (-reach[0], -reach[1]), (0, 1))))), 0.0)
    variance = float(np.real(np.asarray(irfft2(power, size)))[0, 0])
    scale = math.sqrt(float(covariance_um2[reach]) / variance) if variance > 0 else 0.0
    for _ in range(repeats):
        white = np.asarray(rfft2(rng.standard_normal(size)))
        yield scale * np.asarray(irfft2(white * np.sqrt(power), size))[: shape[0], : shape[1]]


def thinned(z_um: Floats) -> tuple[Floats, int]:
    """Return every n-th pixel of heights [row, col] along both sides, at most MOST_SIDE, and n."""
    step = max(1, math.ceil(max(z_um.shape) / MOST_SIDE))
    return z_um[::step, ::step], step


def scatter_covariance(z_um: Floats) -> Floats | None:
    """Return the covariance by lag of the scatter of heights [row, col] about a smooth form; None without one.

    It is an upper bound of the noise: texture of the face is in it too.
    """
    from wafer_viewer.numerics.filters.interpolation import polynomial

    form = polynomial(z_um, FORM_ORDER)
    if form is None:
        return None
    left = z_um - form
    variance = float(np.nanmean(left**2))
    if variance == 0:
        return np.zeros((1, 1))
    n = (FORM_ORDER + 1) * (FORM_ORDER + 2) // 2
    correlation, independent = area_correlation(left)
    freedom = max(LEAST_FREEDOM, independent - LOST_PER_PARAMETER * n)
    return variance * (freedom + n) / freedom * correlation


def window_covariance(noise_um: float, window_px: float) -> Floats:
    """Return the covariance by lag in pixels of noise that is alike over a focus window."""
    reach = max(0, math.ceil(window_px) - 1)
    row = np.maximum(0.0, 1 - np.abs(np.arange(-reach, reach + 1)) / max(1.0, window_px))
    return noise_um**2 * np.outer(row, row)


# ---------------------------------------------------------------------------------------------------------- pixel noise


def own_noise_um(reading: MeasurementContext, x_um: Floats, y_um: Floats, level: int) -> float | None:
    """Return the root mean square noise at places, from the uncertainty that their heights have of their focus curves.

    Without what their frames cause, which is alike all over them; None where heights have no uncertainty of their own.
    """
    pixel_um = reading.surface.pixel_um * 2**level
    ends = (float(x_um.min()), float(y_um.min()), float(x_um.max()), float(y_um.max()))
    margins = (-pixel_um, -pixel_um, pixel_um, pixel_um)
    if reading.layer != "unsmoothed":
        return None
    try:
        part = reading.surface.window(Region.rectangle(*map(sum, zip(ends, margins, strict=True))), level)
    except MeasureError:
        return None
    if part.u_um is None:
        return None
    rows = np.rint((part.y0_um - y_um) / pixel_um).astype(np.intp).clip(0, part.u_um.shape[0] - 1)
    cols = np.rint((x_um - part.x0_um) / pixel_um).astype(np.intp).clip(0, part.u_um.shape[1] - 1)
    u_um = part.u_um[rows, cols].astype(np.float64)
    if np.mean(np.isfinite(u_um)) < LEAST_KNOWN:
        return None
    of_frames_um = math.hypot(*reading.frame_lines(math.sqrt(0.5)).values())
    return math.sqrt(float(np.nanmean(np.maximum(u_um**2 - of_frames_um**2, 0.0))))


LEAST_KNOWN = 0.5
"""Least share of heights with an uncertainty of their own."""


PIXEL_FREEDOM = 4.0
"""Degrees of freedom of the noise of pixels: tests/bench/bench_coverage.py --reconstructed, seeds below 1000."""


def pixel_noise_um(reading: MeasurementContext, heights: WeightedHeights) -> float:
    """Return the standard uncertainty of a sum of heights by the noise of its pixels, without what their frames cause.

    0 where the uncertainty of pixels or the focus window is not known, and for more than `MOST_PX` along a side, where
    residuals tell the noise.
    """
    surface, recipe = reading.surface, reading.surface.provenance.recipe
    pixel_um, window = surface.pixel_um, recipe.window
    bounds = [float(end(place)) for end in (np.min, np.max) for place in (heights.x_um, heights.y_um)]
    large = max(bounds[2] - bounds[0], bounds[3] - bounds[1]) > MOST_PX * pixel_um
    if large or reading.layer != "unsmoothed" or isinstance(window, str):
        return 0.0
    margins = (-pixel_um, -pixel_um, pixel_um, pixel_um)
    try:
        part = surface.window(Region.rectangle(*(a + b for a, b in zip(bounds, margins, strict=True))))
    except MeasureError:
        return 0.0
    if part.u_um is None or not np.isfinite(part.u_um).any():
        return 0.0
    rows = np.rint((part.y0_um - heights.y_um) / pixel_um).astype(np.intp).clip(0, part.u_um.shape[0] - 1)
    cols = np.rint((heights.x_um - part.x0_um) / pixel_um).astype(np.intp).clip(0, part.u_um.shape[1] - 1)
    of_frames_um = math.hypot(*reading.frame_lines(math.sqrt(0.5)).values())
    noise_um = np.sqrt(np.maximum(part.u_um.astype(np.float64) ** 2 - of_frames_um**2, 0.0))
    pulls = np.zeros(part.u_um.shape)
    np.add.at(pulls, (rows, cols), heights.weight)
    return _alike_over(window, focus_measures()[recipe.focus_measure].passes, pulls * np.nan_to_num(noise_um))


def noise_um(scatter: Scatter, of_pixels_um: float) -> Scatter:
    """Return the uncertainty of a sum by the scatter of the residuals and by the noise of its pixels.

    Where the scatter is less than the pixels say, both are estimates of one variance, pooled by their freedom. More
    scatter is form or texture, which is no noise of pixels.
    """
    freedom = scatter.freedom + PIXEL_FREEDOM
    pooled_um2 = (scatter.freedom * scatter.u**2 + PIXEL_FREEDOM * of_pixels_um**2) / freedom
    return Scatter.largest((scatter, Scatter(math.sqrt(pooled_um2), freedom)))


def _alike_over(window: int, passes: int, pulls_um: Floats) -> float:
    """Return the root of the sum over all pairs of pulls [row, col] times the correlation of two focus windows."""
    from scipy.ndimage import convolve1d

    kernel = np.ones(1)
    for _ in range(passes):
        kernel = np.convolve(kernel, np.ones(window) / window)
    wide = np.pad(pulls_um, len(kernel) // 2)
    for axis in (0, 1):
        wide = convolve1d(wide, kernel, axis=axis, mode="constant")
    return float(np.sqrt(np.sum(wide**2)) / np.sum(kernel**2))
