"""A sample as light sees it: layers on top of each other, each with heights, outline and what it sends back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PIXEL_UM = 0.46729
EDGE_PX = 10.0

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class TruthScene:
    """Layers from the ground up, all [layer, row, col] float32 on one lattice; walls stand along the outlines.

    height_um: of the layer's surface. outline_um: how far outside of the layer's outline a point is, negative inside;
    layer 0 is everywhere. reflectance: grey share of what a white diffuse sheet sends back. gloss: the share of it that
    goes into a lobe about the mirror direction. lean_rows, lean_cols: that direction, as tangents along rows and cols.
    textured: bool [row, col], where there is something to focus on. The frame is the lattice without `margin_px` at
    each side: light enters a frame from beyond its border.
    """

    name: str
    height_um: Floats
    outline_um: Floats
    reflectance: Floats
    gloss: Floats
    lean_rows: Floats
    lean_cols: Floats
    textured: NDArray[np.bool_]
    margin_px: int
    pixel_um: float = PIXEL_UM
    wall_reflectance: float = 0.008

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the frame."""
        rows, cols = self.height_um.shape[1:]
        return rows - 2 * self.margin_px, cols - 2 * self.margin_px

    @property
    def layer(self) -> NDArray[np.intp]:
        """The layer seen from straight above, [row, col] of the frame."""
        inside = self.inner(self.outline_um) < 0
        n_layers = len(inside)
        return n_layers - 1 - np.argmax(inside[::-1], axis=0)

    @property
    def truth_um(self) -> Floats:
        """The height seen from straight above, [row, col] of the frame."""
        return np.take_along_axis(self.inner(self.height_um), self.layer[None], axis=0)[0]

    @property
    def edge_distance_px(self) -> NDArray[np.float64]:
        """How far the nearest wall is, [row, col] of the frame; inf without walls."""
        walls = np.abs(self.inner(self.outline_um)[1:]) / self.pixel_um
        return walls.min(axis=0, initial=np.inf)

    @property
    def edge(self) -> NDArray[np.bool_]:
        """Where a wall is within 10 px."""
        return self.edge_distance_px <= EDGE_PX

    def inner(self, array: NDArray) -> NDArray:
        """The part of an array on the lattice that the frame shows."""
        m = self.margin_px
        return array[..., m:-m, m:-m] if m else array


def visible(scene: TruthScene, array: NDArray) -> NDArray:
    """What an array [layer, row, col] is on the layer seen from straight above, [row, col] of the frame."""
    return np.take_along_axis(scene.inner(array), scene.layer[None], axis=0)[0]
