"""Defects of entire dies, and the measurement of every die: tilts, offset, bow, brightness and presence."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.robust_fit import robust_fit
from wafer_viewer.measure.defects.cell_comparison import CellResult, ComparisonWork
from wafer_viewer.measure.defects.defect_builder import LEAST_COMPARED, classify
from wafer_viewer.measure.defects.die_form import DieForm
from wafer_viewer.measure.dies.die_cells import Place
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DefectShape
from wafer_viewer.model.inspection.die_grid import DieMeasurement
from wafer_viewer.model.region import Point
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DieLevelParameters:
    """Limits of defects of entire dies.

    Parameters
    ----------
    far : float
        Robust deviations from the other dies beyond which an entire die is a defect.
    sure : float
        The same in standard uncertainties of the die.
    dies_a_term : float
        Smallest number of dies for each term of the trend over the wafer that is removed first.
    least_known : float
        Smallest fitted part of a die; a plane through a sliver of one has a random tilt.

    Notes
    -----
    `tests/bench/bench_die_states.py` counts the dies named right with these values.
    """

    far: float = 6.0
    sure: float = 6.0
    dies_a_term: float = 2.5
    least_known: float = 0.5


DIE_LEVEL = DieLevelParameters()
NUMBERS = ("bow_um", "brightness", "offset_um", "u_tilt", "u_bow_um", "u_brightness", "u_offset_um")
AREA_NOTE = "The die differs from the others as a whole; its area is that of a die."


def die_forms(results: Sequence[CellResult], missing: Collection[Place]) -> dict[Place, DieForm]:
    """Return the form of each die that is known well enough, less the robust trend over the wafer.

    Tilts follow a linear trend, as on a wafer of quadratic form, and offsets a quadratic one.
    """
    forms = {r.place: r.form for r in results if r.form.known >= DIE_LEVEL.least_known and r.place not in missing}
    if not forms:
        return {}
    some, places = list(forms.values()), np.array(list(forms), np.float64)
    right, up = (_less_trend([form.tilt[k] for form in some], places, 1) for k in range(2))
    offset = _less_trend([form.offset_um for form in some], places, 2)
    bow = _less_trend([form.bow_um for form in some], places, 0)
    shine = _less_trend([form.brightness for form in some], places, 1)
    return {
        place: replace(form, tilt=(right[k], up[k]), offset_um=offset[k], bow_um=bow[k], brightness=shine[k])
        for k, (place, form) in enumerate(forms.items())
    }


def _less_trend(values: Sequence[float], places: Floats, order: int) -> list[float]:
    """Return values less a polynomial over the lattice, of as high an order as the number of dies allows."""
    each, (x, y) = np.asarray(values, np.float64), (places - places.mean(axis=0)).T
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    for highest in range(order, 0, -1):
        terms = [x**i * y**j for i, j in powers if i + j <= highest]
        if len(each) < DIE_LEVEL.dies_a_term * len(terms):
            continue
        try:
            each = robust_fit(np.stack(terms, axis=1), each).residuals
            break
        except MeasureError:
            continue
    return (each - float(np.median(each))).tolist()


def whole_die_defects(
    forms: Mapping[Place, DieForm], missing: Collection[Place], work: ComparisonWork, reading: MeasurementContext
) -> dict[str, Defect]:
    """Return defects of entire dies by die name: missing ones, and those that lie or shine unlike the others.

    forms: those of the dies less their trend.
    """
    grid, rules = work.cells.grid, work.recipe.rules
    found = {grid.name(*at): _whole(at, work, reading, DieForm(), 0.0, DIE_LEVEL.far) for at in missing}
    if len(forms) < LEAST_COMPARED:
        return found
    some = list(forms.values())
    tilts = np.array([form.tilt for form in some])
    number = {name: np.array([getattr(form, name) for form in some]) for name in NUMBERS}
    scores = {
        "tilt": _score(np.hypot(*tilts.T), tilts, number["u_tilt"], rules.tilt_mrad / 1e3),
        "bow_um": _score(number["bow_um"], number["bow_um"], number["u_bow_um"], rules.bow_um),
        "brightness": _score(
            number["brightness"], number["brightness"], number["u_brightness"], rules.brightness_fraction
        ),
        "offset_um": _score(number["offset_um"], number["offset_um"], number["u_offset_um"], rules.missing_height_um),
    }
    highest = np.max(list(scores.values()), axis=0)
    for k, (place, form) in enumerate(forms.items()):
        if highest[k] <= 1:
            continue
        usual: dict[str, Any] = {name: getattr(DieForm(), name) for name in scores if scores[name][k] <= 1}
        seen = replace(form, **usual)
        found[grid.name(*place)] = _whole(place, work, reading, seen, 1.0, DIE_LEVEL.far * float(highest[k]))
    return found


def _score(off: Floats, each: Floats, u: Floats, least: float) -> Floats:
    """Return deviations relative to their limit: that of the rules, the scatter of the dies, their uncertainty."""
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(each)))
    return np.abs(off) / np.maximum(max(least, DIE_LEVEL.far * scatter), DIE_LEVEL.sure * u)


def _whole(
    place: Place, work: ComparisonWork, reading: MeasurementContext, form: DieForm, presence: float, score: float
) -> Defect:
    grid = work.cells.grid
    x_um, y_um = (float(a) for a in grid.to_stage(*place, grid.width_um / 2, grid.height_um / 2))
    half_um = min(grid.width_um, grid.height_um) / 2
    tilt = math.hypot(*form.tilt)
    height_um = form.offset_um or form.bow_um or tilt * half_um
    shape = DefectShape(
        height_um=height_um,
        mean_height_um=form.offset_um,
        score=score,
        area_um2=grid.width_um * grid.height_um,
        major_um=max(grid.width_um, grid.height_um),
        minor_um=min(grid.width_um, grid.height_um),
        die_fraction=1.0,
        die_presence=presence,
        die_tilt_mrad=tilt * 1e3,
        die_bow_um=form.bow_um,
        die_brightness=math.expm1(form.brightness),
        pixel_um=work.cells.pixel_um,
    )
    found = classify(shape, work.recipe.rules)
    return Defect(
        **reading.result_fields("", 0, AREA_NOTE),
        center=Point(x_um=x_um, y_um=y_um),
        outline=grid.outline(*place),
        kind=found.kind,
        reasons=found.reasons,
        confidence=found.confidence,
        die=grid.name(*place),
        in_die=Point(x_um=grid.width_um / 2, y_um=grid.height_um / 2),
        major=reading.length(shape.major_um, None),
        minor=reading.length(shape.minor_um, None),
        height=reading.length(height_um, None),
        mean_height_um=form.offset_um,
        area=reading.quantity(shape.area_um2, "um2", None),
        volume=reading.quantity(shape.area_um2 * form.offset_um, "um3", None),
        score=score,
    )


def measured_die(form: DieForm, reading: MeasurementContext) -> DieMeasurement:
    """Return the measurement of a die from its form."""
    z_scale, pixel_scale = reading.u_z_scale, reading.u_pixel_scale

    def tilt(value: float) -> tuple[float, dict[str, float]]:
        scale = math.hypot(z_scale, pixel_scale) * abs(value) * 1e3
        return value * 1e3, {"scatter of the die": form.u_tilt * 1e3, "z and pixel scale": scale}

    def length(um: float, u_um: float) -> tuple[float, dict[str, float]]:
        return um, {"scatter of the die": u_um, "z scale": z_scale * abs(um), **reading.frame_lines()}

    (tilt_x, x_lines), (tilt_y, y_lines) = (tilt(value) for value in form.tilt)
    return DieMeasurement(
        tilt_x=reading.quantity(tilt_x, "mrad", x_lines),
        tilt_y=reading.quantity(tilt_y, "mrad", y_lines),
        offset=reading.length(*length(form.offset_um, form.u_offset_um)),
        bow=reading.length(*length(form.bow_um, form.u_bow_um)),
        brightness_fraction=math.expm1(form.brightness),
        u_brightness_fraction=form.u_brightness,
    )
