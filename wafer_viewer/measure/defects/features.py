"""Outline of a defect, and its shape features for the classification rules. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from wafer_viewer.measure.defects.matched_filters import SHARP, SOFT
from wafer_viewer.measure.defects.segmentation import DefectPiece, DefectPixels, Floats, Mask, evidence_of
from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.inspection.defect_classes import DefectShape


@dataclass(frozen=True, slots=True)
class OutlineParameters:
    """Limits of the outline and of the shape features of a defect.

    Parameters
    ----------
    half : float
        Fraction of the peak that bounds the outline; also the fraction of pixels, or of the higher extreme,
        that decides between two.
    picture_sure : float
        Lower limit of a reliable image score, in deviations.
    thin : float
        Ratio of major to minor axis above which a defect is thin: its length is the extent of its pixels.
    height_share : float
        Height score, relative to the best score, below which heights are too faint to define the outline.
    height_sure : float
        Upper limit of that height score, in deviations. If the height peak is also within so many deviations of
        its local noise, the outline contains all pixels that differ.
    clear_px : int, px
        Smallest number of pixels with image contrast that define a shape.
    apart_px : float, px
        Distance from which pixels are separate.
    edge_px : float, px
        Distance from the die's edge within which a pixel lies on it.
    crossing : float
        Fraction of pixels further out in the street above which a defect crosses the edge.
    flank : tuple[float, float]
        Range of heights, relative to the peak, in which the steepness is taken.
    least_slopes : int
        Smallest number of slopes for a steepness.

    Notes
    -----
    `tests/bench/bench_defects_truth.py` compares class and size with those of the planted defects.
    """

    half: float = 0.5
    picture_sure: float = 5.5
    thin: float = 3.0
    height_share: float = 0.4
    height_sure: float = 4.5
    clear_px: int = 4
    apart_px: float = 5
    edge_px: float = 2.0
    crossing: float = 0.1
    flank: tuple[float, float] = (0.3, 0.7)
    least_slopes: int = 3


OUTLINE = OutlineParameters()


@dataclass(frozen=True, slots=True, eq=False)
class Gathered(DefectPixels):
    """The pieces of one defect as one list of pixels; first: the piece with the highest score."""

    first: DefectPiece
    peaks: dict[str, float]

    @classmethod
    def of(cls, pieces: Sequence[DefectPiece]) -> Gathered:
        """Concatenate the pixels of pieces; scalar attributes are those of the piece with the highest score."""
        joined = (np.concatenate([getattr(piece, one.name) for piece in pieces]) for one in fields(DefectPixels))
        layers = {layer for piece in pieces for layer in piece.peaks}
        peaks = {layer: max(piece.peaks.get(layer, 0.0) for piece in pieces) for layer in layers}
        return cls(*joined, first=max(pieces, key=lambda piece: piece.score), peaks=peaks)

    @property
    def pictured(self) -> Mask | None:
        """Mask of the pixels with image contrast; None where they are too few to define a shape."""
        clear = self.clear > 0
        return clear if np.count_nonzero(clear) >= OUTLINE.clear_px else None


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


def height_of(merged: Gathered, pixel_um: float) -> tuple[float, Mask]:
    """Return the signed peak over the reference and the mask of pixels above half of it; all if unmeasured."""
    finite = np.isfinite(merged.smooth_um)
    if not finite.any():
        return 0.0, np.ones(len(merged.x_um), bool)
    height_um = _peak(merged, merged.smooth_um[finite])
    faint = merged.peaks.get("height", 0.0) < min(OUTLINE.height_sure, OUTLINE.height_share * merged.first.score)
    if faint and abs(height_um) < OUTLINE.height_sure * merged.first.noise_um:
        return height_um, np.ones(len(merged.x_um), bool)
    with np.errstate(invalid="ignore"):
        inside = finite & (merged.smooth_um * math.copysign(1, height_um) >= OUTLINE.half * abs(height_um))
    return height_um, inside | _measured_elsewhere(merged, inside, OUTLINE.apart_px * pixel_um)


def _measured_elsewhere(merged: Gathered, inside: Mask, apart_um: float) -> Mask:
    """Return the pixels with image contrast if most of them are apart from the height pixels.

    Two defects were then merged, and both must be included.
    """
    from scipy.spatial import KDTree

    pictured = merged.pictured
    if pictured is None or max(merged.peaks.get(layer, 0.0) for layer in (SHARP, SOFT)) < OUTLINE.picture_sure:
        return np.zeros(len(inside), bool)
    heights, measured = (np.stack([merged.x_um[some], merged.y_um[some]], axis=1) for some in (inside, pictured))
    away_um, _ = KDTree(heights).query(measured)
    return pictured if np.mean(away_um > apart_um) > OUTLINE.half else np.zeros(len(inside), bool)


def _peak(merged: Gathered, values: Floats) -> float:
    """Return the larger extreme; if both are similar, the one with the sign of the median height in the image pixels.

    Focus errors have both signs around the rim of dark or bright areas.
    """
    upper, lower = float(values.max()), float(values.min())
    high, low = max(upper, 0.0), max(-lower, 0.0)
    lying = merged.z_um if merged.pictured is None else merged.z_um[merged.pictured]
    lying = lying[np.isfinite(lying)]
    if min(high, low) <= OUTLINE.half * max(high, low) or not lying.size:
        return upper if upper >= -lower else lower
    return upper if float(np.median(lying)) >= 0 else lower


def outline_of(x_um: Floats, y_um: Floats, pixel_um: float) -> DefectOutline:
    """Return the outline by moments, including that of a pixel; limited by, and for thin ones equal to, the extent."""
    one = ellipse_of(x_um, y_um, np.ones(len(x_um)), pixel_um)
    angle = math.radians(one.angle_deg)
    along = (x_um - one.x_um) * math.cos(angle) + (y_um - one.y_um) * math.sin(angle)
    reach = float(np.ptp(along)) + pixel_um
    if one.major_um <= OUTLINE.thin * one.minor_um:
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


def shape_of(
    merged: Gathered,
    inside: Mask,
    outline: DefectOutline,
    height_um: float,
    cells: CellGrid,
    recipe: DefectRecipe,
    on_dies: bool,
) -> DefectShape:
    """Return the shape features of one defect; inside: mask of its pixels above half of its height."""
    left = (merged.z_um - merged.smooth_um)[inside]
    finite = np.isfinite(left)
    rough = float(np.sqrt(np.mean(left[finite] ** 2))) if finite.any() else 0.0
    die_um2 = cells.grid.width_um * cells.grid.height_um
    return DefectShape(
        height_um=height_um,
        mean_height_um=mean_height_um(merged, inside),
        score=merged.first.score,
        area_um2=outline.area_um2,
        major_um=outline.major_um,
        minor_um=outline.minor_um,
        picture_ratio=_picture_ratio(merged, cells.pixel_um),
        roughness_ratio=rough / merged.first.noise_um if merged.first.noise_um > 0 else 1.0,
        steepness=_steepness(merged, height_um, outline),
        on_edge_fraction=_on_edge(merged, inside, cells) if on_dies else 0.0,
        die_fraction=min(1.0, outline.area_um2 / die_um2) if on_dies else 0.0,
        unmeasured_fraction=float(np.isnan(merged.z_um).mean()),
        evidence=evidence_of(merged.peaks, recipe.threshold_sigma),
        height_score=merged.peaks.get("height", 0.0),
        picture_score=merged.peaks.get("picture", 0.0),
        detail_score=merged.peaks.get("detail", 0.0),
        pixel_um=cells.pixel_um,
    )


def mean_height_um(merged: Gathered, inside: Mask) -> float:
    """Return the mean height over the defect's area, 0 where no height is known."""
    values = merged.smooth_um[inside]
    return float(np.nanmean(values)) if np.isfinite(values).any() else 0.0


def _picture_ratio(merged: Gathered, pixel_um: float) -> float:
    """Return length over width by the moments of the image contrast, which no focus window blurs; 0 if none."""
    clear = merged.pictured
    if clear is None:
        return 0.0
    ellipse = ellipse_of(merged.x_um[clear], merged.y_um[clear], merged.clear[clear], pixel_um)
    return max(ellipse.major_um, pixel_um) / max(ellipse.minor_um, pixel_um)


def _steepness(merged: Gathered, height_um: float, outline: DefectOutline) -> float:
    """Return the median slope at about half of the peak height, normalised to 1 for a cone; 0 if unknown."""
    if height_um == 0:
        return 0.0
    share = merged.smooth_um / height_um
    with np.errstate(invalid="ignore"):
        slopes = merged.slope[(share > OUTLINE.flank[0]) & (share < OUTLINE.flank[1])]
    slopes = slopes[np.isfinite(slopes)]
    return (
        float(np.median(slopes)) * outline.minor_um / 2 / abs(height_um) if len(slopes) >= OUTLINE.least_slopes else 0.0
    )


def _on_edge(merged: Gathered, inside: Mask, cells: CellGrid) -> float:
    """Return the fraction of the defect's border on the die's edge, from the number of its pixels near that edge.

    The pixels are those with image contrast, because walls have few heights. A defect that continues into the street
    crosses the edge and has a fraction of 0.
    """
    its = inside if merged.pictured is None else merged.pictured
    pixel_um, near = cells.pixel_um, OUTLINE.edge_px * cells.pixel_um
    u, v = merged.u_um[its], merged.v_um[its]
    within = np.minimum.reduce((u, cells.grid.width_um - u, v, cells.grid.height_um - v))
    if np.mean(within < -near) > OUTLINE.crossing:
        return 0.0
    along_um = float(np.count_nonzero(np.abs(within) <= near)) * pixel_um**2 / (2 * near)
    around = ellipse_of(merged.x_um[its], merged.y_um[its], np.ones(len(u)), pixel_um).around_um
    return min(1.0, along_um / max(pixel_um, around))
