"""Compilation of kernels by numba, location of their cache, and the types of their arguments.

Compiled code is cached in the user's cache folder (``WAFER_VIEWER_CACHE`` overrides it), so a read-only installation
still starts fast and every child process loads what the first one compiled. numba checks only the file of the
outermost kernel for changes, but our kernels inline each other across files. Therefore every state of the sources has
its own folder.
"""

from __future__ import annotations

import functools
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numba
import numpy as np
from numba.core import config as numba_config
from numpy.typing import NDArray

KERNEL_ROOMS = ("numerics", "reconstruct", "rigs/virtual")
_UNCOUNTED: dict[str, Any] = {"_nrt": False}  # numba's runtime with reference counts, an option missing from its stubs
_LEAN: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True, **_UNCOUNTED}
_PART: dict[str, Any] = {"no_cpython_wrapper": True, **_LEAN}
F = TypeVar("F", bound=Callable[..., Any])


def cache_folder() -> Path:
    """Return the folder of compiled kernels, under ``WAFER_VIEWER_CACHE`` or ``~/.cache/wafer-viewer``."""
    home = os.environ.get("WAFER_VIEWER_CACHE")
    base = Path(home) if home else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wafer-viewer"
    return base / "kernels" / source_fingerprint()


def source_fingerprint() -> str:
    """Return eight hex digits that change with any source file of a kernel."""
    package = Path(__file__).parent.parent
    sources = (f for room in KERNEL_ROOMS for f in sorted((package / room).rglob("*.py")))
    return f"{functools.reduce(lambda crc, f: zlib.crc32(f.read_bytes(), crc), sources, 0):08x}"


setattr(numba_config, "CACHE_DIR", str(cache_folder()))  # noqa: B010 - numba makes its settings at run time


def is_anything_compiled() -> bool:
    """Return whether the cache holds any kernel of this state of the sources."""
    return any(cache_folder().rglob("*.nbi"))


def kernel(function: F) -> F:
    """Compile a module-level function once per machine; it runs without the GIL."""
    return cast(F, numba.njit(cache=True, nogil=True)(function))


def fast_kernel(function: F) -> F:
    """Compile a `kernel` with reordered float arithmetic; not for code that tests for NaN."""
    return cast(F, numba.njit(cache=True, nogil=True, fastmath=True)(function))


def bare_kernel(function: F) -> F:
    """Compile a `fast_kernel` that creates no arrays, only views of its arguments, without reference counting.

    Reference counting takes an atomic operation for every view of a row, a third of the time of a kernel that works
    through rows of a picture. Compilation fails if the kernel, or one that it calls, creates an array.
    """
    return cast(F, numba.njit(cache=True, nogil=True, fastmath=True, **_UNCOUNTED)(function))


def lean_kernel(function: F) -> F:
    """Compile a `bare_kernel` that preserves the order of float arithmetic; division by zero gives infinity or NaN."""
    return cast(F, numba.njit(cache=True, nogil=True, **_LEAN)(function))


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
    n_bytes = dtype.itemsize * int(np.prod(shape))
    room = np.zeros(n_bytes + CACHE_LINE_BYTES, np.uint8)
    start = -room.ctypes.data % CACHE_LINE_BYTES
    return room[start : start + n_bytes].view(dtype).reshape(shape)
