"""The pixels of a defect: how high it is, which of them are over half of that, and the ellipse they make. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from wafer_viewer.measure.defects.matched_filters import SHARP, SOFT
from wafer_viewer.measure.defects.segmentation import DefectPiece, Floats, Mask, Pixels

HALF, PICTURE_SURE = 0.5, 5.5
"""In deviations: what stands out in the picture less may be its noise."""
THIN = 3.0
HEIGHT_SHARE, HEIGHT_SURE = 0.4, 4.5
"""Of the score, and in deviations: where heights show less than both, and stand out of the noise of their place by less
than so much too, all pixels that differ are the outline."""
CLEAR_PX, APART_PX = 4, 5
"""Fewer pixels that stand out in the picture show no shape; what lies so far from all others is apart from them."""


@dataclass(frozen=True, slots=True, eq=False)
class Gathered(Pixels):
    """The pieces of one defect as one list of pixels; first: the one with the highest score."""

    first: DefectPiece
    peaks: dict[str, float]

    @classmethod
    def of(cls, pieces: Sequence[DefectPiece]) -> Gathered:
        """All pixels; what cannot be added up is that of the piece with the highest score."""
        joined = (np.concatenate([getattr(piece, one.name) for piece in pieces]) for one in fields(Pixels))
        layers = {layer for piece in pieces for layer in piece.peaks}
        peaks = {layer: max(piece.peaks.get(layer, 0.0) for piece in pieces) for layer in layers}
        return cls(*joined, first=max(pieces, key=lambda piece: piece.score), peaks=peaks)

    @property
    def pictured(self) -> Mask | None:
        """The pixels that stand out in the picture; None where these are too few to show a shape."""
        clear = self.clear > 0
        return clear if np.count_nonzero(clear) >= CLEAR_PX else None


@dataclass(frozen=True, slots=True)
class DefectOutline:
    """The ellipse that has the moments of some pixels, and how far they reach along its major axis."""

    x_um: float
    y_um: float
    major_um: float
    minor_um: float
    angle_deg: float
    area_um2: float

    @property
    def around_um(self) -> float:
        """Its circumference, by Ramanujan's formula."""
        a, b = self.major_um / 2, self.minor_um / 2
        return math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))


def height_of(whole: Gathered, pixel_um: float) -> tuple[float, Mask]:
    """The signed peak over the reference, and which pixels are over half of it; all where nothing was measured."""
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
    """What stands out in the picture, where most of it lies apart from the heights: two things that were put together,
    of which neither shall be lost."""
    from scipy.spatial import KDTree

    pictured = whole.pictured
    if pictured is None or max(whole.peaks.get(layer, 0.0) for layer in (SHARP, SOFT)) < PICTURE_SURE:
        return np.zeros(len(inside), bool)
    heights, seen = (np.stack([whole.x_um[some], whole.y_um[some]], axis=1) for some in (inside, pictured))
    away_um, _ = KDTree(heights).query(seen)
    return pictured if np.mean(away_um > apart_um) > HALF else np.zeros(len(inside), bool)


def _peak(whole: Gathered, values: Floats) -> float:
    """The larger extreme; where both are about as large, the one to whose side most of what the picture shows lies.

    Focus errs both ways round the rim of what is dark or bright.
    """
    upper, lower = float(values.max()), float(values.min())
    high, low = max(upper, 0.0), max(-lower, 0.0)
    lying = whole.z_um if whole.pictured is None else whole.z_um[whole.pictured]
    lying = lying[np.isfinite(lying)]
    if min(high, low) <= HALF * max(high, low) or not lying.size:
        return upper if upper >= -lower else lower
    return upper if float(np.median(lying)) >= 0 else lower


def outline_of(x_um: Floats, y_um: Floats, pixel_um: float) -> DefectOutline:
    """By moments; an own pixel has a moment too. Thin things are as long as they reach, and nothing is longer."""
    one = ellipse_of(x_um, y_um, np.ones(len(x_um)), pixel_um)
    angle = math.radians(one.angle_deg)
    along = (x_um - one.x_um) * math.cos(angle) + (y_um - one.y_um) * math.sin(angle)
    reach = float(np.ptp(along)) + pixel_um
    if one.major_um <= THIN * one.minor_um:
        return replace(one, major_um=min(one.major_um, reach), minor_um=min(one.minor_um, reach))
    return replace(one, major_um=reach, minor_um=min(one.minor_um, one.area_um2 / reach))


def ellipse_of(x_um: Floats, y_um: Floats, weight: Floats, pixel_um: float) -> DefectOutline:
    """The ellipse with the second moments of weighted pixels."""
    x, y = float(np.average(x_um, weights=weight)), float(np.average(y_um, weights=weight))
    own = pixel_um**2 / 12
    xx = float(np.average((x_um - x) ** 2, weights=weight)) + own
    yy = float(np.average((y_um - y) ** 2, weights=weight)) + own
    xy = float(np.average((x_um - x) * (y_um - y), weights=weight))
    middle, half = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    angle = 0.5 * math.atan2(2 * xy, xx - yy)
    major, minor = 4 * math.sqrt(middle + half), 4 * math.sqrt(max(own, middle - half))
    return DefectOutline(x, y, major, minor, math.degrees(angle), len(x_um) * pixel_um**2)
