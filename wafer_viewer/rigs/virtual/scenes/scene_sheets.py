"""What a scene's kernel reads and fills: points on the stage, and two sheets at those points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""Stage coordinates in um, [row, col]."""
Plane = NDArray[np.float32]
"""Heights in um, radiances as shares of white, or cover as a share, [row, col]."""


class SceneSheets(NamedTuple):
    """Two sheets, A over B, both defined at every point, and the share of A that an observer straight above sees."""

    height_a: Plane
    radiance_a: Plane
    height_b: Plane
    radiance_b: Plane
    cover: Plane

    def surface_um(self) -> Plane:
        """Heights that the observer sees."""
        surface: Plane = np.where(self.cover > 0.5, self.height_a, self.height_b)
        return surface

    def light_a(self) -> Plane:
        """Light that sheet A gives to the picture."""
        return self.radiance_a * self.cover

    def light_b(self) -> Plane:
        """Light that sheet B gives, where A leaves it free."""
        return self.radiance_b - np.multiply(self.radiance_b, self.cover)

    def radiance(self) -> Plane:
        """The picture when everything is in focus."""
        return self.light_a() + self.light_b()


def empty_sheets(shape: tuple[int, ...]) -> SceneSheets:
    """Sheets for a kernel to fill."""
    return SceneSheets(*(np.empty(shape, np.float32) for _ in SceneSheets._fields))
