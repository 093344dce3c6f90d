"""Golden die: expected height, spread and picture of every die of a product, per pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import Positive, Spec, Within

SAME_PIXEL = 1e-3
"""Relative difference up to which pixel sizes count as equal."""
SAME_SIZE_PX = 2.0
"""Difference in pixels up to which sizes of dies count as equal."""


class GoldenHeader(Spec, frozen=True, kw_only=True):
    """Origin of a golden die. version counts from 1 per product and name; 0 if not stored yet.

    made_of: dataset or file that it was made from; made_at: time, ISO 8601; dies: number of dies.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    product: str = ""
    name: str = ""
    version: Annotated[int, Within(0)] = 0
    pixel_um: Positive
    width_um: Positive
    height_um: Positive
    dies: Annotated[int, Within(1)]
    made_of: str = ""
    made_at: str = ""
    software_version: str = ""
    simulated: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class GoldenDie:
    """A golden die: z_um, z_spread_um, picture, picture_spread, float32 [row, col], row 0 at the die's upper edge.

    z_um is the robust median over the dies, z_spread_um its robust standard deviation from die to die (1.4826 MAD);
    picture and picture_spread are the same of the all-in-focus image. Pixel (0, 0) has its centre at u = pixel_um / 2,
    v = height_um - pixel_um / 2 from the die's lower left corner. NaN where too few dies were measured.
    """

    header: GoldenHeader
    z_um: NDArray[np.float32]
    z_spread_um: NDArray[np.float32]
    picture: NDArray[np.float32]
    picture_spread: NDArray[np.float32]

    def __post_init__(self) -> None:
        if len({layer.shape for layer in self.layers.values()}) != 1:
            shapes = ", ".join(f"{name} {layer.shape}" for name, layer in self.layers.items())
            raise MeasureError(f"The layers of a golden die must be of one size; their sizes are {shapes}.")

    @property
    def layers(self) -> dict[str, NDArray[np.float32]]:
        """Arrays by name."""
        names = ("z_um", "z_spread_um", "picture", "picture_spread")
        return {name: getattr(self, name) for name in names}

    @property
    def title(self) -> str:
        """Display name with version."""
        return f"{self.header.name or 'golden die'} version {self.header.version}"

    def require_fit(self, *, product: str, pixel_um: float, width_um: float, height_um: float) -> None:
        """Raise MeasureError for another product, pixel size or die size; an empty product is not compared.

        A size of 0 is not compared.
        """
        own = self.header
        if product and own.product and product != own.product:
            raise MeasureError(
                f"{self.title} is of product '{own.product}' and this wafer is of '{product}': "
                "choose a golden die of this product."
            )
        if abs(own.pixel_um / pixel_um - 1) > SAME_PIXEL:
            raise MeasureError(
                f"{self.title} has pixels of {own.pixel_um:.5g} um and this surface of {pixel_um:.5g} um: "
                "choose one that was made at this magnification."
            )
        sizes = ((own.width_um, width_um), (own.height_um, height_um))
        if any(size and abs(made - size) > SAME_SIZE_PX * pixel_um for made, size in sizes):
            raise MeasureError(
                f"{self.title} has dies of {own.width_um:.6g} x {own.height_um:.6g} um and this wafer of "
                f"{width_um:.6g} x {height_um:.6g} um: choose one of this size."
            )
