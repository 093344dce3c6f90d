"""Drawing of the scenes: sheets at stage points, antialiased shapes, and position-dependent noise.

A hard edge sampled on a lattice would alias from field to field; averaged over the footprint (a box) it does not.

Neighbouring fields show the same details, because all randomness of a scene is a function of the coordinates and a salt
for each use, without a generator or state.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import fast_kernel, fast_part


@fast_part
def inside(distance: float, footprint: float) -> float:
    """Return the share of a sample inside an edge; distance grows inwards."""
    return min(max(distance / footprint + 0.5, 0.0), 1.0)


@fast_part
def wrapped(x: float, period: float) -> float:
    """Return x modulo the period, in [0, period)."""
    return x - period * math.floor(x / period)


@fast_part
def bar(x: float, start: float, stop: float, footprint: float) -> float:
    """Return the share of a sample between start and stop."""
    return inside(x - start, footprint) * inside(stop - x, footprint)


@fast_part
def rectangle(x: float, y: float, left: float, right: float, bottom: float, top: float, footprint: float) -> float:
    """Return the share of a sample within a rectangle."""
    return bar(x, left, right, footprint) * bar(y, bottom, top, footprint)


@fast_part
def bars(x: float, period: float, duty: float, footprint: float) -> float:
    """Return the share of a sample on bars that fill the first duty of every period."""
    phase = wrapped(x, period)
    return bar(phase, 0.0, duty * period, footprint) + inside(phase - period, footprint)


@fast_part
def blend(a: float, b: float, share: float) -> float:
    """Return the linear blend: a at share 0, b at share 1."""
    return a + (b - a) * share


Points = NDArray[np.float64]
"""Stage coordinates in um, [row, col]."""
Plane = NDArray[np.float32]
"""Heights in um, radiances as shares of white, or cover as a share, [row, col]."""


class SceneSheets(NamedTuple):
    """Two sheets, A over B, both defined at every point, and the visible share of A from straight above."""

    height_a: Plane
    radiance_a: Plane
    height_b: Plane
    radiance_b: Plane
    cover: Plane

    def surface_um(self) -> Plane:
        """Return the visible heights from straight above."""
        surface: Plane = np.where(self.cover > 0.5, self.height_a, self.height_b)
        return surface

    def light_a(self) -> Plane:
        """Return the light contribution of sheet A."""
        return self.radiance_a * self.cover

    def light_b(self) -> Plane:
        """Return the light contribution of sheet B where A does not cover it."""
        return self.radiance_b - np.multiply(self.radiance_b, self.cover)

    def radiance(self) -> Plane:
        """Return the image with everything in focus."""
        return self.light_a() + self.light_b()


def empty_sheets(shape: tuple[int, ...]) -> SceneSheets:
    """Return uninitialized sheets for a kernel."""
    return SceneSheets(*(np.empty(shape, np.float32) for _ in SceneSheets._fields))


Integer = int | np.signedinteger[Any]
UNIT_DEVIATION = 4.7  # the standard deviation of smoothed uniform noise is about 1 / 4.7


@fast_part
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


@fast_part
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
