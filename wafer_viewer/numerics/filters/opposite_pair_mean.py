"""Mean of a pixel and of pairs of opposite neighbours that agree with it.

The mean of two pixels on opposite sides equals the height of a plane between them, whatever its slope, so slopes,
borders and edges of gaps cause no bias. A pair across a step disagrees and does not count.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Float32s, Real
from wafer_viewer.numerics.jit import lean_kernel

REACH_PX = 4
_STRIDE_PX = 2
"""Neighbouring pixels share most of their focus window, so their errors are correlated; every second pixel suffices."""


def pair_mean(z: Float32s, limit: Real) -> Float32s:
    """Average each pixel with the pairs within 4 pixels whose mean differs by at most `limit`; NaN stays NaN."""
    out = np.empty_like(z)
    padded = np.pad(z, REACH_PX, constant_values=np.nan)
    _average(padded, np.float32(limit), np.empty((2, z.shape[1]), np.float32), out)
    return out


@lean_kernel
def _average(padded: Float32s, limit: Real, scratch: Float32s, out: Float32s) -> None:
    """Average with the pixel itself at half weight, because the mean of a pair has half the variance of a pixel."""
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
