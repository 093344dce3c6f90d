"""Edges of steps: within half a window of a jump, a height may belong to the other side.

A window across a jump sees the focus of both sides, and the sharper side wins, independent of the position of the jump.
Where a silhouette separates the sides their heights are tested against them; this module handles jumps without one.

The light of a defocused bright line ends in a disc, whose rim looks sharp everywhere: it creates a surface that falls
away from the line as steeply as the aperture is wide. That is a jump within the window too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.filters.sliding_filters import doubled, highest, lowest

JUMP_STEPS = 2.0
"""Difference between two surfaces a few pixels apart, in steps of the resolution."""

_BEYOND_UM = np.float32(1e9)


def height_range_um(z_um: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Return the height range within about half a window of each pixel; at most 0 where there are none.

    z_um: [row, col], NaN where unmeasured. Evaluated for 2 x 2 pixels together. At the border of the field the range is
    taken within a full window, because heights cut off by the border are missing, and a slope must not look flatter
    there.
    """
    reach = window // 4
    high = highest(_of_cells(np.where(np.isnan(z_um), -_BEYOND_UM, z_um), np.maximum), 2 * reach + 1)
    low = lowest(_of_cells(np.where(np.isnan(z_um), _BEYOND_UM, z_um), np.minimum), 2 * reach + 1)
    return doubled(_whole_windows(high - low, reach), z_um.shape)


def _whole_windows(plane: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Replace border values by those of the nearest window inside; unchanged if none fits."""
    if min(plane.shape) <= 2 * reach or not reach:
        return plane
    return np.pad(plane[reach:-reach, reach:-reach], reach, mode="edge")


def _of_cells(plane: NDArray[np.float32], choose: np.ufunc) -> NDArray[np.float32]:
    """Reduce 2 x 2 pixels to one value; at an odd border the edge pixels repeat."""
    rows, cols = plane.shape
    padded = np.pad(plane, ((0, rows % 2), (0, cols % 2)), mode="edge") if rows % 2 or cols % 2 else plane
    tall = choose(padded[::2], padded[1::2])
    return np.asarray(choose(tall[:, ::2], tall[:, 1::2]), np.float32)
