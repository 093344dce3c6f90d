"""A defect from the pixels that belong to it: its size, height, volume and class, each as honest as it can be. Pure.

The outline holds the pixels over half of the peak; what is longer than three widths is as long as its pixels reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.classify import classify
from wafer_viewer.measure.defect_pieces import Piece, evidence_of
from wafer_viewer.measure.die_cells import CellGrid
from wafer_viewer.measure.reading import Lines, Reading
from wafer_viewer.model.class_rules import DefectShape
from wafer_viewer.model.defects import RESOLVED_FROM_PX, Defect, DefectRecipe
from wafer_viewer.model.region import Point, Region

Floats = NDArray[np.float64]
HALF = 0.5
THIN = 3.0
HEIGHT_SHARE, HEIGHT_SURE = 0.4, 4.5
"""Of the score, and in deviations: where heights show less than both, and stand out of the noise of their place by less
than so much too, all pixels that differ are the outline."""
NOT_RESOLVED = "Detected, size not resolved: under 20 px."
SIZE_NOTE = "Lengths and area are those over half of the peak."
UNSEEN = "It shows in the picture; most of its heights could not be measured."
EDGE_PX, CROSSING = 2.0, 0.1
U_EDGE_PX = 0.5
"""Where an outline lies, standard uncertainty (k = 1): it is made of whole pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """The pieces of one defect as one list of pixels, float64 [n] each."""

    x_um: Floats
    y_um: Floats
    u_um: Floats
    v_um: Floats
    z_um: Floats
    smooth_um: Floats
    slope: Floats
    first: Piece
    peaks: dict[str, float]

    @classmethod
    def of(cls, pieces: Sequence[Piece]) -> Gathered:
        """All pixels; what cannot be added up is that of the piece with the highest score."""
        names = ("x_um", "y_um", "u_um", "v_um", "z_um", "smooth_um", "slope")
        joined = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in names)
        layers = {layer for piece in pieces for layer in piece.peaks}
        peaks = {layer: max(piece.peaks.get(layer, 0.0) for piece in pieces) for layer in layers}
        return cls(*joined, first=max(pieces, key=lambda piece: piece.score), peaks=peaks)


@dataclass(frozen=True, slots=True)
class Outline:
    """The ellipse that has the moments of some pixels, and how far they reach along its major axis."""

    x_um: float
    y_um: float
    major_um: float
    minor_um: float
    angle_deg: float
    area_um2: float


def defect_of(
    pieces: Sequence[Piece], cells: CellGrid, reading: Reading, recipe: DefectRecipe, on_dies: bool
) -> Defect:
    """One defect from its pieces; on_dies: the cells are dies."""
    whole = Gathered.of(pieces)
    height_um, inside = _height(whole)
    outline = _outline(whole.x_um[inside], whole.y_um[inside], cells.pixel_um * whole_pixel(whole))
    mean_um = float(np.nanmean(whole.smooth_um[inside])) if np.isfinite(whole.smooth_um[inside]).any() else 0.0
    shape = _shape(whole, inside, outline, height_um, mean_um, cells, recipe, on_dies)
    found = classify(shape, recipe.rules)
    unseen = found.kind == "unmeasured" and not whole.first.unmeasured
    if unseen:
        found = classify(replace(shape, unmeasured_fraction=0.0), recipe.rules)
    resolved = outline.major_um >= RESOLVED_FROM_PX * cells.pixel_um or whole.first.unmeasured
    return Defect(
        **reading.told("", 0, *_notes(reading, resolved), *((UNSEEN,) if unseen else ())),
        center=Point(x_um=outline.x_um, y_um=outline.y_um),
        outline=_region(outline, cells.pixel_um),
        kind="unmeasured" if whole.first.unmeasured else found.kind,
        reasons=("no height was measured here",) if whole.first.unmeasured else found.reasons,
        confidence=1.0 if whole.first.unmeasured else confidence(whole.first.score, recipe, found.confidence),
        **_place(outline, cells, on_dies),
        **_sizes(whole, inside, outline, height_um, cells.pixel_um, reading, resolved),
        mean_height_um=mean_um,
        angle_deg=outline.angle_deg,
        score=whole.first.score,
        scale_px=whole.first.scale_px,
        evidence=evidence_of(whole.peaks, recipe.threshold_sigma),
        size_resolved=resolved,
    )


def whole_pixel(whole: Gathered) -> float:
    """How many pixels wide a pixel of the list is: squares stand for unmeasured areas."""
    return whole.first.scale_px if whole.first.unmeasured else 1.0


def confidence(score: float, recipe: DefectRecipe, of_class: float) -> float:
    """How sure it is a defect of this class: one half at the threshold, by the class's own margin beyond."""
    sure = 1 - 0.5 * math.exp(-max(0.0, score - recipe.threshold_sigma) / 2)
    return min(1.0, max(0.0, sure * of_class))


def _height(whole: Gathered) -> tuple[float, NDArray[np.bool_]]:
    """The signed peak over the reference, and which pixels are over half of it; all where nothing was measured."""
    known = np.isfinite(whole.smooth_um)
    if not known.any():
        return 0.0, np.ones(len(whole.x_um), bool)
    values = whole.smooth_um[known]
    upper, lower = float(values.max()), float(values.min())
    height_um = upper if upper >= -lower else lower
    faint = whole.peaks.get("height", 0.0) < min(HEIGHT_SURE, HEIGHT_SHARE * whole.first.score)
    if faint and abs(height_um) < HEIGHT_SURE * whole.first.noise_um:
        return height_um, np.ones(len(whole.x_um), bool)
    with np.errstate(invalid="ignore"):
        return height_um, known & (whole.smooth_um * math.copysign(1, height_um) >= HALF * abs(height_um))


def _outline(x_um: Floats, y_um: Floats, pixel_um: float) -> Outline:
    """By moments; an own pixel has a moment too. Thin things are as long as they reach."""
    x, y = float(x_um.mean()), float(y_um.mean())
    own = pixel_um**2 / 12
    xx, yy = float(np.mean((x_um - x) ** 2)) + own, float(np.mean((y_um - y) ** 2)) + own
    xy = float(np.mean((x_um - x) * (y_um - y)))
    middle, half = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    angle = 0.5 * math.atan2(2 * xy, xx - yy)
    major, minor = 4 * math.sqrt(middle + half), 4 * math.sqrt(max(own, middle - half))
    area = len(x_um) * pixel_um**2
    if major > THIN * minor:
        along = (x_um - x) * math.cos(angle) + (y_um - y) * math.sin(angle)
        major = float(np.ptp(along)) + pixel_um
        minor = min(minor, area / major)
    return Outline(x, y, major, minor, math.degrees(angle), area)


def _region(outline: Outline, pixel_um: float) -> Region:
    """A circle round what is about round, else the ellipse as a polygon."""
    major, minor = max(outline.major_um, 2 * pixel_um), max(outline.minor_um, 2 * pixel_um)
    if major < 1.3 * minor:
        return Region.circle(outline.x_um, outline.y_um, major / 2)
    turn, c, s = np.arange(16) * math.pi / 8, *_direction(outline.angle_deg)
    a, b = major / 2 * np.cos(turn), minor / 2 * np.sin(turn)
    xs, ys = outline.x_um + a * c - b * s, outline.y_um + a * s + b * c
    return Region.polygon(*zip(xs.tolist(), ys.tolist(), strict=True))


def _direction(angle_deg: float) -> tuple[float, float]:
    return math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))


def _shape(
    whole: Gathered,
    inside: NDArray[np.bool_],
    outline: Outline,
    height_um: float,
    mean_um: float,
    cells: CellGrid,
    recipe: DefectRecipe,
    on_dies: bool,
) -> DefectShape:
    """What the rules of classes ask for."""
    left = (whole.z_um - whole.smooth_um)[inside]
    known = np.isfinite(left)
    rough = float(np.sqrt(np.mean(left[known] ** 2))) if known.any() else 0.0
    die_um2 = cells.grid.width_um * cells.grid.height_um
    return DefectShape(
        height_um=height_um,
        mean_height_um=mean_um,
        score=whole.first.score,
        area_um2=outline.area_um2,
        major_um=outline.major_um,
        minor_um=outline.minor_um,
        roughness_ratio=rough / whole.first.noise_um if whole.first.noise_um > 0 else 1.0,
        steepness=_steepness(whole, height_um, outline),
        on_edge_fraction=_on_edge(whole, inside, outline, cells) if on_dies else 0.0,
        die_fraction=min(1.0, outline.area_um2 / die_um2) if on_dies else 0.0,
        unmeasured_fraction=1.0 if whole.first.unmeasured else float(np.isnan(whole.z_um).mean()),
        evidence=evidence_of(whole.peaks, recipe.threshold_sigma),
        height_score=whole.peaks.get("height", 0.0),
        picture_score=whole.peaks.get("picture", 0.0),
        pixel_um=cells.pixel_um,
    )


def _steepness(whole: Gathered, height_um: float, outline: Outline) -> float:
    """The median slope where it is about half as high as its peak, 1 for a cone; 0 where there is none."""
    if height_um == 0:
        return 0.0
    share = whole.smooth_um / height_um
    with np.errstate(invalid="ignore"):
        slopes = whole.slope[(share > 0.3) & (share < 0.7)]
    slopes = slopes[np.isfinite(slopes)]
    return float(np.median(slopes)) * outline.minor_um / 2 / abs(height_um) if len(slopes) >= 3 else 0.0


def _on_edge(whole: Gathered, inside: NDArray[np.bool_], outline: Outline, cells: CellGrid) -> float:
    """The share of its border that lies on the die's edge, by how many of its pixels lie near that.

    What goes on into the street crosses the edge, and lies not on it.
    """
    near = EDGE_PX * cells.pixel_um
    u, v = whole.u_um[inside], whole.v_um[inside]
    sides = (np.abs(u), np.abs(u - cells.grid.width_um), np.abs(v), np.abs(v - cells.grid.height_um))
    on_edge = np.minimum.reduce(sides) <= near
    width, height = cells.grid.width_um, cells.grid.height_um
    in_street = (u < -near) | (u > width + near) | (v < -near) | (v > height + near)
    if in_street.mean() > CROSSING:
        return 0.0
    along_um = float(np.count_nonzero(on_edge)) * cells.pixel_um**2 / (2 * near)
    a, b = outline.major_um / 2, outline.minor_um / 2
    around_um = math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))
    return min(1.0, along_um / max(cells.pixel_um, around_um))


def _place(outline: Outline, cells: CellGrid, on_dies: bool) -> dict[str, Any]:
    """On which die, and where on it."""
    if not on_dies:
        return {"die": "", "in_die": None}
    x_um, y_um = np.array([outline.x_um]), np.array([outline.y_um])
    col, row, u_um, v_um = (a.item() for a in cells.grid.to_die(x_um, y_um))
    return {"die": cells.grid.name(int(col), int(row)), "in_die": Point(x_um=float(u_um), y_um=float(v_um))}


def _sizes(
    whole: Gathered,
    inside: NDArray[np.bool_],
    outline: Outline,
    height_um: float,
    pixel_um: float,
    reading: Reading,
    resolved: bool,
) -> dict[str, Any]:
    """Lengths, area and volume with U where there is an honest one."""
    volume_um3 = float(np.nansum(whole.z_um)) * pixel_um**2
    area = 0.0 if not resolved else outline.area_um2
    edge_um = U_EDGE_PX * pixel_um
    of_area: Lines | None = {
        "pixel scale": 2 * reading.u_pixel_scale * area,
        "place of the outline": math.pi * (outline.major_um + outline.minor_um) / 2 * edge_um,
    }
    n = int(np.count_nonzero(inside))
    of_height: Lines = {
        "noise": whole.first.noise_um,
        "z scale": reading.u_z_scale * abs(height_um),
        "interpolation between frames": reading.u_interpolation_um,
    }
    measured = bool(np.isfinite(whole.smooth_um).any()) and n > 0
    return {
        "major": reading.length(outline.major_um, _of_length(reading, outline.major_um, edge_um) if resolved else None),
        "minor": reading.length(outline.minor_um, _of_length(reading, outline.minor_um, edge_um) if resolved else None),
        "height": reading.length(height_um, of_height if measured and resolved else None),
        "area": reading.quantity(outline.area_um2, "um2", of_area if resolved else None),
        "volume": reading.quantity(volume_um3, "um3", None),
    }


def _of_length(reading: Reading, length_um: float, edge_um: float) -> Lines:
    return {"pixel scale": reading.u_pixel_scale * length_um, "place of the outline": math.sqrt(2) * edge_um}


def _notes(reading: Reading, resolved: bool) -> tuple[str, ...]:
    return (SIZE_NOTE, *(() if resolved else (NOT_RESOLVED,)), *reading.not_in_budget())
