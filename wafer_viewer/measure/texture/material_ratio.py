"""Sk parameters of ISO 25178-2, from the material ratio curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats

CORE = 0.4
"""Width of the secant of smallest slope, as a fraction of the material ratio."""


@dataclass(frozen=True, slots=True)
class Bearing:
    """Core, reduced peak and reduced valley heights in um; material ratios Smr1 and Smr2 as fractions."""

    sk_um: float
    spk_um: float
    svk_um: float
    smr1: float
    smr2: float


def bearing(z_um: Floats) -> Bearing:
    """Return the Sk parameters of heights [n] of equal area.

    The core line is the least-squares line through the 40 % of the curve with the flattest secant (the first of equal
    ones); Spk and Svk are the heights of triangles with the area of the curve beyond the core.
    """
    curve = np.sort(z_um)[::-1]
    slope, top = _line(curve)
    foot = top + slope
    above, below = curve[curve > top], curve[curve < foot]
    n = len(curve)
    return Bearing(
        sk_um=top - foot,
        spk_um=_triangle(float(np.sum(above - top)), len(above)),
        svk_um=_triangle(float(np.sum(foot - below)), len(below)),
        smr1=len(above) / n,
        smr2=1 - len(below) / n,
    )


def _line(curve: Floats) -> tuple[float, float]:
    """Return slope per unit material ratio, and height at ratio 0, of the line through the flattest 40 %."""
    width = max(1, round(CORE * len(curve)))
    first = int(np.argmin(curve[:-width] - curve[width:]))
    part = curve[first : first + width + 1]
    ratio = (first + 0.5 + np.arange(len(part))) / len(curve)
    from_middle = ratio - ratio.mean()
    slope = float(from_middle @ part / (from_middle @ from_middle))
    return slope, float(part.mean() - slope * ratio.mean())


def _triangle(total_um: float, points: int) -> float:
    """Return the height of a triangle with the given base, in points, and area."""
    return 2 * total_um / points if points else 0.0
