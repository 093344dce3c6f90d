"""Levelling: the zero of heights, given by the stage, a plane or a form fitted to the surface."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Spec, Within

LevelBy = Literal["stage", "three points", "plane", "region", "form"]
PLACES: dict[LevelBy, int] = {"stage": 0, "three points": 3, "plane": 0, "region": 1, "form": 0}
"""Number of regions for each levelling method; `plane` and `form` are fitted to the whole surface."""


class Levelling(Spec, frozen=True, kw_only=True):
    """Levelling method and its regions (points, or the region whose plane is zero).

    order: of the polynomial, only for `form`.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    by: LevelBy = "stage"
    places: tuple[Region, ...] = ()
    order: Annotated[int, Within(1, 4)] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.places) != PLACES[self.by]:
            self.refuse("places", f"{PLACES[self.by]} places to level by {self.by}")


class Datum(Spec, frozen=True, kw_only=True):
    """Zero surface: z = sum of c_ij u^i v^j, u = x - center x and v = y - center y, all in um.

    powers: the exponents (i, j) of each coefficient; no coefficients mean the zero of the stage.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    center: Point = Point(x_um=0.0, y_um=0.0)
    powers: tuple[tuple[int, int], ...] = ()
    coefficients: tuple[float, ...] = ()

    def at(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return its height at positions (arrays that broadcast together) in um."""
        u, v = np.asarray(x_um, float) - self.center.x_um, np.asarray(y_um, float) - self.center.y_um
        zero = np.zeros(np.broadcast_shapes(u.shape, v.shape))
        return sum((c * u**i * v**j for (i, j), c in zip(self.powers, self.coefficients, strict=True)), zero)
