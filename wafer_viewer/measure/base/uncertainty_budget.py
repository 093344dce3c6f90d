"""The lines of a step height's uncertainty budget: what each is, how large, and what is not in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wafer_viewer.model.measurement.uncertainty_conditions import Conditions
from wafer_viewer.model.surface.height_map import Provenance

ARGMAX_INTERPOLATION = 1 / math.sqrt(6)
"""Standard uncertainty of a step in steps of the sweep when both faces are rounded to whole frames: two uniform
roundings."""
INTERPOLATION_SHARE = 0.005
"""The same for peaks found between frames: the largest bias seen on simulated planes with steps up to half the depth
of field."""
NOT_IN_BUDGET = (
    "Not in the budget: repeat scans, drift during the scan, z offsets between fields, linearity and Abbe offset of "
    "the z axis, temperature other than 20 C."
)
NOISE, Z_SCALE, LINEARITY, LEVELLING = "noise and form of the faces", "z scale", "z linearity", "levelling"
DRIFT, POSES, INTERPOLATION = "drift during the scan", "poses of the fields", "interpolation between frames"
REPEATABILITY, TEMPERATURE, ABBE = "repeatability", "temperature", "Abbe offset"
LINES = (NOISE, Z_SCALE, LINEARITY, LEVELLING, DRIFT, POSES, INTERPOLATION, REPEATABILITY, TEMPERATURE, ABBE)
"""Every line of a step's budget, in the order in which they are told."""
LESS_WITH_REPEATS = (NOISE, DRIFT, POSES, INTERPOLATION, REPEATABILITY)
"""Lines that the mean of several scans makes smaller; the others are the same in each."""
REFERENCE_C = 20.0
"""Lengths are those at this temperature (ISO 1)."""


@dataclass(frozen=True, slots=True)
class Budget:
    """Standard uncertainties (k = 1) in um by what they come from, and the lines that nothing is known of."""

    lines: dict[str, float]
    not_evaluated: tuple[str, ...]


def step_budget(
    height_um: float, of_points: dict[str, float | None], conditions: Conditions, provenance: Provenance
) -> Budget:
    """The budget of a height; of_points: those lines that its points tell, None where they cannot."""
    known = {**from_conditions(height_um, conditions, provenance), **of_points}
    given = {name: known.get(name) for name in LINES if name in known}
    return Budget(
        {name: u for name, u in given.items() if u is not None},
        tuple(name for name, u in given.items() if u is None),
    )


def from_conditions(height_um: float, conditions: Conditions, provenance: Provenance) -> dict[str, float | None]:
    """The lines that are known beforehand, None where they are not; what is given goes before the calibration."""
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
    """Standard uncertainty of a difference of two heights, for peaks are found between frames."""
    per_step = ARGMAX_INTERPOLATION if provenance.recipe.peak == "argmax" else INTERPOLATION_SHARE
    return per_step * provenance.z_step_um


def _temperature_um(height_um: float, conditions: Conditions) -> float | None:
    """The height is not corrected for the sample's temperature, so all of what it expands by is uncertain."""
    if conditions.temperature_c is None:
        return None
    off_k = math.hypot(conditions.temperature_c - REFERENCE_C, conditions.u_temperature_c)
    return abs(height_um) * conditions.expansion_per_k * off_k
