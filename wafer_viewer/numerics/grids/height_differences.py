"""Differences of two height maps at a subpixel offset."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Float32s, Real
from wafer_viewer.numerics.jit import lean_kernel, lean_part


def differences(first: Float32s, second: Float32s, row_part: Real, col_part: Real, max_step: Real) -> Float32s:
    """Return the second minus the first at the pixels of the first; float32, NaN where either has no height.

    first: [row, col]; second: [row + 1, col + 1]; pixel (r, c) of the first is at (r + row_part, c + col_part) of the
    second, the parts in 0 ... 1. The second is interpolated bilinearly, not next to NaN or steps over `max_step`.
    """
    out = np.empty(first.shape, np.float32)
    parts = np.array([row_part, col_part], np.float32)
    _subtract(first, second, parts, np.float32(max_step), out)
    return out


@lean_kernel
def _subtract(first: Float32s, second: Float32s, parts: Float32s, max_step: Real, out: Float32s) -> None:
    for r in range(out.shape[0]):
        above, below = second[r], second[r + 1]
        _subtract_row(first[r], above, above[1:], below, below[1:], parts[0], parts[1], max_step, out[r])


@lean_part
def _subtract_row(
    first: Float32s,
    a: Float32s,
    b: Float32s,
    c: Float32s,
    d: Float32s,
    s: Real,
    t: Real,
    max_step: Real,
    out: Float32s,
) -> None:
    """Subtract one row; NaN fails every comparison."""
    for x in range(out.size):
        above, below = a[x] + t * (b[x] - a[x]), c[x] + t * (d[x] - c[x])
        flat = (abs(b[x] - a[x]) <= max_step) & (abs(d[x] - c[x]) <= max_step) & (abs(c[x] - a[x]) <= max_step)
        out[x] = above + s * (below - above) - first[x] if flat else np.float32(np.nan)
