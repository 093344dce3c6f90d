"""Hills and dales of a surface by watersheds and Wolf pruning, and the feature parameters of ISO 25178-2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats

PRUNED = 0.05
"""Wolf pruning: height of a hill over its highest saddle, as a fraction of Sz, below which it is no hill of its own."""
EXTREMES = 5
"""Number of peaks of S5p, and of pits of S5v."""
CURVATURE = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12
"""Weights of the second derivative through five points, exact for polynomials of order 5."""


@dataclass(frozen=True, slots=True)
class Peaks:
    """Peaks after pruning, those at the border and beside holes left out: rows and columns [n], heights in um [n]."""

    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    height_um: Floats


def peaks_of(z_um: Floats, least_um: float) -> Peaks:
    """Return the peaks of heights [row, col] whose hills are at least so high over their highest saddle.

    Hills that are lower are merged with the neighbour across that saddle (Wolf pruning of the change tree of ISO
    25178-2). A peak at the border or beside an unmeasured pixel is not known to be one.
    """
    from scipy.ndimage import binary_erosion, label, maximum_position
    from skimage.morphology import local_maxima, reconstruction

    valid = np.isfinite(z_um)
    ground = float(z_um[valid].min()) - 2 * least_um - 1.0
    surface = np.where(valid, z_um, ground)
    flooded = reconstruction(surface - least_um, surface)
    labelled: Any = label(local_maxima(flooded) & valid, np.ones((3, 3)))
    hills, n = labelled
    places = np.array(maximum_position(surface, hills, np.arange(1, n + 1)), np.intp).reshape(-1, 2)
    inside = np.asarray(binary_erosion(valid, np.ones((3, 3))), bool)[places[:, 0], places[:, 1]]
    rows, cols = places[inside].T
    return Peaks(rows, cols, z_um[rows, cols])


def five_heights(z_um: Floats, least: int = EXTREMES) -> dict[str, float]:
    """Return S5p, S5v and S10z in um of heights [row, col] with mean 0; those with fewer than `least` are left out."""
    least_um = PRUNED * float(np.ptp(z_um[np.isfinite(z_um)]))
    found = {
        name: float(np.sort(heights)[-EXTREMES:].mean())
        for name, heights in (("s5p", peaks_of(z_um, least_um).height_um), ("s5v", peaks_of(-z_um, least_um).height_um))
        if len(heights) >= least
    }
    return {**found, "s10z": found["s5p"] + found["s5v"]} if len(found) == 2 else found


def peak_numbers(z_um: Floats, pixel_um: float) -> dict[str, float | None]:
    """Return the density Spd of the peaks of heights [row, col], 1/mm², and their mean curvature Spc, 1/mm."""
    valid = np.isfinite(z_um)
    peaks = peaks_of(z_um, PRUNED * float(np.ptp(z_um[valid])))
    area_mm2 = np.count_nonzero(valid) * float(pixel_um / 1000) ** 2
    curvatures = _curvatures(z_um, peaks) / pixel_um**2
    return {
        "spd_per_mm2": float(len(peaks.rows) / area_mm2),
        "spc_per_mm": 1000 * float(curvatures.mean()) if curvatures.size else None,
    }


def _curvatures(z_um: Floats, peaks: Peaks) -> Floats:
    """Return the mean curvature of each peak per pixel squared, of those with all points that it needs."""
    reach = len(CURVATURE) // 2
    wide = np.pad(z_um, reach, constant_values=np.nan)
    steps = np.arange(len(CURVATURE))
    down = wide[peaks.rows[:, None] + steps, peaks.cols[:, None] + reach] @ CURVATURE
    across = wide[peaks.rows[:, None] + reach, peaks.cols[:, None] + steps] @ CURVATURE
    curvatures = -(down + across) / 2
    return curvatures[np.isfinite(curvatures)]
