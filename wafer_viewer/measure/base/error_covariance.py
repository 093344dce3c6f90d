"""Covariance of the errors of heights over an area, and the uncertainty of any weighted sum of heights by it.

The errors of a height map are correlated over the focus window and by the form of the surface. The variance of a
weighted sum of heights is the sum over all pairs of points of both weights and the covariance at their lag; this holds
for a mean, for the parameters of a plane or a sphere, and for the median of a few pixels alike.

The covariance is that of the residuals of a fit. An area that is not several correlation lengths wide hides a share of
its errors in the fit. Its covariance is then taken from the surface around it, as far as that continues smoothly. Where
this does not help either, the correlation cannot be told from the area itself: the uncertainty is widened, with a note.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.correlated_errors import LEAST_FREEDOM, LOST_PER_PARAMETER, Scatter, well_filled
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, height_window, points_in
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.robust_fit import fit_plane, paraboloid_design, plane_design, robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Heights
from wafer_viewer.numerics.fourier import autocorrelation, lagged_products
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

CELLS = 256
"""Largest number of cells along a side of the lattice; larger areas are averaged over blocks of pixels."""
LOST_CORRELATION = 0.05
"""Correlation of an area's errors, as a mean over a distance, below which it is lost in its own scatter."""
ENOUGH = 40.0
"""Apparent number of independent errors from which an area tells its own covariance."""
RESOLVED = 11.0
"""The same below which the correlation may be longer than the area: one shorter than half a correlation length shows 7
to 9 apparent ones."""
UNRESOLVED = 2.0
"""Factor of the uncertainty below RESOLVED."""
LIKE_ITSELF = 4.0
"""Ratio of the variance of an area's residuals to that expected by the errors around it, beyond which it is noisier."""
MOST_PX = 512
"""Side, in pixels, from which an area is not extended: its residuals are alike over long distances by its form."""
AROUND_PX = 256
"""Margin, in pixels, of the surface around an area."""
BLOCK_PX = 4
"""Side of the blocks by which the smooth surface around an area is found."""
EDGE_SIGMAS = 6.0
"""Bend between neighbouring blocks, in robust deviations, from which they lie across an edge."""
PADS = (((1, 1), (0, 0)), ((0, 0), (1, 1)))
"""Cells added before and after rows and columns, for differences along each of the two axes."""
UNRESOLVED_NOTE = (
    "Noise and form: errors are alike over much of what was measured, and too little lies around it to tell over how "
    "far; their line of the budget is widened."
)


@dataclass(frozen=True, slots=True, eq=False)
class WeightedHeights:
    """Places on the surface in um and weights of their heights in a sum: float64 [n]."""

    x_um: Floats
    y_um: Floats
    weight: Floats

    @classmethod
    def of(cls, points: HeightSamples, weight: Floats) -> WeightedHeights:
        """Return the sum over points with the weights [n]."""
        return cls(points.x_um, points.y_um, weight)

    @classmethod
    def of_fit(cls, points: HeightSamples, design: Floats, gradient: Floats) -> WeightedHeights:
        """Return the sum that is gradient [p] times the least-squares parameters of design [n, p]."""
        weights, scale = fit_weights(design)
        return cls.of(points, weights @ (gradient / scale))

    @classmethod
    def joined(cls, sums: Iterable[WeightedHeights]) -> WeightedHeights:
        """Return the sum of several sums."""
        parts = tuple(sums)
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("x_um", "y_um", "weight")))

    def times(self, factor: float) -> WeightedHeights:
        """Return the sum times a factor."""
        return dataclasses.replace(self, weight=factor * self.weight)


def fit_weights(design: Floats) -> tuple[Floats, Floats]:
    """Return the weights [n, p] of heights in each parameter of a fit of design [n, p], times a scale [p], and that."""
    scale = np.sqrt(np.mean(design**2, axis=0))
    scaled = design / (scale := np.where(scale > 0, scale, 1.0))
    return scaled @ np.linalg.pinv(scaled.T @ scaled, hermitian=True), scale


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCovariance:
    """Covariance of errors by lag on a lattice of cells, and the number of independent ones that it was found from.

    covariance: um2, [2 r + 1, 2 c + 1], variance in the middle, 0 from the distance where it is lost in its scatter.
    n_parameters: of the fit whose residuals these are. resolved: False if they may be correlated over more than the
    area.
    """

    covariance: Floats
    cell_um: float
    independent: float
    n_parameters: int
    resolved: bool = True

    @classmethod
    def of(cls, points: HeightSamples, residuals_um: Floats, pixel_um: float, n_parameters: int) -> ErrorCovariance:
        """Return the covariance of the residuals [n] of a fit to points."""
        side_um = max(float(np.ptp(points.x_um)), float(np.ptp(points.y_um)))
        cell_um = pixel_um * max(1, math.ceil((side_um / pixel_um + 1) / CELLS))
        count, sums = _binned(points.x_um, points.y_um, residuals_um, cell_um)
        full = well_filled(count)
        grid = np.divide(sums, count, out=np.full(sums.shape, np.nan), where=full)
        variance = float(np.nanmean(grid**2))
        if variance == 0:
            return cls(np.zeros((1, 1)), cell_um, float(full.sum()), n_parameters)
        correlation, independent = area_correlation(grid)
        resolved = independent >= RESOLVED or side_um > MOST_PX * pixel_um
        return cls(variance * correlation, cell_um, independent, n_parameters, resolved)

    @property
    def variance_um2(self) -> float:
        """Variance of a single error."""
        return float(self.covariance[tuple(n // 2 for n in self.covariance.shape)])

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the covariance."""
        return max(LEAST_FREEDOM, self.independent - LOST_PER_PARAMETER * self.n_parameters)

    def scatter(self, heights: WeightedHeights) -> Scatter:
        """Return the uncertainty of a weighted sum of heights."""
        return self.scatter_of(self._variance(self._lattice(heights)))

    def scatter_of(self, variance_um2: float) -> Scatter:
        """Return the uncertainty of a sum of heights with a variance by this covariance."""
        variance_um2 = max(0.0, variance_um2) * (self.freedom + self.n_parameters) / self.freedom
        return Scatter((1.0 if self.resolved else UNRESOLVED) * math.sqrt(variance_um2), self.freedom)

    def of_parameters(self, points: HeightSamples, design: Floats) -> Floats:
        """Return the covariance [p, p] of the parameters of a fit of design [n, p] to points."""
        weights, scale = fit_weights(design)
        sums = [self._lattice(WeightedHeights.of(points, column)) for column in weights.T]
        single = np.array([self._variance(one) for one in sums])
        pairs = np.array([[self._variance(one + other) for other in sums] for one in sums])
        return (pairs - single[:, None] - single) / 2 / np.outer(scale, scale)

    def covering(self, points: HeightSamples, design: Floats, residuals_um: Floats) -> ErrorCovariance:
        """Return this covariance, larger where the residuals [n] of a fit of `design` [n, p] are clearly noisier."""
        basis, _ = np.linalg.qr(design)
        taken = sum(self._variance(self._lattice(WeightedHeights.of(points, column))) for column in basis.T)
        expected = self.variance_um2 - taken / len(points)
        found = float(np.mean(residuals_um**2))
        if expected <= 0 or found <= LIKE_ITSELF * expected:
            return self
        return dataclasses.replace(self, covariance=found / expected * self.covariance)

    def _lattice(self, heights: WeightedHeights) -> Floats:
        """Return the sums of weights on the lattice of the covariance, [row, col]."""
        return _binned(heights.x_um, heights.y_um, heights.weight, self.cell_um)[1]

    def _variance(self, weights: Floats) -> float:
        down, across = (min(n // 2, m - 1) for n, m in zip(self.covariance.shape, weights.shape, strict=True))
        middle = [n // 2 for n in self.covariance.shape]
        near = self.covariance[middle[0] - down : middle[0] + down + 1, middle[1] - across : middle[1] + across + 1]
        return float(np.sum(near * lagged_products(weights, (down, across))))


def area_correlation(residuals: Floats) -> tuple[Floats, float]:
    """Return the correlation of errors by lag, and the number of independent ones.

    Parameters
    ----------
    residuals : ndarray
        Residuals of a fit to an area [row, col], NaN where there is none.

    Returns
    -------
    correlation : ndarray
        Correlation at each lag, [2 r + 1, 2 c + 1], 1 in the middle; 0 from the distance where it is lost.
    independent : float
        Number of residuals over their integrated correlation.
    """
    correlation = autocorrelation(residuals)
    down, across = np.indices(correlation.shape) - np.array(correlation.shape)[:, None, None] // 2
    distance = np.rint(np.hypot(down, across)).astype(np.intp)
    known = np.isfinite(correlation)
    sums = np.bincount(distance[known], correlation[known], minlength=distance.max() + 2)
    pairs = np.bincount(distance[known], minlength=distance.max() + 2)
    end = max(1, int(np.argmin(sums > LOST_CORRELATION * pairs)))
    reach = min(end - 1, correlation.shape[0] // 2), min(end - 1, correlation.shape[1] // 2)
    part = tuple(slice(n // 2 - r, n // 2 + r + 1) for n, r in zip(correlation.shape, reach, strict=True))
    kept = np.where((distance < end) & known, correlation, 0.0)[part]
    return kept, float(np.isfinite(residuals).sum()) / max(1.0, float(sums[:end].sum()))


def _binned(x_um: Floats, y_um: Floats, values: Floats, cell_um: float) -> tuple[Floats, Floats]:
    """Return the number of points, and the sums of their values, on a lattice [row, col] of cells."""
    rows = np.floor((y_um.max() - y_um) / cell_um + 0.25).astype(np.intp)
    cols = np.floor((x_um - x_um.min()) / cell_um + 0.25).astype(np.intp)
    shape = int(rows.max()) + 1, int(cols.max()) + 1
    flat = rows * shape[1] + cols
    count = np.bincount(flat, minlength=shape[0] * shape[1]).astype(np.float64)
    sums = np.bincount(flat, values, minlength=shape[0] * shape[1])
    return count.reshape(shape), np.asarray(sums, np.float64).reshape(shape)


@dataclass(frozen=True, slots=True, eq=False)
class FormResiduals:
    """Points of a surface without outliers, and design [n, p] and residuals [n] in um of the form fitted to them."""

    points: HeightSamples
    design: Floats
    residuals_um: Floats

    @classmethod
    def of_plane(cls, points: HeightSamples) -> FormResiduals:
        """Fit a plane. Raises MeasureError when the points do not determine one."""
        plane, fit = fit_plane(points)
        used = points.select(fit.inliers)
        left_um = used.z_um - np.asarray(plane.at(used.x_um, used.y_um))
        return cls(used, plane_design(used, (plane.x_um, plane.y_um)), left_um)

    @classmethod
    def of_plane_or_paraboloid(cls, points: HeightSamples) -> FormResiduals:
        """Fit a plane or, where that leaves form, a paraboloid. Raises MeasureError as `of_plane`."""
        flat = cls.of_plane(points)
        design = paraboloid_design(flat.points, (float(flat.points.x_um.mean()), float(flat.points.y_um.mean())))
        try:
            fit = robust_fit(design, flat.points.z_um)
        except MeasureError:
            return flat
        curved = cls(flat.points.select(fit.inliers), design[fit.inliers], fit.residuals[fit.inliers])
        return curved if CURVED * np.mean(curved.residuals_um**2) < np.mean(flat.residuals_um**2) else flat


def errors_of(
    reading: MeasurementContext,
    level: int,
    parts: Sequence[HeightSamples],
    design: Floats,
    residuals_um: Floats,
    without_form: Callable[[HeightSamples], FormResiduals] = FormResiduals.of_plane,
) -> ErrorCovariance:
    """Return the covariance of the errors of a face: its own or, where it is small, that of what surrounds it.

    parts: measured points of the regions of the face; design [n, p], residuals_um [n]: of the fit to all of them.
    without_form: fit to what surrounds it.
    """
    pixel_um = reading.surface.pixel_um * 2**level
    points, n_parameters = side_by_side(parts), design.shape[1]
    own = ErrorCovariance.of(points, residuals_um, pixel_um, n_parameters)
    sides_um = [max(float(np.ptp(part.x_um)), float(np.ptp(part.y_um))) for part in parts]
    if own.independent >= ENOUGH or max(sides_um) > MOST_PX * pixel_um:
        return own
    around = [found for part in parts if (found := _smooth_around(reading, level, part, without_form)) is not None]
    if not around:
        return own
    wide = ErrorCovariance.of(
        side_by_side([one.points for one in around]),
        np.concatenate([one.residuals_um for one in around]),
        pixel_um,
        sum(one.design.shape[1] for one in around),
    )
    return wide.covering(points, design, residuals_um) if wide.independent > own.independent else own


NOISE_WINDOWS = 5
"""Radius of the area for the noise round a place, in focus windows.

The noise is the scatter about a plane or a paraboloid. Errors are correlated over at least one window, so that a
smaller area would not show them.
"""
CURVED = 2.0
"""Ratio of the scatter about a plane to that about a paraboloid, as variances, from which the ground is curved."""
UNKNOWN_WINDOW = 15
"""Focus window assumed where the surface does not specify one."""
MIN_NOISE_POINTS = 100
"""Smallest number of measured points round a place for its noise."""


def errors_round(reading: MeasurementContext, x_um: float, y_um: float) -> ErrorCovariance | None:
    """Return the covariance of errors round a place, by the scatter about its form; None where too little is measured.

    The form is a plane, or a paraboloid where the ground is clearly curved. Errors that are alike over much of the area
    are few independent ones: the form takes a share of their scatter, and what is left is widened by Student's t.
    Outliers do not count.
    """
    window = reading.surface.provenance.recipe.window
    reach_px = NOISE_WINDOWS * (UNKNOWN_WINDOW if isinstance(window, str) else window)
    near = points_in(reading.surface, Region.circle(x_um, y_um, reach_px * reading.surface.pixel_um), reading.layer, 0)
    if len(near) < MIN_NOISE_POINTS:
        return None
    found = FormResiduals.of_plane_or_paraboloid(near)
    return errors_of(
        reading, 0, (found.points,), found.design, found.residuals_um, FormResiduals.of_plane_or_paraboloid
    )


def side_by_side(parts: Sequence[HeightSamples]) -> HeightSamples:
    """Return the points of several regions moved side by side, so far apart that their errors are taken apart."""
    if len(parts) == 1:
        return parts[0]
    widest_um = max(float(np.ptp(part.x_um)) + float(np.ptp(part.y_um)) for part in parts)
    x_um = [part.x_um - part.x_um.min() + 2 * k * widest_um for k, part in enumerate(parts)]
    y_um = [part.y_um - part.y_um.min() for part in parts]
    return HeightSamples(*(np.concatenate(each) for each in (x_um, y_um, [part.z_um for part in parts])))


def _smooth_around(
    reading: MeasurementContext,
    level: int,
    points: HeightSamples,
    without_form: Callable[[HeightSamples], FormResiduals],
) -> FormResiduals | None:
    """Return the residuals of the smooth surface that continues a region."""
    pixel_um = reading.surface.pixel_um * 2**level
    margin_um = AROUND_PX * pixel_um
    x0, x1, y0, y1 = (float(f(a)) for a in (points.x_um, points.y_um) for f in (np.min, np.max))
    wider = Region.rectangle(x0 - margin_um, y0 - margin_um, x1 + margin_um, y1 + margin_um)
    part = height_window(reading.surface, reading.layer, wider, level)
    rows, cols = np.nonzero(_continued(part, points))
    if len(rows) <= len(points):
        return None
    found = HeightSamples(part.x_um[cols], part.y_um[rows], part.z_um[rows, cols].astype(np.float64))
    try:
        return without_form(found)
    except MeasureError:
        return None


def _continued(part: Heights, points: HeightSamples) -> NDArray[np.bool_]:
    """Return the measured pixels [row, col] of the smooth surface on which most of the points lie.

    It ends where the second difference of the means of neighbouring blocks stands out of all others.
    """
    from scipy.ndimage import label

    z_um = part.z_um.astype(np.float64)
    shape = tuple(-(-n // BLOCK_PX) for n in z_um.shape)
    rows, cols = (np.arange(n) // BLOCK_PX for n in z_um.shape)
    block = rows[:, None] * shape[1] + cols
    measured = np.isfinite(z_um)
    count = np.bincount(block[measured], minlength=shape[0] * shape[1]).reshape(shape)
    sums = np.bincount(block[measured], z_um[measured], minlength=shape[0] * shape[1]).reshape(shape)
    means = np.divide(sums, count, out=np.full(shape, np.nan), where=count > 0)
    bends = [np.abs(np.diff(np.pad(means, pad, mode="edge"), 2, axis=axis)) for axis, pad in enumerate(PADS)]
    known = np.concatenate([bend[np.isfinite(bend)] for bend in bends])
    if not len(known):
        return np.zeros(z_um.shape, bool)
    limit_um = EDGE_SIGMAS * MAD_TO_SIGMA * max(float(np.median(known)), float(np.spacing(np.float32(sums.max()))))
    smooth = (count > 0) & ~(np.nan_to_num(bends[0]) > limit_um) & ~(np.nan_to_num(bends[1]) > limit_um)
    labels = np.zeros(shape, np.int32)
    label(smooth, output=labels)
    at_rows = np.rint((part.y0_um - points.y_um) / part.pixel_um).astype(np.intp) // BLOCK_PX
    at_cols = np.rint((points.x_um - part.x0_um) / part.pixel_um).astype(np.intp) // BLOCK_PX
    votes = np.bincount(labels[at_rows, at_cols], minlength=2)
    votes[0] = 0
    return measured & (labels == int(votes.argmax()))[rows[:, None], cols] & bool(votes.any())
