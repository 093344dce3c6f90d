"""Downsampling of height maps by the rule of all pyramids, and concatenation of bands."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.grids.pyramid_level import halve

LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")


def layers_of(height: HeightMap) -> dict[str, NDArray[Any]]:
    """Return the layers of a map by name, including the overlap differences if it has them."""
    names = LAYERS if height.overlap_um is None else (*LAYERS, "overlap_um")
    return {name: getattr(height, name) for name in names}


def halved(height: HeightMap) -> HeightMap:
    """Return the next pyramid level: each pixel is the mean of the measured ones of 2 x 2."""
    layers = layers_of(height)
    half = halve(layers)
    return dataclasses.replace(
        height,
        **{name: half[name] for name in layers},
        pixel_um=2 * height.pixel_um,
        x0_um=height.x0_um + 0.5 * height.pixel_um,
        y0_um=height.y0_um - 0.5 * height.pixel_um,
    )


def joined(bands: Sequence[HeightMap]) -> HeightMap:
    """Concatenate vertically adjacent maps, at the position of the first."""
    if len(bands) == 1:
        return bands[0]
    layers = {name: np.concatenate([getattr(b, name) for b in bands]) for name in layers_of(bands[0])}
    return dataclasses.replace(bands[0], **layers)
