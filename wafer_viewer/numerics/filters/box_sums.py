"""Sliding sums along a row for any odd window, used by the focus measures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Int64s, Wholes
from wafer_viewer.numerics.jit import inlined_part, lean_part

AHEAD = 64
"""Padding behind each row, for loops with even trip counts that read ahead."""


def window_pieces(window: int) -> NDArray[np.int64]:
    """Return the decomposition of a window into pieces of 9, 3 and 1: 3 or 5 rows of (power of three, offset)."""
    found: list[tuple[int, int]] = []
    done = 0
    for power in (2, 1, 0):
        while 3**power < window and done + 3**power <= window:
            found.append((power, done))
            done += 3**power
    return np.array(found, np.int64)


# Numba widens the sum of two int32 to int64, which halves the lanes of a vector: every operation is cast back.


@inlined_part
def box(sums: Wholes, pieces: Int64s, out: Wholes) -> None:
    """Sliding sum of the row sums[0] over the window, with the fewest additions that its pieces allow.

    sums: [4, row]; the other rows are overwritten.
    """
    if pieces[0, 0] > 0:
        _add_neighbours(sums[0], sums[1])
    if pieces[0, 0] > 1:
        _add_three(sums[1], sums[1, 3:], sums[1, 6:], sums[2])
    first = sums[pieces[0, 0]]
    last = len(pieces) - 2
    if last > 1:
        _add_three(first, sums[pieces[1, 0], pieces[1, 1] :], sums[pieces[2, 0], pieces[2, 1] :], sums[3])
        first = sums[3]
    _add_three(first, sums[pieces[last, 0], pieces[last, 1] :], sums[pieces[last + 1, 0], pieces[last + 1, 1] :], out)


@lean_part
def _add_three(a: Wholes, b: Wholes, c: Wholes, out: Wholes) -> None:
    i = a.dtype.type
    for x in range(min(out.size, c.size)):
        out[x] = i(i(a[x] + b[x]) + c[x])


@lean_part
def _add_neighbours(row: Wholes, out: Wholes) -> None:
    """Sums of three neighbours; two of them stay in registers."""
    i = row.dtype.type
    first, second, ahead = row[0], row[1], row[2:]
    for x in range(ahead.size):
        third = ahead[x]
        out[x] = i(i(first + second) + third)
        first, second = second, third
