"""A true dataset of twelve small fields, of which the fifth alone has a pillar and a hole whose peaks were refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.support.datasets.grid_dataset import REGISTERED, add_surfaces, make_dataset
from tests.truth.field_grid import SMALL, Made, make
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM, HeightMap, Origin, RefusedHeights

FIELD = 5
PILLAR_UM = 120.0
HOLE_PX, PILLAR_PX = 90, 40
REFUSED_UM = 60.0
"""Where the peaks of noise in the hole stand."""


def points_dataset(path: Path) -> HeightMap:
    """Make the dataset; the surface of its field 5 as it was stored."""
    made = make(SMALL)
    place = FIELD - 1
    heights = [dataclasses.replace(height, refused=refused_of(height.origin)) for height in made.heights]
    heights[place] = with_pillar_and_hole(heights[place])
    changed = Made(made.known, made.fields, made.files, tuple(heights))
    make_dataset(path, changed)
    add_surfaces(path, changed, range(len(heights))).save_recipe(REGISTERED)
    return heights[place]


def with_pillar_and_hole(field: HeightMap) -> HeightMap:
    """A field with a pillar that stands over everything else, and a hole without texture."""
    z, raw, origin = field.z_um.copy(), field.z_raw_um.copy(), field.origin.copy()
    hole, pillar = np.s_[100 : 100 + HOLE_PX, 90 : 90 + HOLE_PX], np.s_[120 : 120 + PILLAR_PX, 220 : 220 + PILLAR_PX]
    for layer in (z, raw):
        layer[hole] = np.nan
        layer[pillar] = PILLAR_UM
    origin[hole], origin[pillar] = Origin.NO_TEXTURE, Origin.MEASURED
    return dataclasses.replace(field, z_um=z, z_raw_um=raw, origin=origin, refused=refused_of(origin))


def refused_of(origin: NDArray[np.uint8]) -> RefusedHeights:
    """A refused peak for each unmeasured pixel, for the reason that its origin gives."""
    at = np.flatnonzero(origin >= UNMEASURED_FROM)
    return RefusedHeights(at.astype(np.uint32), np.full(at.size, REFUSED_UM, np.float32), origin.ravel()[at])
