"""Comparison of heights with a known truth: the figures of the paper's evaluation, eq. 17-19, and completeness.

An error over all pixels rewards omission of the difficult ones, so completeness and the fraction of false heights are
reported too. A height is *false* when it is off by more than a tolerance, by default a z step of the scan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.height_map import HeightMap

Heights = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Quality:
    """Agreement of heights with their truth. Without a pixel that has both, all but completeness is NaN.

    rmse_um: eq. 17; corr: eq. 18; psnr_db: 20 log10(peak_um / rmse_um), with the range of the truth as default peak;
    bias_um: median error; ssm_um2: smoothness of the heights, eq. 19; completeness_fraction: fraction of the pixels
    with a truth that have a height; false_fraction: fraction of those that are off by more than tolerance_um;
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


def compare_with_truth(
    height: HeightMap,
    truth_um: Heights,
    tolerance_um: float | None = None,
    peak_um: float | None = None,
    count_filled: bool = False,
) -> Quality:
    """Compare a height map with the true heights on its lattice.

    By default the measured heights are compared: gated and unsmoothed, unless the recipe of the map says otherwise.

    Parameters
    ----------
    height : HeightMap
        The heights to evaluate, in um.
    truth_um : ndarray of float32 or float64, shape (rows, cols)
        True heights in um on the lattice of `height`; NaN where no truth is known.
    tolerance_um : float, optional
        Largest error of a true height, um; a height that is off by more is false. By default the z step of the scan,
        from the provenance of `height`.
    peak_um : float, optional
        Peak of the PSNR, um. By default the range of the known truth.
    count_filled : bool, default False
        Compare the filtered heights with their filled pixels instead of the measured ones.

    Returns
    -------
    Quality
        RMSE, correlation, PSNR (dB), median error and smoothness of the heights, with the fractions of complete and of
        false heights. Without a pixel that has both height and truth, the error figures are NaN.

    Raises
    ------
    MeasureError
        If the shapes of the heights and the truth differ, or the tolerance is not above 0, as by default where the z
        step is unknown.

    Notes
    -----
    An error over all pixels rewards omission of the difficult ones, so completeness and the fraction of false heights
    are reported too. The smoothness has a factor of 2 for its last term, as printed in eq. 19; the usual quadratic
    variation has 1 there.

    References
    ----------
    The paper on shape from focus that the method comes from (see the glossary), eq. 17 (RMSE), 18 (correlation) and 19
    (smoothness).
    """
    tolerance = height.provenance.z_step_um if tolerance_um is None else tolerance_um
    return quality(height.to_measure(count_filled), truth_um, tolerance, peak_um)


def quality(z_um: Heights, truth_um: Heights, tolerance_um: float, peak_um: float | None = None) -> Quality:
    """Compare plain arrays [row, col] in um; NaN is unmeasured, or without a truth.

    Raises MeasureError when the shapes differ or the tolerance is not above 0.
    """
    _check(z_um, truth_um, tolerance_um)
    finite = np.isfinite(truth_um)
    both = finite & np.isfinite(z_um)
    z, truth = z_um[both].astype(np.float64), truth_um[both].astype(np.float64)
    error = z - truth
    peak = _range(truth_um[finite]) if peak_um is None else peak_um
    return Quality(
        rmse_um=rmse(error),
        corr=correlation(z, truth),
        psnr_db=psnr(error, peak),
        peak_um=peak,
        bias_um=_median(error),
        ssm_um2=smoothness(np.where(finite, z_um, np.nan)),
        completeness_fraction=_share(both.sum(), finite.sum()),
        false_fraction=_share((np.abs(error) > tolerance_um).sum(), error.size),
        true_rmse_um=rmse(error[np.abs(error) <= tolerance_um]),
        tolerance_um=tolerance_um,
        n_px=int(finite.sum()),
    )


def rmse(error_um: Heights) -> float:
    """Return the root mean square of errors in um, eq. 17; NaN without any."""
    from skimage.metrics import mean_squared_error

    return math.sqrt(mean_squared_error(error_um, np.zeros_like(error_um))) if error_um.size else math.nan


def correlation(z_um: Heights, truth_um: Heights) -> float:
    """Return Pearson's correlation of heights with their truth, eq. 18; NaN where either is constant."""
    from skimage.measure import pearson_corr_coeff

    if z_um.size < 2 or np.ptp(z_um) == 0 or np.ptp(truth_um) == 0:
        return math.nan
    return float(pearson_corr_coeff(z_um, truth_um)[0])


def psnr(error_um: Heights, peak_um: float) -> float:
    """Return the peak signal-to-noise ratio, 20 log10(peak / RMSE) in dB; infinite without an error."""
    from skimage.metrics import peak_signal_noise_ratio

    if not error_um.any():
        return math.nan if not error_um.size else math.inf
    return peak_signal_noise_ratio(np.zeros_like(error_um), error_um, data_range=peak_um) if peak_um > 0 else math.nan


def smoothness(z_um: Heights) -> float:
    """Return SSM, eq. 19: mean of z_xx^2 + 2 z_xy^2 + 2 z_yy^2 in um^2; x by row index, y by column index.

    Evaluated where all nine heights about a pixel are known; lower is smoother. The second 2 is as printed in the
    equation; the usual quadratic variation has 1 there.
    """
    squares = squared_bending(z_um)
    return float(squares.mean()) if squares.size else float("nan")


def squared_bending(z_um: Heights) -> Floats:
    """Return the terms of eq. 19, um^2, of the pixels with all nine heights about them, of which SSM is the mean."""
    if min(z_um.shape) < 3:
        return np.empty(0)
    z = z_um.astype(np.float64)
    middle = z[1:-1, 1:-1]
    xx = z[2:, 1:-1] - 2 * middle + z[:-2, 1:-1]
    yy = z[1:-1, 2:] - 2 * middle + z[1:-1, :-2]
    xy = z[2:, 2:] - z[1:-1, 2:] - z[2:, 1:-1] + middle
    bending = xx**2 + 2 * xy**2 + 2 * yy**2
    return bending[np.isfinite(bending)]


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


def _share(part: int | np.intp, total: int | np.intp) -> float:
    return float(part) / float(total) if total else float("nan")
