"""Uncertainty budget of a step height: its lines, their size, and what it omits."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wafer_viewer.model.measurement.uncertainty_conditions import Conditions
from wafer_viewer.model.surface.height_map import Provenance

ARGMAX_INTERPOLATION = 1 / math.sqrt(6)
"""Standard uncertainty of a step, in z steps, when both faces are rounded to frames (two uniform roundings)."""
INTERPOLATION_SHARE = 0.005
"""Standard uncertainty of a step, in z steps, for peaks interpolated between frames.

It is the largest bias observed on simulated planes with z steps up to half the depth of field.
"""
NOT_IN_BUDGET = (
    "Not in the budget: repeat scans, drift during the scan, z offsets between fields, linearity and Abbe offset of "
    "the z axis, temperature other than 20 C."
)
NOISE, Z_SCALE, LINEARITY, LEVELLING = "noise and form of the faces", "z scale", "z linearity", "levelling"
DRIFT, POSES, INTERPOLATION = "drift during the scan", "poses of the fields", "interpolation between frames"
REPEATABILITY, TEMPERATURE, ABBE = "repeatability", "temperature", "Abbe offset"
LINES = (NOISE, Z_SCALE, LINEARITY, LEVELLING, DRIFT, POSES, INTERPOLATION, REPEATABILITY, TEMPERATURE, ABBE)
"""All lines of a step's budget, in reporting order."""
LESS_WITH_REPEATS = (NOISE, DRIFT, POSES, INTERPOLATION, REPEATABILITY)
"""Lines reduced by averaging several scans; the others are common to all scans."""
REFERENCE_C = 20.0
"""Reference temperature of lengths (ISO 1)."""


@dataclass(frozen=True, slots=True)
class Budget:
    """Standard uncertainties (k = 1) in um by source, and the lines that were not evaluated."""

    lines: dict[str, float]
    not_evaluated: tuple[str, ...]


def step_budget(
    height_um: float, of_points: dict[str, float | None], conditions: Conditions, provenance: Provenance
) -> Budget:
    """Return the budget of a height; of_points: lines evaluated from its points, None where they cannot be."""
    known = {**from_conditions(height_um, conditions, provenance), **of_points}
    given = {name: known.get(name) for name in LINES if name in known}
    return Budget(
        {name: u for name, u in given.items() if u is not None},
        tuple(name for name, u in given.items() if u is None),
    )


def from_conditions(height_um: float, conditions: Conditions, provenance: Provenance) -> dict[str, float | None]:
    """Return the lines known before the measurement, None where unknown; given values override the calibration."""
    calibration = provenance.calibration
    linearity_um, abbe_um = conditions.z_linearity_um, conditions.abbe_um
    if calibration is not None:
        linearity_um = calibration.u_z_linearity_um if linearity_um is None else linearity_um
        abbe_um = calibration.u_abbe_um if abbe_um is None else abbe_um
    return {
        Z_SCALE: None if calibration is None else calibration.u_z_scale * abs(height_um),
        LINEARITY: linearity_um,
        DRIFT: conditions.drift_um,
        INTERPOLATION: interpolation_um(provenance),
        REPEATABILITY: conditions.repeatability_um,
        TEMPERATURE: _temperature_um(height_um, conditions),
        ABBE: abbe_um,
    }


def interpolation_um(provenance: Provenance) -> float:
    """Standard uncertainty of a height difference due to peak interpolation between frames."""
    per_step = ARGMAX_INTERPOLATION if provenance.recipe.peak == "argmax" else INTERPOLATION_SHARE
    return per_step * provenance.z_step_um


def _temperature_um(height_um: float, conditions: Conditions) -> float | None:
    """Return the standard uncertainty due to temperature: the full expansion, as heights are not corrected."""
    if conditions.temperature_c is None:
        return None
    off_k = math.hypot(conditions.temperature_c - REFERENCE_C, conditions.u_temperature_c)
    return abs(height_um) * conditions.expansion_per_k * off_k
