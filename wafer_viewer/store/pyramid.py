"""One level of a mosaic's pyramid from the one before: each pixel stands for 2 x 2, unmeasured ones left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface import Origin

Layers = dict[str, NDArray[Any]]
"""Arrays [row, col] of one window of a level by name."""


def halve(layers: Layers) -> Layers:
    """Half the resolution of a window whose z_min_um and z_max_um may be left out at level 0; odd edges are padded.

    A pixel with a measured child is measured and is the mean of its measured children; filled children count only
    where there is no measured one. Its z_min_um and z_max_um span all heights below it, measured or filled.
    """
    origins = _children(layers["origin"], Origin.NOT_COVERED)
    origin = origins.min(axis=0)
    z = _children(layers["z_um"], np.nan)
    covered = origins != Origin.NOT_COVERED
    return {
        "z_um": _mean(z, np.isfinite(z) & (origins == origin)).astype(np.float32),
        "z_raw_um": _mean_of_finite(_children(layers["z_raw_um"], np.nan)).astype(np.float32),
        "z_min_um": np.fmin.reduce(_children(layers.get("z_min_um", layers["z_um"]), np.nan)),
        "z_max_um": np.fmax.reduce(_children(layers.get("z_max_um", layers["z_um"]), np.nan)),
        "confidence": _mean_of_finite(_children(layers["confidence"], np.nan)).astype(np.float32),
        "all_in_focus": _grey(_children(layers["all_in_focus"], 0), covered),
        "origin": origin,
    }


def _children(layer: NDArray[Any], beyond: float) -> NDArray[Any]:
    """[4, row, col]: the 2 x 2 pixels under each pixel of the half; `beyond` stands outside of the layer."""
    rows, cols = layer.shape
    if rows % 2 or cols % 2:
        layer = np.pad(layer, ((0, rows % 2), (0, cols % 2)), constant_values=beyond)
    return np.stack([layer[r::2, c::2] for r in (0, 1) for c in (0, 1)])


def _mean_of_finite(children: NDArray[Any]) -> NDArray[np.float64]:
    return _mean(children, np.isfinite(children))


def _mean(children: NDArray[Any], counted: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The mean of the children that count, NaN where none does."""
    n = counted.sum(axis=0)
    total = np.where(counted, children, 0).sum(axis=0, dtype=np.float64)
    return np.divide(total, n, out=np.full(n.shape, np.nan), where=n > 0)


def _grey(children: NDArray[Any], covered: NDArray[np.bool_]) -> NDArray[Any]:
    mean = _mean(children, covered)
    return np.rint(np.nan_to_num(mean)).astype(children.dtype)
