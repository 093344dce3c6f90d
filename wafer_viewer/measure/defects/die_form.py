"""Plane, bow, brightness and likeness of one die against the reference, with standard uncertainties. Pure.

Medians of blocks of the die are fitted, so that defects smaller than a block do not count, and the scatter of the
blocks includes noise that is correlated over the focus window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.robust_fit import robust_fit
from wafer_viewer.measure.dies.die_cells import DiePlane, Plane
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

Floats = NDArray[np.float64]
Area = tuple[slice, slice]
"""Rows and columns of the die in its cell, without the streets."""


@dataclass(frozen=True, slots=True)
class DieFormParameters:
    """Limits of the fit of a die.

    Parameters
    ----------
    blocks : int
        Number of blocks along each side of a die.
    block_px : int
        Largest number of pixels along a side of a block whose median is taken.
    least_known : float
        Smallest known fraction of a block.
    least_blocks : int
        Smallest number of known blocks for a fit.
    points : int
        Approximate number of pixels to which the brightness is fitted.
    least_points : int
        Smallest number of them.
    clear : float
        Smallest contrast of the pattern, in deviations of the noise, for the contrast of a die.
    edge_px : int, px
        Distance from the outline of a lifted die within which it is not compared.
    lifted : float
        Lift from which a die's outline is not compared, in spreads of the reference.

    Notes
    -----
    `tests/bench/bench_die_states.py` counts the dies named right with these values.
    """

    blocks: int = 12
    block_px: int = 12
    least_known: float = 0.3
    least_blocks: int = 20
    points: int = 6_000
    least_points: int = 50
    clear: float = 3.0
    edge_px: int = 2
    lifted: float = 4.0


DIE_FORM = DieFormParameters()


@dataclass(frozen=True, slots=True)
class DieForm:
    """A die relative to the reference: tilts in um per um (right, up), offset and bow in um, log brightness.

    offset_um: mean height of the corners. bow_um: height of the middle over the corners. u_*: standard uncertainties
    (k = 1) by the scatter of the blocks. known: fitted blocks relative to all, 0 without a fit.
    """

    tilt: tuple[float, float] = (0.0, 0.0)
    offset_um: float = 0.0
    bow_um: float = 0.0
    brightness: float = 0.0
    u_tilt: float = 0.0
    u_offset_um: float = 0.0
    u_bow_um: float = 0.0
    u_brightness: float = 0.0
    known: float = 0.0


def flatten(z_um: Plane, area: Area, spread_um: Plane, pixel_um: float) -> tuple[Plane, DieForm]:
    """Return heights less the plane and bow of the die, and less the plane of the street beside it; and the die's form.

    Where a lifted die ends, a narrow strip becomes unknown.
    """
    street, die = z_um.copy(), z_um[area]
    street[area] = np.nan
    beside = DiePlane.of(street) if np.isfinite(street).any() else DiePlane()
    fitted = _fitted(die)
    if fitted is None:
        plane = DiePlane.of(z_um)
        return plane.off(z_um), DieForm()
    coefficients, u, known = fitted
    form = _surface(coefficients, die.shape)
    ground = beside if beside != DiePlane() else DiePlane.of(z_um)
    flat, lift = ground.off(z_um), ground.seen_from(area[0].start, area[1].start).off(form)
    flat[area] = die - form
    _forget_outline(flat, area, _outline_lift(lift), float(np.nanmedian(spread_um)))
    half = np.array(die.shape) * pixel_um / 2
    return flat, DieForm(
        tilt=(float(coefficients[1] / half[1]), float(-coefficients[0] / half[0])),
        offset_um=float(coefficients[2]),
        bow_um=float(coefficients[3]),
        u_tilt=float(max(u[1] / half[1], u[0] / half[0])),
        u_offset_um=float(u[2]),
        u_bow_um=float(u[3]),
        known=known,
    )


def _terms(rows: Floats, cols: Floats, shape: tuple[int, ...]) -> tuple[Floats, Floats, Floats]:
    """Return down and right, -1 to 1 over the die, and the bow, 1 in the middle and 0 at the corners."""
    down, right = 2 * (rows + 0.5) / shape[0] - 1, 2 * (cols + 0.5) / shape[1] - 1
    a, b = (side / math.hypot(*shape) for side in shape)
    return down, right, 1 - (a * down) ** 2 - (b * right) ** 2


def _fitted(die: Plane) -> tuple[Floats, Floats, float] | None:
    """Return coefficients, standard uncertainties and the known fraction of a fit to block medians."""
    medians, rows, cols = _blocks(die)
    finite = np.isfinite(medians)
    if np.count_nonzero(finite) < DIE_FORM.least_blocks:
        return None
    down, right, bow = _terms(rows[finite], cols[finite], die.shape)
    design, values = np.stack([down, right, np.ones_like(down), bow], axis=1), medians[finite]
    try:
        fit = robust_fit(design, values)
    except MeasureError:
        return None
    inner = design[fit.inliers]
    freedom = max(1, len(inner) - design.shape[1])
    sigma = math.sqrt(float(np.sum(fit.residuals[fit.inliers] ** 2)) / freedom)
    u = sigma * np.sqrt(np.diag(np.linalg.inv(inner.T @ inner)))
    return fit.coefficients, np.asarray(u, np.float64), float(finite.mean())


def _blocks(plane: Plane) -> tuple[Floats, Floats, Floats]:
    """Return the medians of the blocks of a die, NaN where too little is known, and their middles, [block] each."""
    (rows, middle_rows), (cols, middle_cols) = (_samples(n) for n in plane.shape)
    blocks = np.sort(plane[rows[:, None, :, None], cols[None, :, None, :]].reshape(len(rows) * len(cols), -1), axis=1)
    known = np.isfinite(blocks).sum(axis=1)  # NaN goes last
    each = np.arange(len(blocks))
    low, high = (blocks[each, np.maximum(known - 1 + k, 0) // 2] for k in (0, 1))
    medians = np.where(known > DIE_FORM.least_known * blocks.shape[1], (low + high) / 2, np.nan).astype(np.float64)
    return medians, np.repeat(middle_rows, len(cols)), np.tile(middle_cols, len(rows))


def _samples(n: int) -> tuple[NDArray[np.intp], Floats]:
    """Return the sample pixels of each block along a side of a die of n pixels, [block, sample], and their middles."""
    n_blocks = max(1, min(DIE_FORM.blocks, n // 3))
    side = n / n_blocks
    n_samples = min(DIE_FORM.block_px, max(1, round(side)))
    within = (np.arange(n_samples) + 0.5) / n_samples
    samples = np.floor((np.arange(n_blocks)[:, None] + within) * side).astype(np.intp)
    return samples, samples.mean(axis=1)


def _surface(coefficients: Floats, shape: tuple[int, ...]) -> Plane:
    """Return the fitted heights of a die."""
    rows, cols = (np.arange(n, dtype=np.float64) for n in shape)
    down, right, bow = _terms(rows[:, None], cols[None, :], shape)
    return (coefficients[0] * down + coefficients[1] * right + coefficients[2] + coefficients[3] * bow).astype(
        np.float32
    )


def _outline_lift(form: Plane) -> float:
    return float(max(np.abs(line).max() for line in (form[0], form[-1], form[:, 0], form[:, -1])))


def _forget_outline(flat: Plane, area: Area, lift_um: float, spread_um: float) -> None:
    """Make a strip along the outline of a die unknown if the die is lifted off its place there."""
    if lift_um <= DIE_FORM.lifted * spread_um:
        return
    reach = DIE_FORM.edge_px
    outer = tuple(slice(max(0, side.start - reach), side.stop + reach) for side in area)
    inner = tuple(slice(side.start + reach, max(side.start + reach, side.stop - reach)) for side in area)
    kept = flat[inner].copy()
    flat[outer] = np.nan
    flat[inner] = kept


def levelled_picture(difference: Plane, reference: Plane, area: Area) -> tuple[Plane, float, float]:
    """Return the difference of a log picture less the brightness, contrast and trend of the die and that of its street.

    Also the die's log brightness relative to the reference, and its standard uncertainty.
    """
    street = difference.copy()
    street[area] = np.nan
    beside = _median(street)
    die, like = difference[area], reference[area]
    medians = _blocks(die)[0]
    finite = np.isfinite(medians)
    level = float(np.median(medians[finite])) if finite.any() else 0.0
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(medians[finite] - level))) if finite.any() else 0.0
    slopes, gain, middle = _gain(die, like)
    flat = difference - np.float32(level if beside is None else beside)
    down, right = (2 * (np.arange(n) + 0.5) / n - 1 for n in die.shape)
    trend = slopes[0] * down[:, None] + slopes[1] * right[None, :]
    flat[area] = die - (gain * (like - np.float32(middle)) + trend + slopes[2]).astype(np.float32)
    return flat, level, scatter / math.sqrt(max(1, np.count_nonzero(finite)))


def _gain(difference: Plane, like: Plane) -> tuple[tuple[float, float, float], float, float]:
    """Return the trend (down, right, level) of a die's difference, its excess contrast, and the pattern's middle."""
    step = max(1, round((difference.size / DIE_FORM.points) ** 0.5))
    some, by = difference[::step, ::step], like[::step, ::step]
    rows, cols = np.nonzero(np.isfinite(some) & np.isfinite(by))
    values = some[rows, cols].astype(np.float64)
    if len(values) < DIE_FORM.least_points:
        return (0.0, 0.0, float(np.median(values)) if len(values) else 0.0), 0.0, 0.0
    pattern = by[rows, cols].astype(np.float64)
    middle = float(np.median(pattern))
    down, right, _ = _terms(rows * np.float64(step), cols * np.float64(step), difference.shape)
    design = np.stack([down, right, np.ones(len(values)), pattern - middle], axis=1)
    try:
        fit = robust_fit(design, values)
        trend_down, trend_right, level, gain = fit.coefficients.tolist()
        if float(pattern.std()) < DIE_FORM.clear * float(fit.residuals[fit.inliers].std()):
            gain = 0.0  # the noise of the reference is no pattern
    except MeasureError:
        return (0.0, 0.0, float(np.median(values))), 0.0, middle
    return (trend_down, trend_right, level), gain, middle


def _median(plane: Plane) -> float | None:
    some = plane[::4, ::4]
    some = some[np.isfinite(some)]
    return float(np.median(some)) if some.size >= DIE_FORM.least_points else None
