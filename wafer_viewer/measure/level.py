"""A robust plane through part of a surface: what measurements level on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
MAD_TO_SIGMA = 1.4826
REJECT_SIGMA = 3.0
ROUNDS = 20
EXACT = 1e-6
"""Residuals under this share of the largest value are rounding of 32-bit heights, not noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A linear fit: coefficients [n] of the columns of its design, residuals and kept flags [points]."""

    coefficients: Values
    residuals: Values
    kept: NDArray[np.bool_]


def robust_fit(design: Values, values: Values) -> Fit:
    """Least squares of `values` [points] on `design` [points, n], repeated without what lies beyond 3 MAD.

    The rejection ends when it drops and takes back nothing more. Exact data keep all their points.
    """
    kept = np.ones(len(values), bool)
    rounding = EXACT * float(np.abs(values).max())
    coefficients, residuals = _solve(design, values, kept)
    for _ in range(ROUNDS):
        spread = MAD_TO_SIGMA * float(np.median(np.abs(residuals[kept] - np.median(residuals[kept]))))
        inside = np.abs(residuals) <= max(REJECT_SIGMA * spread, rounding)
        if np.count_nonzero(inside) < design.shape[1] or np.array_equal(inside, kept):
            break
        kept = inside
        coefficients, residuals = _solve(design, values, kept)
    return Fit(coefficients, residuals, kept)


def fit_plane(x_um: Values, y_um: Values, z_um: Values) -> Fit:
    """The robust plane z = a x + b y + c through points [n]; coefficients (a, b, c)."""
    return robust_fit(np.column_stack([x_um, y_um, np.ones_like(x_um)]), z_um)


def _solve(design: Values, values: Values, kept: NDArray[np.bool_]) -> tuple[Values, Values]:
    """Normal equations: a handful of columns over a million points, scaled so that they stay well conditioned."""
    scale = np.maximum(np.abs(design).max(axis=0), 1e-300)
    scaled = design / scale
    part = scaled[kept]
    solution = np.linalg.lstsq(part.T @ part, part.T @ values[kept], rcond=None)[0]
    return solution / scale, values - scaled @ solution
