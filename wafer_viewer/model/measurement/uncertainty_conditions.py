"""What is known of how a measurement was made, beside what its surface tells: a budget of uncertainty asks for it."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec

STEEL_PER_K = 11.5e-6
"""Thermal expansion of steel gauge blocks, relative per kelvin (ISO 3650)."""


class Conditions(Spec, frozen=True, kw_only=True):
    """Standard uncertainties (k = 1) of a step's height by their causes; None: not known, and listed as not evaluated.

    repeatability_um: standard deviation of the height over repeat scans; drift_um: of z between the two faces while
    they were scanned; z_linearity_um: what the z axis errs over the step beside its scale; abbe_um: from the pitch of
    the stage times the offset of the sample from the line of its scale; temperature_c, u_temperature_c: of the sample;
    expansion_per_k: of its material, relative.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    repeatability_um: NonNegative | None = None
    drift_um: NonNegative | None = None
    z_linearity_um: NonNegative | None = None
    abbe_um: NonNegative | None = None
    temperature_c: float | None = None
    u_temperature_c: NonNegative = 0.5
    expansion_per_k: NonNegative = STEEL_PER_K
