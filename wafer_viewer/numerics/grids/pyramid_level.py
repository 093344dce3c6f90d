"""Downsampling of one pyramid level of a mosaic by 2 x 2 pixels to means of the pixels of level 0 that count."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import (
    COUNTS,
    EXTREMES,
    GREY,
    N_COVERED,
    N_ORIGIN,
    N_OVERLAP,
    OF_MEASURED,
    OF_ORIGIN,
    OVERLAP,
    Origin,
)
from wafer_viewer.numerics.jit import Float32s, Greys, Ints, UInt8s, lean_kernel, lean_part

Counts = Ints
"""Unsigned integers."""
Layers = dict[str, NDArray[Any]]
"""Arrays [row, col] of one window of a level by name."""
_BEYOND = 255
"""Origin code of the padding at an odd edge; every other code takes precedence."""
_MEASURED, _NOT_COVERED = int(Origin.MEASURED), int(Origin.NOT_COVERED)


def halve(layers: Layers) -> Layers:
    """Halve the resolution of a window.

    A pixel has the best origin of the pixels of level 0 below it and the mean height and confidence of those with that
    origin: of measured pixels, of filled ones only if none is measured. Other layers are means of their valid pixels,
    the grey value of covered ones, rounded. z_min_um and z_max_um are the extremes of measured heights.

    Parameters
    ----------
    layers : dict of ndarray
        Layers of the window. Those of level 0 have neither extremes nor counts; of other levels they have the layers
        `pyramid_layers.COUNTS`, or every pixel counts one. Odd edges are padded.

    Returns
    -------
    dict of ndarray
        Layers of the coarser window, with the extremes and, as integers, the numbers of pixels that each mean is
        of.
    """
    origins = _even(layers["origin"], _BEYOND)
    best = np.empty((origins.shape[0] // 2, origins.shape[1] // 2), np.uint8)
    _best(origins, best)
    means = _weighted_means if N_ORIGIN in layers else _plain_means
    return {"origin": best, **_extremes(layers, origins), **means(layers, origins, best)}


def _extremes(layers: Layers, origins: UInt8s) -> Layers:
    """Return the lowest and the highest measured height below each pixel, NaN if there is none."""
    shape = origins.shape[0] // 2, origins.shape[1] // 2
    half: Layers = {name: np.empty(shape, np.float32) for name in EXTREMES}
    low, high = half.values()
    if "z_min_um" in layers:
        _lowest(_even(layers["z_min_um"], np.nan), low)
        _highest(_even(layers["z_max_um"], np.nan), high)
    else:
        _measured_extremes(_even(layers["z_um"], np.nan), origins, low, high)
    return half


def _plain_means(layers: Layers, origins: UInt8s, best: UInt8s) -> Layers:
    """Return means and counts of a window in which every pixel counts one."""
    half = _empty(layers, best.shape, np.uint8)
    _count_origin(origins, best, half[N_ORIGIN])
    for name in OF_ORIGIN:
        _mean_of_best(_even(layers[name], np.nan), origins, best, half[name])
    for name in (*OF_MEASURED, OVERLAP):
        if name in layers:
            _mean_of_valid(_even(layers[name], np.nan), half[name])
    if OVERLAP in layers:
        _count_valid(_even(layers[OVERLAP], np.nan), half[N_OVERLAP])
    _mean_of_covered(_even(layers[GREY], 0), origins, half[GREY], half[N_COVERED])
    return half


def _weighted_means(layers: Layers, origins: UInt8s, best: UInt8s) -> Layers:
    """Return means and counts of a window with the counts of its pixels."""
    half = _empty(layers, best.shape, np.uint32)
    counts = {name: _even(layers[name], 0) for name in COUNTS if name in layers}
    of_best = np.empty_like(counts[N_ORIGIN])
    _only_best(counts[N_ORIGIN], origins, best, of_best)
    weights = {**dict.fromkeys(OF_ORIGIN, of_best), **dict.fromkeys(OF_MEASURED, counts[N_ORIGIN])}
    if OVERLAP in layers:
        weights[OVERLAP] = counts[N_OVERLAP]
    for name in weights.keys() & layers.keys():
        _weighted_mean(_even(layers[name], np.nan), weights[name], half[name])
    _weighted_mean_of_grey(_even(layers[GREY], 0), counts[N_COVERED], half[GREY])
    for name in counts.keys() & half.keys():
        _total(of_best if name == N_ORIGIN else counts[name], half[name])
    half["confidence"][half[N_ORIGIN] == 0] = 0
    return half


def _empty(layers: Layers, shape: tuple[int, ...], count: type[np.unsignedinteger[Any]]) -> Layers:
    """Return the means and counts of the coarser window, uninitialised."""
    means = [name for name in (*OF_ORIGIN, *OF_MEASURED, OVERLAP, GREY) if name in layers]
    counts = [N_ORIGIN, N_COVERED, *([N_OVERLAP] if OVERLAP in layers else [])]
    kinds = {name: layers[name].dtype for name in means} | dict.fromkeys(counts, np.dtype(count))
    return {name: np.empty(shape, kind) for name, kind in kinds.items()}


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
def _count_origin(origins: UInt8s, best: UInt8s, out: Counts) -> None:
    """Count those of the four pixels whose origin is the best of them; 0 if no field covers any."""
    for r in range(out.shape[0]):
        _of_origin(origins[2 * r], origins[2 * r + 1], best[r], out[r])


@lean_part
def _of_origin(a: UInt8s, b: UInt8s, best: UInt8s, out: Counts) -> None:
    for x in range(out.size):
        i, j, o = 2 * x, 2 * x + 1, best[x]
        n = np.uint8(a[i] == o) + np.uint8(a[j] == o) + np.uint8(b[i] == o) + np.uint8(b[j] == o)
        out[x] = 0 if o == _NOT_COVERED else n


@lean_kernel
def _only_best(counts: Counts, origins: UInt8s, best: UInt8s, out: Counts) -> None:
    """Copy the counts of the pixels whose origin is the best of their four, 0 for the others."""
    for r in range(out.shape[0]):
        _if_best(counts[r], origins[r], best[r // 2], out[r])


@lean_part
def _if_best(counts: Counts, origins: UInt8s, best: UInt8s, out: Counts) -> None:
    for x in range(best.size):
        out[2 * x] = counts[2 * x] if origins[2 * x] == best[x] else 0
        out[2 * x + 1] = counts[2 * x + 1] if origins[2 * x + 1] == best[x] else 0


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
def _count_valid(layer: Float32s, out: Counts) -> None:
    """Count those of the four pixels that are not NaN."""
    for r in range(out.shape[0]):
        _valid_of(layer[2 * r], layer[2 * r + 1], out[r])


@lean_part
def _valid_of(a: Float32s, b: Float32s, out: Counts) -> None:
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        out[x] = np.uint8(a[i] == a[i]) + np.uint8(a[j] == a[j]) + np.uint8(b[i] == b[i]) + np.uint8(b[j] == b[j])


@lean_kernel
def _total(counts: Counts, out: Counts) -> None:
    """Sum of the four pixels."""
    for r in range(out.shape[0]):
        _of_four(counts[2 * r], counts[2 * r + 1], out[r])


@lean_part
def _of_four(a: Counts, b: Counts, out: Counts) -> None:
    for x in range(out.size):
        out[x] = np.uint32(a[2 * x]) + np.uint32(a[2 * x + 1]) + np.uint32(b[2 * x]) + np.uint32(b[2 * x + 1])


@lean_kernel
def _weighted_mean(layer: Float32s, counts: Counts, out: Float32s) -> None:
    """Mean of those of the four pixels that are not NaN, weighted by their counts; NaN without any."""
    for r in range(out.shape[0]):
        _of_weighted(layer[2 * r], layer[2 * r + 1], counts[2 * r], counts[2 * r + 1], out[r])


@lean_part
def _of_weighted(a: Float32s, b: Float32s, count_a: Counts, count_b: Counts, out: Float32s) -> None:
    zero = np.float32(0)
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p, q = (np.float32(count_a[i]) if a[i] == a[i] else zero), (np.float32(count_a[j]) if a[j] == a[j] else zero)
        s, t = (np.float32(count_b[i]) if b[i] == b[i] else zero), (np.float32(count_b[j]) if b[j] == b[j] else zero)
        above = (p * a[i] if p > 0 else zero) + (q * a[j] if q > 0 else zero)
        below = (s * b[i] if s > 0 else zero) + (t * b[j] if t > 0 else zero)
        out[x] = (above + below) / (p + q + s + t)


@lean_kernel
def _weighted_mean_of_grey(grey: Greys, counts: Counts, out: Greys) -> None:
    """Mean grey of the four pixels, weighted by their counts; 0 without any."""
    for r in range(out.shape[0]):
        _of_weighted_grey(grey[2 * r], grey[2 * r + 1], counts[2 * r], counts[2 * r + 1], out[r])


@lean_part
def _of_weighted_grey(a: Greys, b: Greys, count_a: Counts, count_b: Counts, out: Greys) -> None:
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p, q, s, t = np.float32(count_a[i]), np.float32(count_a[j]), np.float32(count_b[i]), np.float32(count_b[j])
        total = p * np.float32(a[i]) + q * np.float32(a[j]) + s * np.float32(b[i]) + t * np.float32(b[j])
        out[x] = np.int32(np.rint(total / max(p + q + s + t, np.float32(1))))


@lean_kernel
def _measured_extremes(heights: Float32s, origins: UInt8s, low: Float32s, high: Float32s) -> None:
    """Lowest and highest measured height of the four pixels, NaN if there is none."""
    for r in range(low.shape[0]):
        _measured_low(heights[2 * r], heights[2 * r + 1], origins[2 * r], origins[2 * r + 1], low[r])
        _measured_high(heights[2 * r], heights[2 * r + 1], origins[2 * r], origins[2 * r + 1], high[r])


@lean_part
def _measured_low(a: Float32s, b: Float32s, origin_a: UInt8s, origin_b: UInt8s, out: Float32s) -> None:
    most = np.float32(np.inf)
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p = a[i] if (a[i] == a[i]) & (origin_a[i] == _MEASURED) else most
        q = a[j] if (a[j] == a[j]) & (origin_a[j] == _MEASURED) else most
        s = b[i] if (b[i] == b[i]) & (origin_b[i] == _MEASURED) else most
        t = b[j] if (b[j] == b[j]) & (origin_b[j] == _MEASURED) else most
        above, below = (p if p < q else q), (s if s < t else t)
        lowest = above if above < below else below
        out[x] = lowest if lowest < most else np.float32(np.nan)


@lean_part
def _measured_high(a: Float32s, b: Float32s, origin_a: UInt8s, origin_b: UInt8s, out: Float32s) -> None:
    least = np.float32(-np.inf)
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p = a[i] if (a[i] == a[i]) & (origin_a[i] == _MEASURED) else least
        q = a[j] if (a[j] == a[j]) & (origin_a[j] == _MEASURED) else least
        s = b[i] if (b[i] == b[i]) & (origin_b[i] == _MEASURED) else least
        t = b[j] if (b[j] == b[j]) & (origin_b[j] == _MEASURED) else least
        above, below = (p if p > q else q), (s if s > t else t)
        highest = above if above > below else below
        out[x] = highest if highest > least else np.float32(np.nan)


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
def _mean_of_covered(grey: Greys, origins: UInt8s, out: Greys, count: Counts) -> None:
    """Mean grey and number of those of the four pixels that a field covers; grey 0 if none."""
    for r in range(out.shape[0]):
        _of_covered(grey[2 * r], grey[2 * r + 1], origins[2 * r], origins[2 * r + 1], out[r])
        _count_covered(origins[2 * r], origins[2 * r + 1], count[r])


@lean_part
def _of_covered(a: Greys, b: Greys, origin_a: UInt8s, origin_b: UInt8s, out: Greys) -> None:
    """Rounded to even from the middle: rounded up at every level, a mean would rise by an eighth each."""
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p = np.int32((origin_a[i] != _NOT_COVERED) & (origin_a[i] != _BEYOND))
        q = np.int32((origin_a[j] != _NOT_COVERED) & (origin_a[j] != _BEYOND))
        s = np.int32((origin_b[i] != _NOT_COVERED) & (origin_b[i] != _BEYOND))
        t = np.int32((origin_b[j] != _NOT_COVERED) & (origin_b[j] != _BEYOND))
        n = p + q + s + t
        total = np.float32(p * a[i] + q * a[j] + s * b[i] + t * b[j])
        out[x] = np.int32(np.rint(total / np.float32(max(n, 1))))


@lean_part
def _count_covered(a: UInt8s, b: UInt8s, out: Counts) -> None:
    for x in range(out.size):
        i, j = 2 * x, 2 * x + 1
        p = np.uint8((a[i] != _NOT_COVERED) & (a[i] != _BEYOND))
        q = np.uint8((a[j] != _NOT_COVERED) & (a[j] != _BEYOND))
        s = np.uint8((b[i] != _NOT_COVERED) & (b[i] != _BEYOND))
        t = np.uint8((b[j] != _NOT_COVERED) & (b[j] != _BEYOND))
        out[x] = p + q + s + t
