"""View of a surface with one of its height layers, raw or cleaned, in place of both."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.comparison import Heights
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM, HeightMap, Mosaic, Origin, ReadThrough


@dataclass(frozen=True, eq=False)
class HeightLayerView(ReadThrough):
    """A `Mosaic` with one height layer, raw or cleaned, in place of both."""

    surface: Mosaic
    heights: Heights

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region, with one height layer."""
        part = self.surface.window(region, level)
        if self.heights == "cleaned":
            return dataclasses.replace(part, z_raw_um=part.z_um)
        raw = np.isfinite(part.z_raw_um)
        why = np.where(part.origin >= UNMEASURED_FROM, part.origin, np.uint8(Origin.NOT_COVERED))
        origin = np.where(raw, np.uint8(Origin.MEASURED), why).astype(np.uint8)
        return dataclasses.replace(part, z_um=part.z_raw_um, origin=origin)


def read_as(surface: Mosaic, heights: Heights) -> Mosaic:
    """Return a view with one height layer, or the surface itself for "both"."""
    return surface if heights == "both" else HeightLayerView(surface, heights)
