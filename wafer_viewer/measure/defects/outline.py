"""Outline of a defect: peak height, the pixels above half of it, and their ellipse. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from wafer_viewer.measure.defects.matched_filters import SHARP, SOFT
from wafer_viewer.measure.defects.segmentation import DefectPiece, Floats, Mask, Pixels

HALF, PICTURE_SURE = 0.5, 5.5
"""Fraction of the peak that bounds the outline, and lower limit of a reliable image score, in deviations."""
THIN = 3.0
HEIGHT_SHARE, HEIGHT_SURE = 0.4, 4.5
"""Fraction of the score, and deviations, below which heights are too faint to define the outline.

If the height peak is also within so many deviations of its local noise, the outline contains all pixels that differ.
"""
CLEAR_PX, APART_PX = 4, 5
"""Smallest number of pixels with image contrast that define a shape, and distance from which pixels are separate."""


@dataclass(frozen=True, slots=True, eq=False)
class Gathered(Pixels):
    """The pieces of one defect as one list of pixels; first: the piece with the highest score."""

    first: DefectPiece
    peaks: dict[str, float]

    @classmethod
    def of(cls, pieces: Sequence[DefectPiece]) -> Gathered:
        """Concatenate the pixels of pieces; scalar attributes are those of the piece with the highest score."""
        joined = (np.concatenate([getattr(piece, one.name) for piece in pieces]) for one in fields(Pixels))
        layers = {layer for piece in pieces for layer in piece.peaks}
        peaks = {layer: max(piece.peaks.get(layer, 0.0) for piece in pieces) for layer in layers}
        return cls(*joined, first=max(pieces, key=lambda piece: piece.score), peaks=peaks)

    @property
    def pictured(self) -> Mask | None:
        """Mask of the pixels with image contrast; None where they are too few to define a shape."""
        clear = self.clear > 0
        return clear if np.count_nonzero(clear) >= CLEAR_PX else None


@dataclass(frozen=True, slots=True)
class DefectOutline:
    """Ellipse with the moments of some pixels; the major axis of thin ones is their extent."""

    x_um: float
    y_um: float
    major_um: float
    minor_um: float
    angle_deg: float
    area_um2: float

    @property
    def around_um(self) -> float:
        """Circumference, by Ramanujan's formula."""
        a, b = self.major_um / 2, self.minor_um / 2
        return math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))


def height_of(whole: Gathered, pixel_um: float) -> tuple[float, Mask]:
    """Return the signed peak over the reference and the mask of pixels above half of it; all if unmeasured."""
    known = np.isfinite(whole.smooth_um)
    if not known.any():
        return 0.0, np.ones(len(whole.x_um), bool)
    height_um = _peak(whole, whole.smooth_um[known])
    faint = whole.peaks.get("height", 0.0) < min(HEIGHT_SURE, HEIGHT_SHARE * whole.first.score)
    if faint and abs(height_um) < HEIGHT_SURE * whole.first.noise_um:
        return height_um, np.ones(len(whole.x_um), bool)
    with np.errstate(invalid="ignore"):
        inside = known & (whole.smooth_um * math.copysign(1, height_um) >= HALF * abs(height_um))
    return height_um, inside | _seen_elsewhere(whole, inside, APART_PX * pixel_um)


def _seen_elsewhere(whole: Gathered, inside: Mask, apart_um: float) -> Mask:
    """Return the pixels with image contrast if most of them are apart from the height pixels.

    Two defects were then merged, and both must be included.
    """
    from scipy.spatial import KDTree

    pictured = whole.pictured
    if pictured is None or max(whole.peaks.get(layer, 0.0) for layer in (SHARP, SOFT)) < PICTURE_SURE:
        return np.zeros(len(inside), bool)
    heights, seen = (np.stack([whole.x_um[some], whole.y_um[some]], axis=1) for some in (inside, pictured))
    away_um, _ = KDTree(heights).query(seen)
    return pictured if np.mean(away_um > apart_um) > HALF else np.zeros(len(inside), bool)


def _peak(whole: Gathered, values: Floats) -> float:
    """Return the larger extreme; if both are similar, the one with the sign of the median height in the image pixels.

    Focus errors have both signs around the rim of dark or bright areas.
    """
    upper, lower = float(values.max()), float(values.min())
    high, low = max(upper, 0.0), max(-lower, 0.0)
    lying = whole.z_um if whole.pictured is None else whole.z_um[whole.pictured]
    lying = lying[np.isfinite(lying)]
    if min(high, low) <= HALF * max(high, low) or not lying.size:
        return upper if upper >= -lower else lower
    return upper if float(np.median(lying)) >= 0 else lower


def outline_of(x_um: Floats, y_um: Floats, pixel_um: float) -> DefectOutline:
    """Return the outline by moments, including that of a pixel; limited by, and for thin ones equal to, the extent."""
    one = ellipse_of(x_um, y_um, np.ones(len(x_um)), pixel_um)
    angle = math.radians(one.angle_deg)
    along = (x_um - one.x_um) * math.cos(angle) + (y_um - one.y_um) * math.sin(angle)
    reach = float(np.ptp(along)) + pixel_um
    if one.major_um <= THIN * one.minor_um:
        return replace(one, major_um=min(one.major_um, reach), minor_um=min(one.minor_um, reach))
    return replace(one, major_um=reach, minor_um=min(one.minor_um, one.area_um2 / reach))


def ellipse_of(x_um: Floats, y_um: Floats, weight: Floats, pixel_um: float) -> DefectOutline:
    """Return the ellipse with the second moments of weighted pixels."""
    x, y = float(np.average(x_um, weights=weight)), float(np.average(y_um, weights=weight))
    own = pixel_um**2 / 12
    xx = float(np.average((x_um - x) ** 2, weights=weight)) + own
    yy = float(np.average((y_um - y) ** 2, weights=weight)) + own
    xy = float(np.average((x_um - x) * (y_um - y), weights=weight))
    middle, half = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    angle = 0.5 * math.atan2(2 * xy, xx - yy)
    major, minor = 4 * math.sqrt(middle + half), 4 * math.sqrt(max(own, middle - half))
    return DefectOutline(x, y, major, minor, math.degrees(angle), len(x_um) * pixel_um**2)
