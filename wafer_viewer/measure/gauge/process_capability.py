"""Capability of a process against its limits, from values of many parts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from wafer_viewer.measure.gauge.gauge_studies import CONFIDENCE
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import Interval, ProcessCapability

LEAST_PARTS = 2
"""Smallest number of values with a standard deviation."""


def process_capability(
    values: ArrayLike, *, lower: float | None = None, upper: float | None = None
) -> ProcessCapability:
    """Compare the spread of a process with its limits: Cp and Cpk.

    Parameters
    ----------
    values : array_like of float, shape (n,)
        Values of parts, in any one unit.
    lower, upper : float, optional
        Limits in the unit of `values`; by default that side is open, and at least one is given.

    Returns
    -------
    ProcessCapability
        Mean and standard deviation in the unit of `values`; Cp, None with one limit; Cpk; their two-sided 95 %
        confidence limits; the number of values beyond the limits, and the share that a normal distribution expects
        there.

    Raises
    ------
    MeasureError
        If there are fewer than two values, one is not finite, all are equal, no limit is given, or the lower limit is
        not below the upper one.

    Notes
    -----
    The standard deviation is that of all values, as of Pp and Ppk: it contains the drift between lots. Limits of Cp are
    those of chi-squared, those of Cpk the normal approximation of Bissell. Values are as measured: the gauge's own
    spread is in them.

    References
    ----------
    ISO 22514-2; A. F. Bissell: How reliable is your capability index?, Applied Statistics 39, 1990.
    """
    x = np.asarray(values, float).ravel()
    _require(x, lower, upper)
    mean, s, n = float(x.mean()), float(x.std(ddof=1)), len(x)
    low, high = -math.inf if lower is None else lower, math.inf if upper is None else upper
    cp = (high - low) / (6 * s) if lower is not None and upper is not None else None
    cpk = min(high - mean, mean - low) / (3 * s)
    tail = (1 - CONFIDENCE) / 2
    quantiles = [math.sqrt(2 * float(special.gammaincinv((n - 1) / 2, q)) / (n - 1)) for q in (tail, 1 - tail)]
    off = float(special.ndtri(1 - tail)) * math.sqrt(1 / (9 * n) + cpk**2 / (2 * (n - 1)))
    expected = special.ndtr((mean - high) / s) + special.ndtr((low - mean) / s)
    return ProcessCapability(
        n=n,
        mean=mean,
        s=s,
        lower=lower,
        upper=upper,
        cp=cp,
        cp_limits=None if cp is None else Interval(low=cp * quantiles[0], high=cp * quantiles[1]),
        cpk=cpk,
        cpk_limits=(cpk - off, cpk + off),
        beyond=int(np.count_nonzero((x < low) | (x > high))),
        expected_beyond=float(expected),
    )


def _require(x: np.ndarray, lower: float | None, upper: float | None) -> None:
    if lower is None and upper is None:
        raise MeasureError("There is no limit to compare with: give a lower or an upper limit.")
    if lower is not None and upper is not None and lower >= upper:
        raise MeasureError(f"The lower limit is {lower:g} and the upper one {upper:g}: give the smaller one as lower.")
    if len(x) < LEAST_PARTS:
        raise MeasureError(f"There are {len(x)} values: a capability takes {LEAST_PARTS} parts at least.")
    if not np.isfinite(x).all():
        raise MeasureError(f"Value {int(np.argmin(np.isfinite(x))) + 1} is not a number: leave the part out.")
    if np.ptp(x) == 0:
        raise MeasureError("All values are the same: the instrument rounds, or one part was measured several times.")
