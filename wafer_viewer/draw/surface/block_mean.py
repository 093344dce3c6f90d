"""Downsampling of a height map by block means that ignore gaps."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap

Layer = NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16]


def reduced(part: HeightMap, factor: int) -> HeightMap:
    """Return the map in blocks of factor x factor pixels; blocks at the right and lower edge may be partial.

    A height is the mean of the measured pixels in its block; the origin is that of the best pixel, the lowest code.
    """
    if factor <= 1:
        return part
    shift = (factor - 1) / 2 * part.pixel_um
    return dataclasses.replace(
        part,
        z_um=_mean(part.z_um, factor),
        z_raw_um=_mean(part.z_raw_um, factor),
        confidence=_mean(part.confidence, factor),
        all_in_focus=_mean(part.all_in_focus, factor).astype(part.all_in_focus.dtype),
        overlap_um=None if part.overlap_um is None else _mean(part.overlap_um, factor),
        origin=_blocks(part.origin, factor, 255).min(axis=(1, 3)),
        pixel_um=part.pixel_um * factor,
        x0_um=part.x0_um + shift,
        y0_um=part.y0_um - shift,
    )


def _mean(layer: Layer, factor: int) -> NDArray[np.float32]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a block without a measured pixel stays NaN
        return np.nanmean(_blocks(layer.astype(np.float32), factor, np.nan), axis=(1, 3)).astype(np.float32)


def _blocks(layer: Layer, factor: int, outside: float) -> NDArray[Any]:
    """Return the layer as [row, factor, col, factor], padded with `outside`."""
    rows, cols = layer.shape
    padded = np.pad(layer, ((0, -rows % factor), (0, -cols % factor)), constant_values=outside)
    return padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
