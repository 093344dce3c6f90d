"""What a scene's kernel reads and fills: points on the stage, and two sheets at those points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""Stage coordinates in um, [row, col]."""
Plane = NDArray[np.float32]
"""Heights in um, radiances as shares of white, or cover as a share, [row, col]."""


class Sheets(NamedTuple):
    """Two sheets, A over B, both defined at every point, and the share of A that an observer straight above sees."""

    height_a: Plane
    radiance_a: Plane
    height_b: Plane
    radiance_b: Plane
    cover: Plane

    def surface_um(self) -> Plane:
        """Heights that an observer straight above sees."""
        return np.where(self.cover > 0.5, self.height_a, self.height_b)

    def radiance(self) -> Plane:
        """Light that the observer sees when everything is in focus."""
        return self.radiance_b + (self.radiance_a - self.radiance_b) * self.cover


def empty_sheets(shape: tuple[int, ...]) -> Sheets:
    """Sheets for a kernel to fill."""
    return Sheets(*(np.empty(shape, np.float32) for _ in Sheets._fields))
