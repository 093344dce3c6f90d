"""Position-dependent pseudo-random numbers: hashes and value noise of stage coordinates.

Neighbouring fields show the same details, because all randomness of a scene is a function of the coordinates and a salt
for each use, without a generator or state.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel

Integer = int | np.signedinteger[Any]
UNIT_DEVIATION = 4.7  # the standard deviation of smoothed uniform noise is about 1 / 4.7


@fast_kernel
def mixed(h: np.uint32) -> np.uint32:
    """Mix the 32 bits of h (Wellons, hash prospector, lowbias32).

    Every operation is cast back, because numba widens uint32 arithmetic to 64 bits.
    """
    h = np.uint32(h ^ (h >> np.uint32(16)))
    h = np.uint32(h * np.uint32(0x7FEB352D))
    h = np.uint32(h ^ (h >> np.uint32(15)))
    h = np.uint32(h * np.uint32(0x846CA68B))
    return np.uint32(h ^ (h >> np.uint32(16)))


@fast_kernel
def chance(i: int, j: int, salt: Integer) -> float:
    """Return the hash of the cell (i, j) as a number in [0, 1)."""
    a = np.uint32(np.uint32(i) * np.uint32(0x8DA6B343))
    b = np.uint32(np.uint32(j) * np.uint32(0xD8163841))
    c = np.uint32(np.uint32(salt) * np.uint32(0xCB1AB31F))
    return mixed(np.uint32(a ^ b ^ c)) / 4294967296.0


@fast_kernel
def smooth(t: float) -> float:
    """Return the smoothstep that joins cells without a crease, t in [0, 1]."""
    return t * t * (3.0 - 2.0 * t)


@fast_kernel
def grain(x: float, y: float, salt: Integer) -> float:
    """Return value noise on unit cells: mean 0, standard deviation about 1, smooth within a cell."""
    i, j = math.floor(x), math.floor(y)
    across, up = smooth(x - i), smooth(y - j)
    low = chance(i, j, salt) * (1.0 - across) + chance(i + 1, j, salt) * across
    high = chance(i, j + 1, salt) * (1.0 - across) + chance(i + 1, j + 1, salt) * across
    return (low + (high - low) * up - 0.5) * UNIT_DEVIATION
