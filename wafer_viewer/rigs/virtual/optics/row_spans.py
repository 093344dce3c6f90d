"""Short stretches of each row of a frame, with properties common to all their pixels.

Most stretches see one sheet only, at nearly one height, and knowing this in advance saves most of a frame's work.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from wafer_viewer.rigs.virtual.optics.gaussian_blur import Plane
from wafer_viewer.rigs.virtual.scenes.catalogue import SceneWindow

STRETCH_PX = 48
BLOCK = 4  # lattice samples along a side of a block that is wholly A, wholly B or mixed
NOWHERE_PX = 1e6


class Stretches(NamedTuple):
    """float32 [row, stretch] each: height range of each sheet in um, distance in px to the nearest point of each."""

    lowest_a: Plane
    highest_a: Plane
    lowest_b: Plane
    highest_b: Plane
    to_a_px: Plane
    to_b_px: Plane


def make_stretches(
    frame: SceneWindow, height_a: Plane, height_b: Plane, lattice: SceneWindow, cover: Plane
) -> Stretches:
    """Return the stretches of a frame; `cover` is on the lattice, which extends beyond the frame."""
    blocks = cover.reshape(lattice.rows // BLOCK, BLOCK, lattice.cols // BLOCK, BLOCK)
    some_a, some_b = blocks.max((1, 3)) > 0.001, blocks.min((1, 3)) < 0.999
    block_px = BLOCK * round(lattice.step_um / frame.step_um)
    return Stretches(
        *extremes(height_a),
        *extremes(height_b),
        nearest(distance_px(some_a, block_px), frame, lattice, block_px),
        nearest(distance_px(some_b, block_px), frame, lattice, block_px),
    )


def extremes(height: Plane) -> tuple[Plane, Plane]:
    """Return the least and the greatest value of every stretch of a plane."""
    rows, cols = height.shape
    padded = np.pad(height, ((0, 0), (0, -cols % STRETCH_PX)), mode="edge").reshape(rows, -1, STRETCH_PX)
    return padded.min(2), padded.max(2)


def distance_px(there: NDArray[np.bool_], block_px: int) -> Plane:
    """Return a lower bound in px of the distance from a block to the nearest block that is `there`."""
    if not there.any():
        return np.full(there.shape, NOWHERE_PX, np.float32)
    blocks = np.asarray(distance_transform_edt(~there))
    return (blocks * block_px - 2 * block_px).astype(np.float32)


def nearest(distance: Plane, frame: SceneWindow, lattice: SceneWindow, block_px: int) -> Plane:
    """Return the least distance of the blocks that each stretch of the frame touches."""
    row0_px = (lattice.y0_um - frame.y0_um) / frame.step_um
    col0_px = (frame.x0_um - lattice.x0_um) / frame.step_um
    rows = ((np.arange(frame.rows) + row0_px) / block_px).astype(int)
    starts = np.arange(0, frame.cols, STRETCH_PX)[:, None] + np.arange(0, STRETCH_PX + block_px, block_px)
    cols = np.minimum(((starts + col0_px) / block_px).astype(int), distance.shape[1] - 1)
    return distance[:, cols].min(2)[rows]
