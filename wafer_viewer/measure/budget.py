"""The lines of a step height's uncertainty budget: what each is, how large, and what is not in it."""

from __future__ import annotations

import math

from wafer_viewer.measure.tiles import Residuals, scatter_um
from wafer_viewer.model.quantities import Contribution
from wafer_viewer.model.surface import Provenance

ARGMAX_INTERPOLATION = 1 / math.sqrt(6)
"""Standard uncertainty of a step in steps of the sweep when both faces are rounded to whole frames: two uniform
roundings."""
INTERPOLATION = 0.005
"""The same for peaks found between frames: the largest bias seen on simulated planes with steps up to half the depth
of field."""
NOT_IN_BUDGET = (
    "Not in the budget: repeat scans, drift during the scan, z offsets between fields, linearity and Abbe offset of "
    "the z axis, temperature other than 20 C."
)


def step_budget(
    upper: Residuals, lower: Residuals, height_um: float, disagreement_um: float, provenance: Provenance
) -> tuple[Contribution, ...] | None:
    """The lines of the budget, standard uncertainties (k = 1); None when the scatter cannot be told or z is unknown.

    upper, lower: points and their distance from their own planes; disagreement_um: how far h moves from levelling to
    the one face to levelling to the other, taken as the full width of a uniform distribution.
    """
    scatter = scatter_um(upper, lower)
    if scatter is None or provenance.calibration is None:
        return None
    return (
        Contribution(name="z scale", u_um=provenance.calibration.u_z_scale * abs(height_um)),
        Contribution(name="noise and form of the faces", u_um=scatter),
        Contribution(name="relative tilt of the faces", u_um=abs(disagreement_um) / math.sqrt(12)),
        Contribution(name="interpolation between frames", u_um=interpolation_um(provenance)),
    )


def interpolation_um(provenance: Provenance) -> float:
    """Standard uncertainty of a difference of two heights, for peaks are found between frames."""
    per_step = ARGMAX_INTERPOLATION if provenance.recipe.peak == "argmax" else INTERPOLATION
    return per_step * provenance.z_step_um
