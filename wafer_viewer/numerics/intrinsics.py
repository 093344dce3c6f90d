"""Instructions for kernels: software prefetch, and a logarithm that vectorises."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from wafer_viewer.numerics.jit import CACHE_LINE_BYTES, Greys, Real, inline_kernel, inlined_part

_TO_READ = 0
"""Argument `rw` of `llvm.prefetch`: the row is read."""
_KEEP = 3
"""Argument `locality` of `llvm.prefetch`: the row stays in all caches."""
_DATA = 1
"""Argument `cache type` of `llvm.prefetch`: data, not instructions."""


@inlined_part
def prefetch(row: Greys) -> None:
    """Prefetch a row into the caches, without waiting and without side effects."""
    for x in range(0, row.size, CACHE_LINE_BYTES // row.itemsize):
        _prefetch(row, x)


def _typed(_: Any, row: Any, index: Any) -> Any:
    return types.void(row, index), _emit


def _emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    data = context.make_array(signature.args[0])(context, builder, args[0]).data
    number = ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [data.type, number, number, number])
    instruction = builder.module.declare_intrinsic("llvm.prefetch", [data.type], kind)
    builder.call(instruction, [builder.gep(data, [args[1]]), *(number(n) for n in (_TO_READ, _KEEP, _DATA))])
    return context.get_dummy_value()


_prefetch: Any = intrinsic(_typed)


_C0, _C1, _C2 = np.float32(0.43872573), np.float32(-0.2390582), np.float32(0.08213066)
"""Coefficients of log2(1 + f) - f = f (1 - f) (c0 + c1 f + c2 f^2) for 0 <= f < 1, within 0.00012."""
_MANTISSA = np.int32((1 << 23) - 1)
"""Mask of the mantissa bits of a float32."""
_MANTISSA_BITS = np.int32(23)
"""Number of mantissa bits of a float32."""
_PER_MANTISSA = np.float32(2.0**-23)
"""Value of the lowest mantissa bit of a float32 in 1 ... 2."""
_BIAS = np.float32(127)
"""Exponent bias of a float32."""


@inline_kernel
def quick_log2(value: Real) -> Real:
    """Return log2 of a positive float32, within 0.00012.

    The exponent is the integer part. The mantissa f is the fraction, except for a correction between powers of two.
    """
    bits = np.float32(value).view(np.int32)
    f = np.float32(np.int32(bits & _MANTISSA)) * _PER_MANTISSA
    bow = f * (np.float32(1) - f) * (_C0 + f * (_C1 + f * _C2))
    return np.float32(np.int32(bits >> _MANTISSA_BITS)) - _BIAS + f + bow
