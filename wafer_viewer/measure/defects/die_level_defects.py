"""Defects of entire dies (missing or tilted), and defects that repeat from die to die. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.defects.cell_comparison import CellResult, ComparisonWork
from wafer_viewer.measure.defects.classification import classify
from wafer_viewer.measure.defects.noise_model import NoiseModel
from wafer_viewer.model.inspection.class_rules import DefectShape
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.region import Point
from wafer_viewer.model.spec import replace

FAR = 8.0
"""Deviations from the other dies beyond which an entire die is a defect."""
LEAST_TILT_PX = 6.0
"""Smallest tilt, as the lift of the die's edge in deviations of its heights."""
REPEATS_FROM = 0.5
NEAR_PX = 6.0
LEAST_TO_TELL = 4
LEAST_COMPARED = 0.5
"""Smallest compared area of a die, relative to the median, for its offset and tilt to be evaluated."""


def whole_die_defects(
    results: Sequence[CellResult], work: ComparisonWork, reading: MeasurementContext, noise: NoiseModel
) -> dict[str, Defect]:
    """Return defects of entire dies by die name: those at another height or tilt than the others."""
    seen = _measured_enough(results)
    if len(seen) < LEAST_TO_TELL:
        return {}
    offsets = np.array([result.offset_um for result in seen])
    tilts = np.array([result.tilt for result in seen])
    noise_um = float(np.nanmedian(work.golden.z_spread_um))
    half_um = min(work.cells.grid.width_um, work.cells.grid.height_um) / 2
    offset_off, offset_limit = _off(offsets, 6 * noise_um)
    tilt_off = np.hypot(*(tilts - np.median(tilts, axis=0)).T)
    tilt_limit = max(FAR * 1.4826 * float(np.median(tilt_off)), LEAST_TILT_PX * noise_um / half_um)
    tilted = (tilt_off > tilt_limit) & (tilt_off * 1e3 > work.recipe.rules.tilt_mrad)
    offset = (np.abs(offset_off) > offset_limit) & (np.abs(offset_off) > work.recipe.rules.missing_height_um / 4)
    found: dict[str, Defect] = {}
    for k in np.flatnonzero(tilted | offset):
        score = max(abs(offset_off[k]) / max(offset_limit, 1e-9), tilt_off[k] / max(tilt_limit, 1e-12)) * FAR
        height_um = float(offset_off[k]) if offset[k] else float(tilt_off[k]) * half_um
        name = work.cells.grid.name(*seen[k].place)
        found[name] = _whole(seen[k], work, reading, height_um, float(tilt_off[k]) * 1e3, float(score))
    return found


def _measured_enough(results: Sequence[CellResult]) -> list[CellResult]:
    """Return the cells with enough compared pixels; a plane through a sliver of a die has a random tilt."""
    known = [result for result in results if result.compared_px]
    usual = float(np.median([result.compared_px for result in known])) if known else 0.0
    return [result for result in known if result.compared_px >= LEAST_COMPARED * usual]


def mark_repeaters(defects: Sequence[Defect], n_dies: int, pixel_um: float) -> tuple[Defect, ...]:
    """Mark defects found at the same place in most dies as repeating; for stored golden dies only."""
    if n_dies < LEAST_TO_TELL:
        return tuple(defects)
    at = [(d.in_die.x_um, d.in_die.y_um) if d.in_die is not None else (math.inf, math.inf) for d in defects]
    return tuple(
        replace(d, repeats=True) if _dies_near(at[k], at, defects, pixel_um) >= REPEATS_FROM * n_dies else d
        for k, d in enumerate(defects)
    )


def _dies_near(
    here: tuple[float, float], at: list[tuple[float, float]], defects: Sequence[Defect], pixel_um: float
) -> int:
    if math.isinf(here[0]):
        return 0
    near = NEAR_PX * pixel_um
    return len({d.die for d, (u, v) in zip(defects, at, strict=True) if math.hypot(u - here[0], v - here[1]) <= near})


def _off(values: np.ndarray, least: float) -> tuple[np.ndarray, float]:
    off = values - np.median(values)
    return off, max(FAR * 1.4826 * float(np.median(np.abs(off))), least)


def _whole(
    result: CellResult,
    work: ComparisonWork,
    reading: MeasurementContext,
    height_um: float,
    tilt_mrad: float,
    score: float,
) -> Defect:
    grid = work.cells.grid
    x_um, y_um = (float(a) for a in grid.to_stage(*result.place, grid.width_um / 2, grid.height_um / 2))
    shape = DefectShape(
        height_um=height_um,
        mean_height_um=height_um,
        score=score,
        area_um2=grid.width_um * grid.height_um,
        major_um=max(grid.width_um, grid.height_um),
        minor_um=min(grid.width_um, grid.height_um),
        die_fraction=1.0,
        die_tilt_mrad=tilt_mrad,
        pixel_um=work.cells.pixel_um,
    )
    found = classify(shape, work.recipe.rules)
    return Defect(
        **reading.told("", 0, "The die differs from the others as a whole; its area is that of a die."),
        center=Point(x_um=x_um, y_um=y_um),
        outline=grid.outline(*result.place),
        kind=found.kind,
        reasons=found.reasons,
        confidence=found.confidence,
        die=grid.name(*result.place),
        in_die=Point(x_um=grid.width_um / 2, y_um=grid.height_um / 2),
        major=reading.length(shape.major_um, None),
        minor=reading.length(shape.minor_um, None),
        height=reading.length(height_um, None),
        mean_height_um=height_um,
        area=reading.quantity(shape.area_um2, "um2", None),
        volume=reading.quantity(shape.area_um2 * height_um, "um3", None),
        score=score,
    )
