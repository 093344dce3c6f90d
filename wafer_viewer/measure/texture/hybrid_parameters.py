"""Hybrid parameters of ISO 25178-2, Sdq and Sdr, between neighbouring measured pixels only."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats


def root_mean_square_gradient(z_um: Floats, pixel_um: float) -> float | None:
    """Return Sdq of z [row, col] by forward differences along rows and columns; None if there are none.

    Same as in Gwyddion and SurfaceTopography. The standard defines an integral and does not specify its sampling.
    """
    squares = [np.diff(z_um, axis=axis) ** 2 for axis in (0, 1)]
    if not all(np.isfinite(square).any() for square in squares):
        return None
    return float(np.sqrt(sum(np.nanmean(square) for square in squares))) / pixel_um


def developed_fraction(z_um: Floats, pixel_um: float) -> float | None:
    """Return Sdr as a fraction: excess of the developed area over the projected one; None without any square.

    Each square of four measured pixels is divided into four triangles that meet at its centre, at the mean of the four
    heights.
    """
    a, b, c, d = z_um[:-1, :-1], z_um[:-1, 1:], z_um[1:, 1:], z_um[1:, :-1]
    middle = (a + b + c + d) / 4
    ratio = sum(_triangle(one - middle, other - middle, pixel_um) for one, other in ((a, b), (b, c), (c, d), (d, a)))
    known = np.isfinite(middle)
    return float(np.mean(np.asarray(ratio)[known])) / 4 - 1 if known.any() else None


def _triangle(one: Floats, other: Floats, pixel_um: float) -> Floats:
    """Return area over projected area of a triangle from a square's centre to two corners, by relative heights.

    Its slopes are (other - one) along the side and (one + other) across it, per pixel.
    """
    return np.sqrt(1 + ((other - one) ** 2 + (one + other) ** 2) / pixel_um**2)
