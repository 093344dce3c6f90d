"""Randomness that belongs to a place: hashes and value noise of stage coordinates.

Neighbouring fields show the same speck at the same place because every grain of a scene comes from here and from
nothing else: no generator, no state, only the coordinates and a salt that tells one use from another.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float32, int32, uint32

from wafer_viewer.numerics.jit import fast_kernel

UNIT_DEVIATION = np.float32(4.7)  # the standard deviation of smoothed uniform noise is about 1 / 4.7
HALF, TWO, THREE = np.float32(0.5), np.float32(2), np.float32(3)


@fast_kernel
def mixed(h):
    """Scatter the 32 bits of h (Wellons, hash prospector, lowbias32).

    Every operation is cast back: numba widens uint32 arithmetic to 64 bits.
    """
    h = uint32(h ^ (h >> uint32(16)))
    h = uint32(h * uint32(0x7FEB352D))
    h = uint32(h ^ (h >> uint32(15)))
    h = uint32(h * uint32(0x846CA68B))
    return uint32(h ^ (h >> uint32(16)))


@fast_kernel
def chance(i, j, salt):
    """A number in [0, 1) that belongs to the cell (i, j)."""
    a = uint32(uint32(i) * uint32(0x8DA6B343))
    b = uint32(uint32(j) * uint32(0xD8163841))
    c = uint32(uint32(salt) * uint32(0xCB1AB31F))
    return float32(mixed(uint32(a ^ b ^ c)) >> uint32(8)) * float32(1 / 16777216)


@fast_kernel
def smooth(t):
    """The smoothstep that joins cells without a crease, t in [0, 1]."""
    return t * t * (THREE - TWO * t)


@fast_kernel
def grain(x, y, salt):
    """Value noise on unit cells: mean 0, standard deviation about 1, smooth within a cell."""
    column, row = math.floor(x), math.floor(y)
    i, j = int32(column), int32(row)
    a, b = smooth(float32(x - column)), smooth(float32(y - row))
    p, q = chance(i, j, salt), chance(i + 1, j, salt)
    r, s = chance(i, j + 1, salt), chance(i + 1, j + 1, salt)
    low = p + (q - p) * a
    high = r + (s - r) * a
    return (low + (high - low) * b - HALF) * UNIT_DEVIATION
