"""Drawing primitives of the scenes: edges, bars and gratings, antialiased over the sample footprint.

A hard edge sampled on a lattice would alias from field to field; averaged over the footprint (a box) it does not.
"""

from __future__ import annotations

import math

from wafer_viewer.numerics.jit import fast_kernel


@fast_kernel
def inside(distance: float, footprint: float) -> float:
    """Return the share of a sample inside an edge; distance grows inwards."""
    return min(max(distance / footprint + 0.5, 0.0), 1.0)


@fast_kernel
def wrapped(x: float, period: float) -> float:
    """Return x modulo the period, in [0, period)."""
    return x - period * math.floor(x / period)


@fast_kernel
def bar(x: float, start: float, stop: float, footprint: float) -> float:
    """Return the share of a sample between start and stop."""
    return inside(x - start, footprint) * inside(stop - x, footprint)


@fast_kernel
def rectangle(x: float, y: float, left: float, right: float, bottom: float, top: float, footprint: float) -> float:
    """Return the share of a sample within a rectangle."""
    return bar(x, left, right, footprint) * bar(y, bottom, top, footprint)


@fast_kernel
def bars(x: float, period: float, duty: float, footprint: float) -> float:
    """Return the share of a sample on bars that fill the first duty of every period."""
    phase = wrapped(x, period)
    return bar(phase, 0.0, duty * period, footprint) + inside(phase - period, footprint)


@fast_kernel
def blend(a: float, b: float, share: float) -> float:
    """Return the linear blend: a at share 0, b at share 1."""
    return a + (b - a) * share
