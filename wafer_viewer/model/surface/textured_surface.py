"""Heights with the all-in-focus picture, the two layers used to detect patterns and defects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightLayer, Heights, Origin


@dataclass(frozen=True, slots=True, eq=False)
class TexturedHeights(Heights):
    """One layer of heights with the grey values on the same grid; picture: float32, NaN where no field covers it."""

    picture: NDArray[np.float32]


@runtime_checkable
class ProvidesTexture(Protocol):
    """A surface that can read heights and picture alone, which takes half of the work."""

    def pictured(self, layer: HeightLayer, region: Region, level: int = 0) -> TexturedHeights:
        """Return the part of a level that contains a region. Raises MeasureError if the region lies outside."""
        ...


def picture_of(all_in_focus: NDArray[np.uint8] | NDArray[np.uint16], origin: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the grey values as float32, NaN where no field covers the pixel."""
    picture = all_in_focus.astype(np.float32)
    picture[origin == Origin.NOT_COVERED] = np.nan
    return picture
