"""Focus of a whole frame: one number that is largest where most of its structure is sharp."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float64s, Greys, lean_kernel


def frame_focus(image: NDArray[np.uint8] | NDArray[np.uint16]) -> float:
    """Return the Tenengrad of a frame: the mean energy of its Sobel gradients over its squared mean grey.

    Parameters
    ----------
    image : uint8 or uint16 [row, col]
        Frame of at least 3 by 3 pixels.

    Returns
    -------
    float
        Focus, independent of exposure and bit depth; 0 for a black frame. Camera noise adds a constant to it.

    Notes
    -----
    It is the measure ``tenengrad`` of the reconstruction with a window of the whole frame. Under a Gaussian blur of
    variance v the energy of white texture goes as 1 / v^2.

    References
    ----------
    J. M. Tenenbaum, "Accommodation in computer vision", PhD thesis, Stanford University, 1970.
    """
    sums = np.zeros(2)
    _add_up(image, sums)
    n_inner = (image.shape[0] - 2) * (image.shape[1] - 2)
    mean = sums[1] / n_inner
    return float(sums[0] / n_inner / mean**2) if mean > 0 else 0.0


@lean_kernel
def _add_up(image: Greys, sums: Float64s) -> None:
    """Add up the energy of the Sobel gradients, and the grey values, without the image's border."""
    rows, cols = image.shape
    for r in range(1, rows - 1):
        energy, grey = np.int64(0), np.int64(0)
        for c in range(1, cols - 1):
            nw, n, ne = np.int64(image[r - 1, c - 1]), np.int64(image[r - 1, c]), np.int64(image[r - 1, c + 1])
            w, e = np.int64(image[r, c - 1]), np.int64(image[r, c + 1])
            sw, s, se = np.int64(image[r + 1, c - 1]), np.int64(image[r + 1, c]), np.int64(image[r + 1, c + 1])
            across = ne + 2 * e + se - nw - 2 * w - sw
            down = sw + 2 * s + se - nw - 2 * n - ne
            energy += across * across + down * down
            grey += np.int64(image[r, c])
        sums[0] += energy
        sums[1] += grey
