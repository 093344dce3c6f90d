"""Input and output of the scene kernels: stage points, and two sheets at those points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""Stage coordinates in um, [row, col]."""
Plane = NDArray[np.float32]
"""Heights in um, radiances as shares of white, or cover as a share, [row, col]."""


class SceneSheets(NamedTuple):
    """Two sheets, A over B, both defined at every point, and the visible share of A from straight above."""

    height_a: Plane
    radiance_a: Plane
    height_b: Plane
    radiance_b: Plane
    cover: Plane

    def surface_um(self) -> Plane:
        """Return the visible heights from straight above."""
        surface: Plane = np.where(self.cover > 0.5, self.height_a, self.height_b)
        return surface

    def light_a(self) -> Plane:
        """Return the light contribution of sheet A."""
        return self.radiance_a * self.cover

    def light_b(self) -> Plane:
        """Return the light contribution of sheet B where A does not cover it."""
        return self.radiance_b - np.multiply(self.radiance_b, self.cover)

    def radiance(self) -> Plane:
        """Return the image with everything in focus."""
        return self.light_a() + self.light_b()


def empty_sheets(shape: tuple[int, ...]) -> SceneSheets:
    """Return uninitialized sheets for a kernel."""
    return SceneSheets(*(np.empty(shape, np.float32) for _ in SceneSheets._fields))
