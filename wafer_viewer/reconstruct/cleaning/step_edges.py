"""The edges of steps: within half a window from a jump of the surface, a height may be that of the other side.

A window that lies across a jump sees the focus of both sides, and the sharper side wins, wherever the jump itself is.
Where a silhouette tells the sides apart their heights are held to them; here is what to do where none does.

The light of a bright line that is out of focus ends in a disc, whose rim looks sharp wherever it passes: it makes a
surface that falls away from the line as steeply as the aperture is wide. That is a jump within the window too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.filters.sliding_filters import doubled, highest, lowest

JUMP_STEPS = 2.0
"""Heights that differ by more than so many steps of the resolution, a few pixels apart, are two surfaces."""

_BEYOND_UM = np.float32(1e9)


def apart_um(z_um: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """How far apart the heights within about half a window from each pixel are; at most 0 where there are none.

    z_um: [row, col], NaN where unmeasured. Judged for 2 x 2 pixels together. At the border of the field those within a
    whole window count: what the border cuts off is not seen, and a slope must not look flatter for that.
    """
    reach = window // 4
    high = highest(_of_cells(np.where(np.isnan(z_um), -_BEYOND_UM, z_um), np.maximum), 2 * reach + 1)
    low = lowest(_of_cells(np.where(np.isnan(z_um), _BEYOND_UM, z_um), np.minimum), 2 * reach + 1)
    return doubled(_whole_windows(high - low, reach), z_um.shape)


def _whole_windows(plane: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """At the border, what the nearest window shows that lies wholly inside; as it is where none does."""
    if min(plane.shape) <= 2 * reach or not reach:
        return plane
    return np.pad(plane[reach:-reach, reach:-reach], reach, mode="edge")


def _of_cells(plane: NDArray[np.float32], choose: np.ufunc) -> NDArray[np.float32]:
    """One value for 2 x 2 pixels; at an odd border of what there is."""
    rows, cols = plane.shape
    padded = np.pad(plane, ((0, rows % 2), (0, cols % 2)), mode="edge") if rows % 2 or cols % 2 else plane
    tall = choose(padded[::2], padded[1::2])
    return np.asarray(choose(tall[:, ::2], tall[:, 1::2]), np.float32)
