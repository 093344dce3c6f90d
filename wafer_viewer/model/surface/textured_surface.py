"""Heights with the picture that is in focus everywhere: what patterns and defects are seen in, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightLayer, Heights, Origin


@dataclass(frozen=True, slots=True, eq=False)
class TexturedHeights(Heights):
    """One layer of heights and the grey values on the same lattice; picture: float32, NaN where no field lies."""

    picture: NDArray[np.float32]


@runtime_checkable
class ProvidesTexture(Protocol):
    """A surface that reads heights and picture alone: half of the work where nothing else is asked for."""

    def pictured(self, layer: HeightLayer, region: Region, level: int = 0) -> TexturedHeights:
        """The part of a level that holds a region. Raises MeasureError when the region lies outside."""
        ...


def picture_of(all_in_focus: NDArray[np.uint8] | NDArray[np.uint16], origin: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Grey values as float32, NaN where no field lies."""
    picture = all_in_focus.astype(np.float32)
    picture[origin == Origin.NOT_COVERED] = np.nan
    return picture
