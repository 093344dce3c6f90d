"""Measurement conditions for an uncertainty budget that the surface itself does not contain."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec

STEEL_PER_K = 11.5e-6
"""Thermal expansion of steel gauge blocks, relative per kelvin (ISO 3650)."""


class Conditions(Spec, frozen=True, kw_only=True):
    """Standard uncertainties (k = 1) of a step height by cause; None: unknown, and listed as not evaluated.

    repeatability_um: standard deviation of the height over repeat scans; drift_um: of z between the two faces during
    the scan; z_linearity_um: error of the z axis over the step besides its scale; abbe_um: pitch of the stage times the
    offset of the sample from the axis of its scale; temperature_c, u_temperature_c: of the sample; expansion_per_k: of
    its material, relative.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    repeatability_um: NonNegative | None = None
    drift_um: NonNegative | None = None
    z_linearity_um: NonNegative | None = None
    abbe_um: NonNegative | None = None
    temperature_c: float | None = None
    u_temperature_c: NonNegative = 0.5
    expansion_per_k: NonNegative = STEEL_PER_K
