"""One place that says how numba compiles our kernels, and where it keeps them.

The compiled code is cached in the user's cache folder (``WAFER_VIEWER_CACHE`` moves it), so that a read-only
installation still starts fast and every child process loads what the first one compiled. numba looks only at the
file of the outermost kernel when it decides whether a cached one is stale, and ours inline each other across files: so
every state of the sources has a folder of its own.
"""

from __future__ import annotations

import functools
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config as numba_config

KERNEL_ROOMS = ("numerics", "reconstruct", "rigs/virtual")
_UNCOUNTED: dict[str, Any] = {"_nrt": False}  # numba's run time with reference counts, an option its stubs leave out
_LEAN: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True, **_UNCOUNTED}
_PART: dict[str, Any] = {"no_cpython_wrapper": True, **_LEAN}
F = TypeVar("F", bound=Callable[..., Any])


def cache_folder() -> Path:
    """The folder of compiled kernels, under ``WAFER_VIEWER_CACHE`` or else ``~/.cache/wafer-viewer``."""
    home = os.environ.get("WAFER_VIEWER_CACHE")
    base = Path(home) if home else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wafer-viewer"
    return base / "kernels" / source_fingerprint()


def source_fingerprint() -> str:
    """Eight hex digits that change with any source of a kernel."""
    package = Path(__file__).parent.parent
    sources = (f for room in KERNEL_ROOMS for f in sorted((package / room).rglob("*.py")))
    return f"{functools.reduce(lambda crc, f: zlib.crc32(f.read_bytes(), crc), sources, 0):08x}"


setattr(numba_config, "CACHE_DIR", str(cache_folder()))  # noqa: B010 - numba makes its settings at run time


def kernel(function: F) -> F:
    """Compile a module-level function once per machine; it runs without the interpreter's lock."""
    return cast(F, numba.njit(cache=True, nogil=True)(function))


def fast_kernel(function: F) -> F:
    """A `kernel` that may reorder float arithmetic; not for code that looks for NaN."""
    return cast(F, numba.njit(cache=True, nogil=True, fastmath=True)(function))


def bare_kernel(function: F) -> F:
    """A `fast_kernel` that makes no arrays, only views of those it is given: no references to them are counted.

    Counting takes an atomic operation for every view of a row, a third of the time of a kernel that works through rows
    of a picture. Compiling it fails where it, or a kernel that it calls, makes an array.
    """
    return cast(F, numba.njit(cache=True, nogil=True, fastmath=True, **_UNCOUNTED)(function))


def lean_kernel(function: F) -> F:
    """A `bare_kernel` that keeps the order of float arithmetic; what is divided by zero is infinite or NaN."""
    return cast(F, numba.njit(cache=True, nogil=True, **_LEAN)(function))


def lean_part(function: F) -> F:
    """A loop over a row that `lean_kernel`s call: without what Python would need to call it."""
    return cast(F, numba.njit(**_PART)(function))


def inlined_part(function: F) -> F:
    """A part of `lean_kernel`s that hands rows on: called it would copy their descriptions over the stack twice.

    A copy that is read in other pieces than it was written in waits until all that was written before has reached the
    cache, and what was written before is a row of the focus volume. It is copied into its callers before their types
    are known, so that it is compiled with them and not once more alone.
    """
    return cast(F, numba.njit(inline="always", **_PART)(function))


def inline_kernel(function: F) -> F:
    """A small function copied into the kernels that call it."""
    return cast(F, numba.njit(inline="always")(function))
