"""Histogram of a map of small integer codes."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Int64s, UInt8s
from wafer_viewer.numerics.jit import lean_kernel


def count_codes(codes: UInt8s, n_codes: int) -> Int64s:
    """Return the number of pixels of each code from 0 to n_codes - 1, for a map [row, col] without larger codes.

    n_codes: a power of two.
    """
    counts = np.zeros((4, n_codes), np.int64)
    _count(np.ascontiguousarray(codes).ravel(), counts)
    return counts.sum(axis=0)


@lean_kernel
def _count(codes: UInt8s, counts: Int64s) -> None:
    """Count in four alternating tables, because repeated additions to one number wait for each other."""
    for i in range(codes.size):
        counts[i & 3, codes[i] & (counts.shape[1] - 1)] += 1
