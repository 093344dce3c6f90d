"""Compilation of kernels by numba, their cache, and the types of their arguments.

Every process loads what is compiled already, and writes what it had to compile; `kernel_cache` says where.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numba
import numpy as np
from llvmlite import binding, ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from wafer_viewer.numerics.kernel_cache import cache_folder, is_writable, module_folder

# ------------------------------------------------------------------------------------------------------------------ jit


_COUNTED: dict[str, Any] = {"no_cfunc_wrapper": True}
_UNCOUNTED: dict[str, Any] = {"_nrt": False, **_COUNTED}  # numba's runtime with reference counts, missing in its stubs
_LEAN: dict[str, Any] = {"error_model": "numpy", **_UNCOUNTED}
_PART: dict[str, Any] = {"no_cpython_wrapper": True, **_LEAN}
_FAST_PART: dict[str, Any] = {"fastmath": True, "no_cpython_wrapper": True, **_COUNTED}
F = TypeVar("F", bound=Callable[..., Any])


class KernelLocator:
    """Location of the compiled code of a function, as numba asks its cache locators for it."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._folder, self._line = folder, function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> KernelLocator:
        """Return the locator of a function in a file."""
        return cls(py_func, module_folder(py_func.__module__, Path(py_file)))

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Return what compiled code must have been made of, which is the name of the folder."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in a module apart."""
        return str(self._line)


_CONFIG: Any = cast(Any, numba).config  # missing in its stubs


def _features() -> str:
    """Return the features of this processor for the compiler, with vectors as long as it has.

    LLVM halves the vectors of all processors with 512 bits, because the first of them slowed down; those since Ice Lake
    (`avx512vbmi`) do not: the focus volume takes a quarter less time.
    """
    try:
        found = binding.get_host_cpu_features()
    except RuntimeError:  # the processor does not tell
        return ""
    return f"{found.flatten()},-prefer-256-bit" if found.get("avx512vbmi") else ""


if _CONFIG.CPU_FEATURES is None and _CONFIG.CPU_NAME is None:
    _CONFIG.CPU_FEATURES = _features() or None
_LOCATOR = f"{__name__}.{KernelLocator.__name__}"


def _cached(function: F, **options: Any) -> F:
    """Compile a function without the GIL, or load its compiled code.

    Where the folder cannot be written each process compiles it anew: numba would raise what prevents it to keep code.
    """
    others, _CONFIG.CACHE_LOCATOR_CLASSES = _CONFIG.CACHE_LOCATOR_CLASSES, _LOCATOR
    try:
        return cast(F, numba.njit(nogil=True, cache=is_writable(cache_folder()), **options)(function))
    finally:
        _CONFIG.CACHE_LOCATOR_CLASSES = others


def kernel(function: F) -> F:
    """Compile a module-level function once per machine; it runs without the GIL."""
    return _cached(function, **_COUNTED)


def fast_kernel(function: F) -> F:
    """Compile a `kernel` with reordered float arithmetic; not for code that tests for NaN."""
    return _cached(function, fastmath=True, **_COUNTED)


def fast_part(function: F) -> F:
    """Compile a part of `fast_kernel`s, which keep it; without a wrapper: Python must not call it."""
    return cast(F, numba.njit(**_FAST_PART)(function))


def bare_kernel(function: F) -> F:
    """Compile a `fast_kernel` that creates no arrays, only views of its arguments, without reference counting.

    Reference counting takes an atomic operation for every view of a row, a third of the time of a kernel that works
    through rows of a picture. Compilation fails if the kernel, or one that it calls, creates an array.
    """
    return _cached(function, fastmath=True, **_UNCOUNTED)


def lean_kernel(function: F) -> F:
    """Compile a `bare_kernel` that preserves the order of float arithmetic; division by zero gives infinity or NaN."""
    return _cached(function, **_LEAN)


def lean_part(function: F) -> F:
    """Compile a loop over a row for use in `lean_kernel`s, without a Python wrapper."""
    return cast(F, numba.njit(**_PART)(function))


def inlined_part(function: F) -> F:
    """Compile an inlined part of `lean_kernel`s that passes rows on; a call would copy their array structs twice.

    A copy that is read with another access size than it was written with waits until all earlier writes have reached
    the cache, and these are a row of the focus volume. The part is inlined before the types of its callers are known,
    so it is compiled with them and not separately.
    """
    return cast(F, numba.njit(inline="always", **_PART)(function))


def inline_kernel(function: F) -> F:
    """Compile a small function that is inlined into its callers."""
    return cast(F, numba.njit(inline="always")(function))


Bools: TypeAlias = NDArray[np.bool_]
Float32s: TypeAlias = NDArray[np.float32]
Float64s: TypeAlias = NDArray[np.float64]
Int32s: TypeAlias = NDArray[np.int32]
Int64s: TypeAlias = NDArray[np.int64]
UInt8s: TypeAlias = NDArray[np.uint8]
UInt16s: TypeAlias = NDArray[np.uint16]
UInt64s: TypeAlias = NDArray[np.uint64]
Ints: TypeAlias = NDArray[Any]
"""int32 if the sums of 8-bit grey fit, int64 for 16-bit grey."""
Greys: TypeAlias = NDArray[Any]
"""uint8 or uint16."""

Int: TypeAlias = int | np.integer[Any]
Real: TypeAlias = float | np.floating[Any]

CACHE_LINE_BYTES = 64
"""Bytes of a cache line of the processors that the kernels run on."""


def aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Return zeros aligned to a cache line, because vectors that straddle two lines cost twice."""
    dtype = np.dtype(dtype)
    n_bytes = dtype.itemsize * math.prod(shape)
    room = np.zeros(n_bytes + CACHE_LINE_BYTES, np.uint8)
    start = -room.__array_interface__["data"][0] % CACHE_LINE_BYTES
    return room[start : start + n_bytes].view(dtype).reshape(shape)


# ----------------------------------------------------------------------------------------------------------- intrinsics


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
