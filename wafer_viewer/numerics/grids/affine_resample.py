"""Affine resampling of the layers of a surface.

Heights are interpolated bilinearly, and only between measured pixels: gaps are not filled.
"""

from __future__ import annotations

from typing import NamedTuple

from wafer_viewer.numerics.array_types import Float32s, Float64s, Greys, UInt8s
from wafer_viewer.numerics.jit import kernel

_NOT_COVERED = 10
_ON_PIXEL = 1e-4
"""Distance in pixels below which a position counts as on a pixel and its neighbours are ignored."""


class ResampledLayers(NamedTuple):
    """Layers of a surface, all [row, col]."""

    z: Float32s
    raw: Float32s
    confidence: Float32s
    grey: Greys
    origin: UInt8s


@kernel
def resample_affine(source: ResampledLayers, motion: Float64s, out: ResampledLayers) -> None:
    """Fill `out` with the source at (row, col) = motion [2, 3] @ (1, out row, out col); not covered beyond its border.

    A height is unmeasured if a pixel with weight is, with that pixel's reason, and filled if one of them is filled. Its
    confidence is the smallest of theirs.
    """
    n_rows, n_cols = source.z.shape
    for r in range(out.z.shape[0]):
        for c in range(out.z.shape[1]):
            y = motion[0, 0] + motion[0, 1] * r + motion[0, 2] * c
            x = motion[1, 0] + motion[1, 1] * r + motion[1, 2] * c
            i, j = int(y + 1.0) - 1, int(x + 1.0) - 1
            v, u = y - i, x - j
            if v > 1 - _ON_PIXEL:
                i, v = i + 1, 0.0
            if u > 1 - _ON_PIXEL:
                j, u = j + 1, 0.0
            v = 0.0 if v < _ON_PIXEL else v
            u = 0.0 if u < _ON_PIXEL else u
            below, right = i + (1 if v > 0 else 0), j + (1 if u > 0 else 0)
            if y < -_ON_PIXEL or x < -_ON_PIXEL or i < 0 or j < 0 or below >= n_rows or right >= n_cols:
                out.z[r, c] = out.raw[r, c] = float("nan")
                out.confidence[r, c] = 0
                out.grey[r, c] = 0
                out.origin[r, c] = _NOT_COVERED
                continue
            a, b, p, q = (1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u
            out.z[r, c] = (
                a * source.z[i, j] + b * source.z[i, right] + p * source.z[below, j] + q * source.z[below, right]
            )
            out.raw[r, c] = (
                a * source.raw[i, j]
                + b * source.raw[i, right]
                + p * source.raw[below, j]
                + q * source.raw[below, right]
            )
            out.confidence[r, c] = min(
                min(source.confidence[i, j], source.confidence[i, right]),
                min(source.confidence[below, j], source.confidence[below, right]),
            )
            out.grey[r, c] = int(
                a * source.grey[i, j]
                + b * source.grey[i, right]
                + p * source.grey[below, j]
                + q * source.grey[below, right]
                + 0.5
            )
            worst = max(
                max(source.origin[i, j], source.origin[i, right]),
                max(source.origin[below, j], source.origin[below, right]),
            )
            out.origin[r, c] = worst
