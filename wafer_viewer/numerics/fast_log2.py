"""Vectorisable logarithm for kernels; numba's own is a call for every number."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Real
from wafer_viewer.numerics.jit import inline_kernel

# log2(1 + f) - f = f (1 - f) (c0 + c1 f + c2 f^2) for 0 <= f < 1, within 0.00012.
_C0, _C1, _C2 = np.float32(0.43872573), np.float32(-0.2390582), np.float32(0.08213066)
_MANTISSA = np.int32((1 << 23) - 1)
_MANTISSA_BITS = np.int32(23)
_PER_MANTISSA = np.float32(2.0**-23)
_BIAS = np.float32(127)


@inline_kernel
def quick_log2(value: Real) -> Real:
    """Return log2 of a positive float32, within 0.00012.

    The exponent is the integer part. The mantissa f is the fraction, except for a correction between powers of two.
    """
    bits = np.float32(value).view(np.int32)
    f = np.float32(np.int32(bits & _MANTISSA)) * _PER_MANTISSA
    bow = f * (np.float32(1) - f) * (_C0 + f * (_C1 + f * _C2))
    return np.float32(np.int32(bits >> _MANTISSA_BITS)) - _BIAS + f + bow
