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
class HillTops:
    """Peaks after pruning, those at the border and beside holes left out: rows and columns [n], heights in um [n]."""

    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    height_um: Floats


def peaks_of(z_um: Floats, least_um: float) -> HillTops:
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
    return HillTops(rows, cols, z_um[rows, cols])


def peaks_and_pits(z_um: Floats) -> tuple[HillTops, HillTops]:
    """Return the peaks of heights [row, col], and those of the surface turned over, after pruning of 5 % of Sz."""
    least_um = PRUNED * float(np.ptp(z_um[np.isfinite(z_um)]))
    return peaks_of(z_um, least_um), peaks_of(-z_um, least_um)


def five_heights(peaks: HillTops, pits: HillTops, least: int = EXTREMES) -> dict[str, float]:
    """Return S5p, S5v and S10z in um of a surface with mean 0; those with fewer than `least` are left out."""
    found = {
        name: float(np.sort(tops.height_um)[-EXTREMES:].mean())
        for name, tops in (("s5p", peaks), ("s5v", pits))
        if len(tops.height_um) >= least
    }
    return {**found, "s10z": found["s5p"] + found["s5v"]} if len(found) == 2 else found


def peak_numbers(z_um: Floats, peaks: HillTops, pixel_um: float) -> dict[str, Any]:
    """Return the density Spd of the peaks of heights [row, col], 1/mm², and their mean curvature Spc, 1/mm."""
    area_mm2 = np.count_nonzero(np.isfinite(z_um)) * float(pixel_um / 1000) ** 2
    curvatures = _curvatures(z_um, peaks) / pixel_um**2
    return {
        "spd_per_mm2": float(len(peaks.rows) / area_mm2),
        "spc_per_mm": 1000 * float(curvatures.mean()) if curvatures.size else None,
    }


def _curvatures(z_um: Floats, peaks: HillTops) -> Floats:
    """Return the mean curvature of each peak per pixel squared, of those with all points that it needs."""
    reach = len(CURVATURE) // 2
    wide = np.pad(z_um, reach, constant_values=np.nan)
    steps = np.arange(len(CURVATURE))
    down = wide[peaks.rows[:, None] + steps, peaks.cols[:, None] + reach] @ CURVATURE
    across = wide[peaks.rows[:, None] + reach, peaks.cols[:, None] + steps] @ CURVATURE
    curvatures = -(down + across) / 2
    return curvatures[np.isfinite(curvatures)]
