"""What the viewer frees goes back to the system at once.

A page that is looked at all day makes and drops blocks of some hundred kilobytes: tiles, pictures, messages. The C
library of Linux (glibc) learns from the first ones to keep such blocks in its heaps, where what lives longer lies
between them, and the process only ever grows: half a day's use took 500 MB that nobody held, as
tests/bench/bench_soak.py shows.
"""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_BLOCK = 256 * 1024
"""Bytes from which on a block is the system's own; under a tile's picture, over what Python takes in a hurry."""


def return_what_is_freed() -> None:
    """Have large blocks taken from the system one by one, for the whole process; elsewhere than on glibc nothing."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _BLOCK)
        mallopt(_M_TRIM_THRESHOLD, 4 * _BLOCK)
