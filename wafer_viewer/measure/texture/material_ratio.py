"""Material ratio curve of heights: its core, and volumes of material and void."""

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


def material_ratio_curve(z_um: Floats) -> Floats:
    """Return heights [n] of equal area from the highest to the lowest: the height over each material ratio."""
    return np.sort(z_um)[::-1]


def bearing(curve: Floats) -> Bearing:
    """Return the Sk parameters of a material ratio curve.

    The core line is the least-squares line through the 40 % of the curve with the flattest secant (the first of equal
    ones); Spk and Svk are the heights of triangles with the area of the curve beyond the core.
    """
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


PEAKS_END, VALLEYS_BEGIN = 0.1, 0.8
"""Material ratios between which is the core, for volumes (ISO 25178-3, default values)."""
EXTREME_FROM, EXTREME_TO = 0.025, 0.5
"""Material ratios of the peak extreme height Sxp (the same)."""


def volumes(curve: Floats) -> dict[str, float]:
    """Return material and void volumes per area, and Sxp, in um, of a material ratio curve."""
    ratios = (PEAKS_END, VALLEYS_BEGIN, EXTREME_FROM, EXTREME_TO)
    at_peaks, at_valleys, extreme, middle = (height_at(curve, ratio) for ratio in ratios)
    levels, mean_um, n = (at_peaks, at_valleys), float(curve.mean()), len(curve)
    above = (curve[: n - int(np.searchsorted(curve[::-1], level))] for level in levels)
    material = [float(np.sum(part - level)) / n for part, level in zip(above, levels, strict=True)]
    void = [volume + level - mean_um for volume, level in zip(material, levels, strict=True)]
    return {
        "vmp": material[0],
        "vmc": material[1] - material[0],
        "vvc": void[0] - void[1],
        "vvv": void[1],
        "sxp": float(extreme - middle),
    }


def height_at(curve: Floats, ratio: float) -> float:
    """Return the height over a material ratio, between the two points beside it."""
    place = min(max(ratio * len(curve) - 0.5, 0.0), len(curve) - 1.0)
    before = int(place)
    after = min(before + 1, len(curve) - 1)
    return float(curve[before] + (place - before) * (curve[after] - curve[before]))
