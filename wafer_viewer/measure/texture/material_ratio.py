"""The Sk family of ISO 25178-2: what the material ratio curve of a surface says of its peaks, core and valleys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats

CORE = 0.4
"""Of the material ratio, the width of the secant whose slope is smallest."""


@dataclass(frozen=True, slots=True)
class Bearing:
    """Core, reduced peak and reduced valley heights in um; fractions of material where peaks end, valleys begin."""

    sk_um: float
    spk_um: float
    svk_um: float
    smr1: float
    smr2: float


def bearing(z_um: Floats) -> Bearing:
    """Of heights [n], each as much of the area as any other.

    The core's line is the one of least squares through the 40 % of the curve whose secant is flattest (the first of
    them where several are); Spk and Svk are the heights of triangles as large as what lies beyond the core.
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
    """Slope over the whole material ratio, and height at ratio 0, of the line through the flattest 40 %."""
    width = max(1, round(CORE * len(curve)))
    first = int(np.argmin(curve[:-width] - curve[width:]))
    part = curve[first : first + width + 1]
    ratio = (first + 0.5 + np.arange(len(part))) / len(curve)
    from_middle = ratio - ratio.mean()
    slope = float(from_middle @ part / (from_middle @ from_middle))
    return slope, float(part.mean() - slope * ratio.mean())


def _triangle(total_um: float, points: int) -> float:
    """Height of a triangle over so many points that holds as much."""
    return 2 * total_um / points if points else 0.0
