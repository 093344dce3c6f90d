"""A surface of which one of both maps of heights is looked at: the raw one, or the cleaned one."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.comparison import Heights
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM, HeightMap, Mosaic, Origin, ReadThrough


@dataclass(frozen=True, eq=False)
class HeightLayerView(ReadThrough):
    """A `Mosaic` of which one of both height maps stands for both: the raw one, or the cleaned one."""

    surface: Mosaic
    heights: Heights

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part of a level that holds a region, with one map of heights."""
        part = self.surface.window(region, level)
        if self.heights == "cleaned":
            return dataclasses.replace(part, z_raw_um=part.z_um)
        raw = np.isfinite(part.z_raw_um)
        why = np.where(part.origin >= UNMEASURED_FROM, part.origin, np.uint8(Origin.NOT_COVERED))
        origin = np.where(raw, np.uint8(Origin.MEASURED), why).astype(np.uint8)
        return dataclasses.replace(part, z_um=part.z_raw_um, origin=origin)


def read_as(surface: Mosaic, heights: Heights) -> Mosaic:
    """The surface with one map of heights, or as it was made."""
    return surface if heights == "both" else HeightLayerView(surface, heights)
