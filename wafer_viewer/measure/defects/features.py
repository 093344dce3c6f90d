"""Shape features of a defect for the classification rules. Pure."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.defects.outline import DefectOutline, Gathered, Mask, ellipse_of
from wafer_viewer.measure.defects.segmentation import evidence_of
from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.inspection.class_rules import DefectShape
from wafer_viewer.model.inspection.defect import DefectRecipe

EDGE_PX, CROSSING = 2.0, 0.1


def shape_of(
    whole: Gathered,
    inside: Mask,
    outline: DefectOutline,
    height_um: float,
    cells: CellGrid,
    recipe: DefectRecipe,
    on_dies: bool,
) -> DefectShape:
    """Return the shape features of one defect; inside: mask of its pixels above half of its height."""
    left = (whole.z_um - whole.smooth_um)[inside]
    known = np.isfinite(left)
    rough = float(np.sqrt(np.mean(left[known] ** 2))) if known.any() else 0.0
    die_um2 = cells.grid.width_um * cells.grid.height_um
    return DefectShape(
        height_um=height_um,
        mean_height_um=mean_height_um(whole, inside),
        score=whole.first.score,
        area_um2=outline.area_um2,
        major_um=outline.major_um,
        minor_um=outline.minor_um,
        picture_ratio=_picture_ratio(whole, cells.pixel_um),
        roughness_ratio=rough / whole.first.noise_um if whole.first.noise_um > 0 else 1.0,
        steepness=_steepness(whole, height_um, outline),
        on_edge_fraction=_on_edge(whole, inside, cells) if on_dies else 0.0,
        die_fraction=min(1.0, outline.area_um2 / die_um2) if on_dies else 0.0,
        unmeasured_fraction=float(np.isnan(whole.z_um).mean()),
        evidence=evidence_of(whole.peaks, recipe.threshold_sigma),
        height_score=whole.peaks.get("height", 0.0),
        picture_score=whole.peaks.get("picture", 0.0),
        detail_score=whole.peaks.get("detail", 0.0),
        pixel_um=cells.pixel_um,
    )


def mean_height_um(whole: Gathered, inside: Mask) -> float:
    """Return the mean height over the defect's area, 0 where no height is known."""
    values = whole.smooth_um[inside]
    return float(np.nanmean(values)) if np.isfinite(values).any() else 0.0


def _picture_ratio(whole: Gathered, pixel_um: float) -> float:
    """Return length over width by the moments of the image contrast, which no focus window blurs; 0 if none."""
    clear = whole.pictured
    if clear is None:
        return 0.0
    seen = ellipse_of(whole.x_um[clear], whole.y_um[clear], whole.clear[clear], pixel_um)
    return max(seen.major_um, pixel_um) / max(seen.minor_um, pixel_um)


def _steepness(whole: Gathered, height_um: float, outline: DefectOutline) -> float:
    """Return the median slope at about half of the peak height, normalised to 1 for a cone; 0 if unknown."""
    if height_um == 0:
        return 0.0
    share = whole.smooth_um / height_um
    with np.errstate(invalid="ignore"):
        slopes = whole.slope[(share > 0.3) & (share < 0.7)]
    slopes = slopes[np.isfinite(slopes)]
    return float(np.median(slopes)) * outline.minor_um / 2 / abs(height_um) if len(slopes) >= 3 else 0.0


def _on_edge(whole: Gathered, inside: Mask, cells: CellGrid) -> float:
    """Return the fraction of the defect's border on the die's edge, from the number of its pixels near that edge.

    The pixels are those with image contrast, because walls have few heights. A defect that continues into the street
    crosses the edge and has a fraction of 0.
    """
    its = inside if whole.pictured is None else whole.pictured
    pixel_um, near = cells.pixel_um, EDGE_PX * cells.pixel_um
    u, v = whole.u_um[its], whole.v_um[its]
    within = np.minimum.reduce((u, cells.grid.width_um - u, v, cells.grid.height_um - v))
    if np.mean(within < -near) > CROSSING:
        return 0.0
    along_um = float(np.count_nonzero(np.abs(within) <= near)) * pixel_um**2 / (2 * near)
    around = ellipse_of(whole.x_um[its], whole.y_um[its], np.ones(len(u)), pixel_um).around_um
    return min(1.0, along_um / max(pixel_um, around))
