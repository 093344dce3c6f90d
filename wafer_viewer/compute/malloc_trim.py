"""Malloc settings that return freed memory to the system at once.

A page in use all day allocates and frees blocks of some hundred kilobytes: tiles, pictures, messages. The C library of
Linux (glibc) adapts to the first ones and keeps such blocks in its heaps. Longer-lived blocks between them fragment the
heaps, so the process only grows: half a day's use took 500 MB that nothing referenced, as tests/bench/bench_soak.py
shows.
"""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_BLOCK = 256 * 1024
"""Bytes from which blocks are mapped: below the size of a tile's picture, above Python's frequent allocations."""


def return_what_is_freed() -> None:
    """Map large blocks separately for the whole process, so that freeing unmaps them; no effect without glibc."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _BLOCK)
        mallopt(_M_TRIM_THRESHOLD, 4 * _BLOCK)
