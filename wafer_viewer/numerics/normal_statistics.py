"""Constants of the normal distribution that robust statistics take."""

from __future__ import annotations

MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of normal values."""
HALF_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a normal variable of standard deviation 1."""
TWO_SIGMA_QUANTILE = 0.97725
"""Probability of a normal variable below two standard deviations: both sides together leave 95.45 %."""
