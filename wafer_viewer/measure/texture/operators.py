"""Operators of an areal surface as a chain: spikes, S-filter, F-operator, L-filter, borders (ISO 25178-3)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.plane_faces import MIN_POINTS
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import TextureOptions
from wafer_viewer.numerics.filters.gaussian import gaussian_mean
from wafer_viewer.numerics.filters.interpolation import polynomial

SPIKE_DEVIATIONS = 6.0
"""Robust standard deviations of the heights about the median of their neighbours beyond which one is a spike.

Normal noise exceeds it once in 500 million heights. Set on drawn surfaces of tests/measure/texture/test_operators.py.
"""
_SPIKE_REACH = 2
"""Pixels to each side that are neighbours: spikes of two pixels side by side leave the median alone."""
_STRIPE_ROWS = 64
"""Rows of which the neighbours are in memory at once."""


def scale_limited(z_um: Floats, pixel_um: float, options: TextureOptions) -> Floats:
    """Remove form, S-filtered and L-filtered waves from heights.

    The S-filter is applied to the residual from the form: it preserves polynomials, and a tilt causes no edge effects.

    Parameters
    ----------
    z_um : (row, col) array of float
        Heights in um; NaN where nothing was measured.
    pixel_um : float
        Width of a pixel in um.
    options : TextureOptions
        The form's order, the nesting indices, and what becomes of the borders.

    Returns
    -------
    (row, col) array of float
        Scale-limited heights in um, of zero mean; NaN where nothing was measured, and at borders that are cut.

    Raises
    ------
    MeasureError
        Where a filter is longer than the face, or its points do not determine the form, or too little is left of it
        without its borders.
    """
    *_, (_, left) = operated(z_um, pixel_um, options)
    return left


def operated(z_um: Floats, pixel_um: float, options: TextureOptions) -> Iterator[tuple[str, Floats]]:
    """Yield name and heights [row, col] after each operator, of zero mean. Raises the errors of `scale_limited`."""
    _require_room(z_um.shape, pixel_um, options)
    left = z_um - np.nanmean(z_um)
    if options.spikes == "remove":
        spikes = spikes_of(left)
        left = np.asarray(np.where(spikes, np.nan, left), np.float64)
        yield f"spikes, {np.count_nonzero(spikes)} points", left - np.nanmean(left)
    left = _without_form(left, options.form_order)
    if options.s_filter_um is not None:
        left = gaussian_mean(left, options.s_filter_um / pixel_um)
        yield f"S {options.s_filter_um:g} um", left - np.nanmean(left)
        left = _without_form(left, options.form_order)
    yield f"F {_FORMS.get(options.form_order, f'order {options.form_order}')}", left - np.nanmean(left)
    if options.l_filter_um is not None:
        left = left - gaussian_mean(left, options.l_filter_um / pixel_um)
        yield f"L {options.l_filter_um:g} um", left - np.nanmean(left)
    if options.borders == "cut":
        inner = _beyond_border(np.isfinite(left), longest_um(options) / 2 / pixel_um)
        left = np.asarray(np.where(inner, left, np.nan), np.float64)
        if np.count_nonzero(np.isfinite(left)) < MIN_POINTS:
            raise MeasureError("Without its borders too little of the face is left: draw it larger, or keep them.")
        yield "borders cut", left - np.nanmean(left)


_FORMS = {0: "mean", 1: "plane"}
"""Words for the orders of the form."""


def chain_text(operators: Iterator[tuple[str, Floats]]) -> tuple[str, Floats]:
    """Return the names of operators in their order, each with Sq after it, and the heights after the last."""
    words: list[str] = []
    left = np.empty(0)
    for name, left in operators:
        words.append(f"{name}: Sq {np.sqrt(np.nanmean(left**2)):.3g} um")
    return " → ".join(words), left


def spikes_of(z_um: Floats) -> NDArray[np.bool_]:
    """Return a mask of the heights [row, col] that stand out of the median of their 24 neighbours.

    Neighbours count where there is one opposite too, so that no slope makes spikes along borders and holes.
    """
    away = np.full(z_um.shape, np.nan)
    wide = np.pad(z_um, _SPIKE_REACH, constant_values=np.nan)
    side = 2 * _SPIKE_REACH + 1
    for first in range(0, len(z_um), _STRIPE_ROWS):
        rows = slice(first, min(first + _STRIPE_ROWS, len(z_um)))
        near = np.lib.stride_tricks.sliding_window_view(wide[rows.start : rows.stop + 2 * _SPIKE_REACH], (side, side))
        ring = np.delete(near.reshape(*near.shape[:2], side * side), side * side // 2, axis=2)
        away[rows] = z_um[rows] - _median_of_known(np.where(np.isfinite(ring[..., ::-1]), ring, np.nan))
    known = np.abs(away[np.isfinite(away)])
    scatter = 1.4826 * float(np.median(known)) if known.size else 0.0
    least = max(SPIKE_DEVIATIONS * scatter, 1e-9 * float(np.nanmax(np.abs(z_um))))
    return np.asarray(np.abs(away) > least)


def _median_of_known(values: Floats) -> Floats:
    """Return the medians of the finite values along the last axis; NaN where there is none."""
    ordered = np.sort(values, axis=-1)  # NaN last
    n = np.isfinite(values).sum(axis=-1)
    pair = [np.take_along_axis(ordered, k[..., None].clip(0), -1)[..., 0] for k in ((n - 1) // 2, n // 2)]
    return np.where(n > 0, (pair[0] + pair[1]) / 2, np.nan)


def longest_um(options: TextureOptions) -> float:
    """Return the nesting index of the longest filter; 0 without one."""
    return max(options.s_filter_um or 0.0, options.l_filter_um or 0.0)


def _beyond_border(valid: NDArray[np.bool_], reach_px: float) -> NDArray[np.bool_]:
    """Return a mask of the pixels of a face that lie further from its outline than a distance; holes are no outline."""
    from scipy.ndimage import binary_fill_holes, distance_transform_edt

    filled = np.pad(np.asarray(binary_fill_holes(valid)), 1)
    distance_px: Floats = np.asarray(distance_transform_edt(filled))[1:-1, 1:-1]
    return distance_px > reach_px


def _require_room(shape: tuple[int, ...], pixel_um: float, options: TextureOptions) -> None:
    narrowest_um = min(shape) * pixel_um
    for name, cutoff_um in (("S", options.s_filter_um), ("L", options.l_filter_um)):
        if cutoff_um is not None and cutoff_um > narrowest_um:
            raise MeasureError(
                f"The {name}-filter of {cutoff_um:g} um is longer than the face, {narrowest_um:.4g} um at its "
                "narrowest: draw it larger or take a shorter filter."
            )


def _without_form(z_um: Floats, order: int) -> Floats:
    form = polynomial(z_um, order)
    if form is None:
        raise MeasureError(
            f"The measured points of the face do not determine a form of order {order}: draw it larger or lower the "
            "order."
        )
    return z_um - form
