"""Compilation of kernels by numba, location of their cache, and the types of their arguments.

Compiled code is loaded from the installed package, which holds what was compiled when its wheel was built, and
otherwise from the user's cache folder (``WAFER_VIEWER_CACHE`` overrides it), where every process writes what it had to
compile. numba recognises a change by the path and the time of the file of the outermost kernel; but our kernels inline
each other across files, and an installation changes paths and times. Therefore every state of the sources, of numba,
of Python and of the processor has its own folder, and nothing else is compared.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numpy.typing import NDArray

INSTALLED = Path(__file__).parent / "compiled"
"""Kernels that were compiled for the wheel: a folder for each state, as in the user's cache folder."""
KERNEL_ROOMS = ("numerics", "reconstruct", "rigs/virtual")
_UNCOUNTED: dict[str, Any] = {"_nrt": False}  # numba's runtime with reference counts, an option missing from its stubs
_LEAN: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True, **_UNCOUNTED}
_PART: dict[str, Any] = {"no_cpython_wrapper": True, **_LEAN}
F = TypeVar("F", bound=Callable[..., Any])


def cache_folder() -> Path:
    """Return the folder of compiled kernels, under ``WAFER_VIEWER_CACHE`` or ``~/.cache/wafer-viewer``."""
    home = os.environ.get("WAFER_VIEWER_CACHE")
    base = Path(home) if home else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wafer-viewer"
    return base / "kernels" / kernel_state()


@functools.cache
def kernel_state() -> str:
    """Return a name that changes with all that compiled code depends on."""
    target = numba.__version__, sys.implementation.cache_tag, llvm.get_host_cpu_name(), _cpu_features()
    return f"{source_fingerprint()}-{zlib.crc32(repr(target).encode()):08x}"


def source_fingerprint() -> str:
    """Return eight hex digits that change with any source file of a kernel."""
    package = Path(__file__).parent.parent
    sources = (f for room in KERNEL_ROOMS for f in sorted((package / room).rglob("*.py")))
    return f"{functools.reduce(lambda crc, f: zlib.crc32(f.read_bytes(), crc), sources, 0):08x}"


def _cpu_features() -> str:
    try:
        return str(llvm.get_host_cpu_features().flatten())
    except RuntimeError:  # the processor does not tell
        return ""


def is_anything_compiled() -> bool:
    """Return whether any kernel is compiled for this state of sources, numba, Python and processor."""
    return any(any(folder.rglob("*.nbi")) for folder in (INSTALLED / kernel_state(), cache_folder()))


class _Location:
    """Location of the compiled code of a function for numba, and the state that it must be of."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.module, self._line = function.__module__, function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Location:
        return cls(py_func)

    def get_cache_path(self) -> str:
        return str(cache_folder() / self.module)

    def ensure_cache_path(self) -> None:
        Path(self.get_cache_path()).mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        return kernel_state()

    def get_disambiguator(self) -> str:
        return str(self._line)


class _KernelFiles(CompileResultCacheImpl):
    _locator_classes = (_Location,)


class _KernelCache(FunctionCache):
    """Compiled code of one function: that of the installed package, then that of the user's cache folder."""

    _impl_class = _KernelFiles

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        folder = str(INSTALLED / kernel_state() / function.__module__)
        self._installed = IndexDataCacheFile(folder, self._impl.filename_base, kernel_state())

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        key = self._index_key(sig, target_context.codegen())
        for files in (self._installed, self._cache_file):
            with contextlib.suppress(OSError):  # a folder that may not be read
                if (data := files.load(key)) is not None:
                    return self._impl.rebuild(target_context, data)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(OSError):  # a full disk, a folder that may not be written: compiled anew next time
            super().save_overload(sig, data)


def _cached(function: F, **options: Any) -> F:
    """Compile a function without the GIL, or load its compiled code."""
    dispatcher: Any = numba.njit(nogil=True, **options)(function)
    dispatcher._cache = _KernelCache(function)  # as `cache=True` does with a cache of numba's own
    return cast(F, dispatcher)


def kernel(function: F) -> F:
    """Compile a module-level function once per machine; it runs without the GIL."""
    return _cached(function)


def fast_kernel(function: F) -> F:
    """Compile a `kernel` with reordered float arithmetic; not for code that tests for NaN."""
    return _cached(function, fastmath=True)


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
