"""How far heights are from a truth that is known: the figures of the paper's evaluation, eq. 17-19, and honest ones.

An error over all pixels rewards leaving out the hard ones, so completeness and the share of false heights stand beside
it. A height is *false* when it is more than a tolerance off, a step of the sweep as a rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.height_map import HeightMap

DISTANCES_PX = (0.0, 2.0, 5.0, 10.0, 20.0, np.inf)
"""Bands of distance from an edge."""

Heights = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Quality:
    """Heights against their truth. Without a pixel that has both, all but completeness is NaN.

    rmse_um: eq. 17; corr: eq. 18; psnr_db: 20 log10(peak_um / rmse_um), the peak being the range of the truth unless
    another is given; bias_um: median error; ssm_um2: smoothness of the heights, eq. 19; completeness_fraction: of the
    pixels with a truth, those with a height; false_fraction: of those, the ones more than tolerance_um off;
    true_rmse_um: eq. 17 over the others; n_px: pixels with a truth.
    """

    rmse_um: float
    corr: float
    psnr_db: float
    peak_um: float
    bias_um: float
    ssm_um2: float
    completeness_fraction: float
    false_fraction: float
    true_rmse_um: float
    tolerance_um: float
    n_px: int


@dataclass(frozen=True, slots=True)
class ErrorBand:
    """The errors of the pixels between two distances from an edge; see `Quality`."""

    from_px: float
    to_px: float
    completeness_fraction: float
    false_fraction: float
    rmse_um: float
    bias_um: float
    n_px: int


def compare_with_truth(
    height: HeightMap,
    truth_um: Heights,
    tolerance_um: float | None = None,
    peak_um: float | None = None,
    count_filled: bool = False,
) -> Quality:
    """How far a height map is from the truth on its lattice [row, col] in um, NaN where no truth is known.

    What measurements use is compared: the measured heights as a rule; count_filled: the filtered ones with their
    filled pixels. tolerance_um: a step of the sweep when left out. Raises MeasureError for another shape.
    """
    tolerance = height.provenance.z_step_um if tolerance_um is None else tolerance_um
    return quality(height.to_measure(count_filled), truth_um, tolerance, peak_um)


def quality(z_um: Heights, truth_um: Heights, tolerance_um: float, peak_um: float | None = None) -> Quality:
    """The same for plain arrays [row, col] in um; NaN is unmeasured, or without a truth.

    Raises MeasureError when the shapes differ or the tolerance is not above 0.
    """
    _check(z_um, truth_um, tolerance_um)
    known = np.isfinite(truth_um)
    both = known & np.isfinite(z_um)
    z, truth = z_um[both].astype(np.float64), truth_um[both].astype(np.float64)
    error = z - truth
    peak = _range(truth_um[known]) if peak_um is None else peak_um
    return Quality(
        rmse_um=rmse(error),
        corr=correlation(z, truth),
        psnr_db=psnr(error, peak),
        peak_um=peak,
        bias_um=_median(error),
        ssm_um2=smoothness(np.where(known, z_um, np.nan)),
        completeness_fraction=_share(both.sum(), known.sum()),
        false_fraction=_share((np.abs(error) > tolerance_um).sum(), error.size),
        true_rmse_um=rmse(error[np.abs(error) <= tolerance_um]),
        tolerance_um=tolerance_um,
        n_px=int(known.sum()),
    )


def error_by_distance(
    z_um: Heights,
    truth_um: Heights,
    distance_px: Heights,
    tolerance_um: float,
    bounds_px: Sequence[float] = DISTANCES_PX,
) -> tuple[ErrorBand, ...]:
    """The errors in bands of distance from the nearest edge, arrays [row, col]; a band holds its lower bound.

    Raises MeasureError when the shapes differ or the tolerance is not above 0.
    """
    _check(z_um, truth_um, tolerance_um)
    _check(distance_px, truth_um, tolerance_um)
    return tuple(
        _band(z_um, truth_um, (distance_px >= low) & (distance_px < high), (low, high), tolerance_um)
        for low, high in pairwise(bounds_px)
    )


def rmse(error_um: Heights) -> float:
    """Root mean square of errors in um, eq. 17; NaN without any."""
    return float(np.sqrt(np.mean(np.square(error_um)))) if error_um.size else float("nan")


def correlation(z_um: Heights, truth_um: Heights) -> float:
    """Pearson's correlation of heights with their truth, eq. 18; NaN where either is constant."""
    if not z_um.size:
        return float("nan")
    z, truth = z_um - z_um.mean(), truth_um - truth_um.mean()
    spread = float(np.sqrt(np.sum(z * z) * np.sum(truth * truth)))
    return float(np.sum(z * truth)) / spread if spread > 0 else float("nan")


def psnr(error_um: Heights, peak_um: float) -> float:
    """Peak signal to noise, 20 log10(peak / RMSE) in dB; infinite without an error."""
    noise_um = rmse(error_um)
    if noise_um == 0:
        return float("inf")
    return 20 * float(np.log10(peak_um / noise_um)) if peak_um > 0 else float("nan")


def smoothness(z_um: Heights) -> float:
    """SSM, eq. 19: the mean of z_xx^2 + 2 z_xy^2 + 2 z_yy^2 in um^2, x along the rows' number, y along the columns'.

    Taken where all nine heights about a pixel are known; the lower, the smoother. The second 2 is as the equation is
    printed; the usual quadratic variation has 1 there.
    """
    if min(z_um.shape) < 3:
        return float("nan")
    z = z_um.astype(np.float64)
    middle = z[1:-1, 1:-1]
    xx = z[2:, 1:-1] - 2 * middle + z[:-2, 1:-1]
    yy = z[1:-1, 2:] - 2 * middle + z[1:-1, :-2]
    xy = z[2:, 2:] - z[1:-1, 2:] - z[2:, 1:-1] + middle
    bending = xx**2 + 2 * xy**2 + 2 * yy**2
    known = np.isfinite(bending)
    return float(bending[known].mean()) if known.any() else float("nan")


def _band(
    z_um: Heights, truth_um: Heights, band: NDArray[np.bool_], bounds_px: tuple[float, float], tolerance_um: float
) -> ErrorBand:
    known = band & np.isfinite(truth_um)
    error: Floats = (z_um[known] - truth_um[known]).astype(np.float64)
    error = error[np.isfinite(error)]
    return ErrorBand(
        from_px=bounds_px[0],
        to_px=bounds_px[1],
        completeness_fraction=_share(error.size, known.sum()),
        false_fraction=_share((np.abs(error) > tolerance_um).sum(), error.size),
        rmse_um=rmse(error),
        bias_um=_median(error),
        n_px=int(known.sum()),
    )


def _check(z_um: Heights, truth_um: Heights, tolerance_um: float) -> None:
    if z_um.shape != truth_um.shape or z_um.ndim != 2:
        raise MeasureError(
            f"Heights of shape {z_um.shape} cannot be compared with a truth of shape {truth_um.shape}: "
            "both need the same rows and columns."
        )
    if not tolerance_um > 0:
        raise MeasureError(f"The tolerance is {tolerance_um} um: give one above 0, a step of the sweep as a rule.")


def _median(error_um: Heights) -> float:
    return float(np.median(error_um)) if error_um.size else float("nan")


def _range(heights_um: Heights) -> float:
    return float(np.ptp(heights_um)) if heights_um.size else float("nan")


def _share(part: int | np.intp, whole: int | np.intp) -> float:
    return float(part) / float(whole) if whole else float("nan")
