"""Downsampling of one pyramid level of a mosaic by 2 x 2 pixels, ignoring unmeasured ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.numerics.jit import Float32s, Greys, UInt8s, lean_kernel, lean_part

Layers = dict[str, NDArray[Any]]
"""Arrays [row, col] of one window of a level by name."""
_BEYOND = 255
"""Origin code of the padding at an odd edge; every other code takes precedence."""
_NOT_COVERED = int(Origin.NOT_COVERED)
_MEANS = ("z_raw_um", "confidence", "overlap_um", "u_um")


def halve(layers: Layers) -> Layers:
    """Halve the resolution of a window; z_min_um and z_max_um may be absent at level 0; odd edges are padded.

    A pixel with a measured child is measured and is the mean of its measured children; filled children count only if
    none is measured. Its z_min_um and z_max_um span all heights below it, measured or filled.
    """
    origins, heights = _even(layers["origin"], _BEYOND), _even(layers["z_um"], np.nan)
    shape = origins.shape[0] // 2, origins.shape[1] // 2
    half: Layers = {"origin": np.empty(shape, np.uint8)}
    _best(origins, half["origin"])
    for name in ("z_um", "z_min_um", "z_max_um", *(name for name in _MEANS if name in layers)):
        half[name] = np.empty(shape, np.float32)
    _mean_of_best(heights, origins, half["origin"], half["z_um"])
    _lowest(_even(layers["z_min_um"], np.nan) if "z_min_um" in layers else heights, half["z_min_um"])
    _highest(_even(layers["z_max_um"], np.nan) if "z_max_um" in layers else heights, half["z_max_um"])
    for name in set(_MEANS) & set(layers):
        _mean_of_valid(_even(layers[name], np.nan), half[name])
    half["all_in_focus"] = np.empty(shape, layers["all_in_focus"].dtype)
    _mean_of_covered(_even(layers["all_in_focus"], 0), origins, half["all_in_focus"])
    return half


def _even(layer: NDArray[Any], beyond: float) -> NDArray[Any]:
    """Pad a layer with `beyond` to an even number of rows and columns."""
    rows, cols = layer.shape
    if rows % 2 or cols % 2:
        layer = np.pad(layer, ((0, rows % 2), (0, cols % 2)), constant_values=beyond)
    return np.ascontiguousarray(layer)


@lean_kernel
def _best(origins: UInt8s, out: UInt8s) -> None:
    for r in range(out.shape[0]):
        _least(origins[2 * r], origins[2 * r + 1], out[r])


@lean_part
def _least(above: UInt8s, below: UInt8s, out: UInt8s) -> None:
    for x in range(out.size):
        out[x] = min(min(above[2 * x], above[2 * x + 1]), min(below[2 * x], below[2 * x + 1]))


@lean_kernel
def _mean_of_best(heights: Float32s, origins: UInt8s, best: UInt8s, out: Float32s) -> None:
    """Mean of those of the four pixels whose origin is the best of them, NaN if they have no height."""
    for r in range(out.shape[0]):
        _of_best(heights[2 * r], heights[2 * r + 1], origins[2 * r], origins[2 * r + 1], best[r], out[r])


@lean_part
def _of_best(a: Float32s, b: Float32s, origin_a: UInt8s, origin_b: UInt8s, best: UInt8s, out: Float32s) -> None:
    zero = np.float32(0)
    for x in range(out.size):
        i, j, o = 2 * x, 2 * x + 1, best[x]
        p, q = (a[i] == a[i]) & (origin_a[i] == o), (a[j] == a[j]) & (origin_a[j] == o)
        s, t = (b[i] == b[i]) & (origin_b[i] == o), (b[j] == b[j]) & (origin_b[j] == o)
        total = (a[i] if p else zero) + (a[j] if q else zero) + (b[i] if s else zero) + (b[j] if t else zero)
        out[x] = total / (np.float32(p) + np.float32(q) + np.float32(s) + np.float32(t))


@lean_kernel
def _mean_of_valid(layer: Float32s, out: Float32s) -> None:
    """Mean of those of the four pixels that are not NaN."""
    for r in range(out.shape[0]):
        _of_valid(layer[2 * r], layer[2 * r + 1], out[r])


@lean_part
def _of_valid(a: Float32s, b: Float32s, out: Float32s) -> None:
    zero = np.float32(0)
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p, q, s, t = a[i] == a[i], a[j] == a[j], b[i] == b[i], b[j] == b[j]
        total = (a[i] if p else zero) + (a[j] if q else zero) + (b[i] if s else zero) + (b[j] if t else zero)
        out[x] = total / (np.float32(p) + np.float32(q) + np.float32(s) + np.float32(t))


@lean_kernel
def _lowest(layer: Float32s, out: Float32s) -> None:
    for r in range(out.shape[0]):
        _low(layer[2 * r], layer[2 * r + 1], out[r])


@lean_part
def _low(a: Float32s, b: Float32s, out: Float32s) -> None:
    for x in range(out.size):
        p = a[2 * x] if (a[2 * x] <= a[2 * x + 1]) | (a[2 * x + 1] != a[2 * x + 1]) else a[2 * x + 1]
        q = b[2 * x] if (b[2 * x] <= b[2 * x + 1]) | (b[2 * x + 1] != b[2 * x + 1]) else b[2 * x + 1]
        out[x] = p if (p <= q) | (q != q) else q


@lean_kernel
def _highest(layer: Float32s, out: Float32s) -> None:
    for r in range(out.shape[0]):
        _high(layer[2 * r], layer[2 * r + 1], out[r])


@lean_part
def _high(a: Float32s, b: Float32s, out: Float32s) -> None:
    for x in range(out.size):
        p = a[2 * x] if (a[2 * x] >= a[2 * x + 1]) | (a[2 * x + 1] != a[2 * x + 1]) else a[2 * x + 1]
        q = b[2 * x] if (b[2 * x] >= b[2 * x + 1]) | (b[2 * x + 1] != b[2 * x + 1]) else b[2 * x + 1]
        out[x] = p if (p >= q) | (q != q) else q


@lean_kernel
def _mean_of_covered(grey: Greys, origins: UInt8s, out: Greys) -> None:
    """Mean grey of those of the four pixels that a field covers, 0 if none."""
    for r in range(out.shape[0]):
        _of_covered(grey[2 * r], grey[2 * r + 1], origins[2 * r], origins[2 * r + 1], out[r])


@lean_part
def _of_covered(a: Greys, b: Greys, origin_a: UInt8s, origin_b: UInt8s, out: Greys) -> None:
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p = np.int32((origin_a[i] != _NOT_COVERED) & (origin_a[i] != _BEYOND))
        q = np.int32((origin_a[j] != _NOT_COVERED) & (origin_a[j] != _BEYOND))
        s = np.int32((origin_b[i] != _NOT_COVERED) & (origin_b[i] != _BEYOND))
        t = np.int32((origin_b[j] != _NOT_COVERED) & (origin_b[j] != _BEYOND))
        n = p + q + s + t
        total = np.float32(p * a[i] + q * a[j] + s * b[i] + t * b[j])
        out[x] = np.int32(total / np.float32(max(n, 1)) + np.float32(0.5))
