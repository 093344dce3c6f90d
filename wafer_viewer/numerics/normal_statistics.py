"""Constants of the normal distribution that robust statistics take, and means with their uncertainty."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.quantity import coverage_factor

MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of normal values."""
HALF_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a normal variable of standard deviation 1."""


def median(values: NDArray[np.floating]) -> float:
    """Return the median of at least one value, none of them NaN: for few values a third of numpy's time."""
    half = values.size // 2
    ordered = np.partition(values.ravel(), half)
    middle = float(ordered[half])
    return middle if values.size % 2 else (middle + float(ordered[:half].max())) / 2


def u_of_mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the standard uncertainty of the mean along the first axis, for few values widened by Student's t."""
    scatter = np.asarray(values, np.float64).std(axis=0, ddof=1)
    widened: NDArray[np.float64] = coverage_factor(len(values) - 1) / 2 / math.sqrt(len(values)) * scatter
    return widened
