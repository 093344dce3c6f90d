"""One level of a mosaic's pyramid from the one before: each pixel stands for 2 x 2, unmeasured ones left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface import Origin

Layers = dict[str, NDArray[Any]]
"""Arrays [row, col] of one window of a level by name."""
Children = list[NDArray[Any]]
"""Four arrays [row, col]: upper left, upper right, lower left and lower right pixel under each pixel of the half."""
_BEYOND = 255
"""An origin that loses against every other: past an odd edge."""


def halve(layers: Layers) -> Layers:
    """Half the resolution of a window whose z_min_um and z_max_um may be left out at level 0; odd edges are padded.

    A pixel with a measured child is measured and is the mean of its measured children; filled children count only
    where there is no measured one. Its z_min_um and z_max_um span all heights below it, measured or filled.
    """
    origins = _children(layers["origin"], _BEYOND)
    origin = np.minimum.reduce(origins)
    z, raw = _children(layers["z_um"], np.nan), _children(layers["z_raw_um"], np.nan)
    confidence, grey = _children(layers["confidence"], np.nan), _children(layers["all_in_focus"], 0)
    covered = [(o != Origin.NOT_COVERED) & (o != _BEYOND) for o in origins]
    return {
        "z_um": _mean(z, [np.isfinite(c) & (o == origin) for c, o in zip(z, origins, strict=True)]),
        "z_raw_um": _mean(raw, [np.isfinite(c) for c in raw]),
        "z_min_um": np.fmin.reduce(_children(layers.get("z_min_um", layers["z_um"]), np.nan)),
        "z_max_um": np.fmax.reduce(_children(layers.get("z_max_um", layers["z_um"]), np.nan)),
        "confidence": _mean(confidence, [np.isfinite(c) for c in confidence]),
        "all_in_focus": np.rint(np.nan_to_num(_mean(grey, covered))).astype(layers["all_in_focus"].dtype),
        "origin": origin,
    }


def _children(layer: NDArray[Any], beyond: float) -> Children:
    """The four children of each pixel; `beyond` stands outside of the layer."""
    rows, cols = layer.shape
    if rows % 2 or cols % 2:
        layer = np.pad(layer, ((0, rows % 2), (0, cols % 2)), constant_values=beyond)
    return [layer[r::2, c::2] for r in (0, 1) for c in (0, 1)]


def _mean(children: Children, counted: list[NDArray[np.bool_]]) -> NDArray[np.float32]:
    """The mean of the children that count, NaN where none does."""
    total, n = np.zeros(children[0].shape, np.float32), np.zeros(children[0].shape, np.float32)
    for child, counts in zip(children, counted, strict=True):
        np.add(total, child, out=total, where=counts)
        n += counts
    return np.divide(total, n, out=np.full(n.shape, np.nan, np.float32), where=n > 0)
