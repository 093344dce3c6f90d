"""The mean of what agrees with a pixel, by pairs of opposite neighbours.

Two pixels on opposite sides tell by their middle what height a plane has between them, whatever its slope: so a slope,
the border of a map and the edge of a gap bias nothing. A pair across a step tells something else and does not count.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Float32s, Real
from wafer_viewer.numerics.jit import lean_kernel

REACH_PX = 4
_STRIDE_PX = 2
"""Errors of neighbouring pixels are alike, they share most of their focus window: every second one tells as much."""


def pair_mean(z: Float32s, limit: Real) -> Float32s:
    """Each pixel averaged with the pairs within 4 pixels whose middle is at most `limit` from it; NaN stays NaN."""
    out = np.empty_like(z)
    padded = np.pad(z, REACH_PX, constant_values=np.nan)
    _average(padded, np.float32(limit), np.empty((2, z.shape[1]), np.float32), out)
    return out


@lean_kernel
def _average(padded: Float32s, limit: Real, scratch: Float32s, out: Float32s) -> None:
    """A middle has half the variance of a pixel, so that it weighs twice as much: the pixel itself counts a half."""
    total, count = scratch[0], scratch[1]
    for r in range(out.shape[0]):
        here = padded[r + REACH_PX, REACH_PX:]
        total[:] = 0.0
        count[:] = 0.5
        for down in range(0, REACH_PX + 1, _STRIDE_PX):
            for right in range(-REACH_PX, REACH_PX + 1, _STRIDE_PX):
                if down > 0 or right > 0:
                    ahead = padded[r + REACH_PX + down, REACH_PX + right :]
                    behind = padded[r + REACH_PX - down, REACH_PX - right :]
                    for x in range(total.size):
                        off = np.float32(0.5) * (ahead[x] + behind[x]) - here[x]
                        agrees = abs(off) <= limit
                        total[x] += off if agrees else np.float32(0.0)
                        count[x] += np.float32(agrees)
        for x in range(total.size):
            out[r, x] = here[x] + total[x] / count[x]
