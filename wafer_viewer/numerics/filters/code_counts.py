"""How often each code occurs in a map of small codes."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Int64s, UInt8s
from wafer_viewer.numerics.jit import lean_kernel


def count_codes(codes: UInt8s, n_codes: int) -> Int64s:
    """The number of pixels of each code from 0 to n_codes - 1, of a map [row, col] that holds no larger ones.

    n_codes: a power of two.
    """
    counts = np.zeros((4, n_codes), np.int64)
    _count(np.ascontiguousarray(codes).ravel(), counts)
    return counts.sum(axis=0)


@lean_kernel
def _count(codes: UInt8s, counts: Int64s) -> None:
    """Four tables in turn: adding to one number again and again waits for the last addition."""
    for i in range(codes.size):
        counts[i & 3, codes[i] & (counts.shape[1] - 1)] += 1
